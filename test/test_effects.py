# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Effects: each against its equation, compiled by address and as the plain Python it is."""

from dataclasses import replace
import re

import core_runs
from core_runs import affected, effect_on, push_plant
from gms_flex_control.effects import base as sig
from gms_flex_control.effects import registry, table
from gms_flex_control.effects.base import Change, Stage, Term
from gms_flex_control.errors import ParameterError
from gms_flex_control.simulation import loop
from gms_flex_control.simulation.loop import SteppedPlant
from gms_flex_control.trajectory.builders import hold
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

DT = 1e-4
TERMS = [name for name in registry.names() if issubclass(registry.find(name), Term)]
CHANGES = [name for name in registry.names() if issubclass(registry.find(name), Change)]


def clip(x, limit):
    """Return ``x`` between minus and plus ``limit``."""
    return np.clip(x, -limit, limit)


def arc(v, velocity, speed):
    """Return asinh of a speed less its chord from rest to another speed."""
    return np.arcsinh(v / velocity) - v / speed * np.arcsinh(speed / velocity)


def steepest(velocity, speed):
    """Return the speed at which asinh is as steep as the chord, by the solver of others."""
    return brentq(lambda v: 1.0 / np.hypot(v, velocity) - np.arcsinh(speed / velocity) / speed,
                  0.0, speed)


def base_after(time, push, frequency, inertia, damping):
    """Return the angle of a base pushed from rest, by the solver of others."""
    w = 2 * np.pi * frequency
    return solve_ivp(lambda t, b: [b[1], push / inertia - 2 * damping * w * b[1] - w * w * b[0]],
                     (0.0, time), [0.0, 0.0], rtol=1e-13, atol=1e-30).y[0, -1]


# values of the parameters, the signal changed, and what it becomes of signals s and the values
EQUATIONS = {
    'actuator_deadzone': ([0.02], 'torque', lambda s, a: s.torque - clip(s.torque, a)),
    'actuator_lag': ([0.005], 'torque', lambda s, a: s.torque * (1 + a / DT * np.expm1(-DT / a))),
    'actuator_saturation': ([0.1], 'torque', lambda s, a: clip(s.torque, a)),
    'backlash': ([0.03], 'torsion', lambda s, a: s.torsion - clip(s.torsion, a)),
    'base_flexibility': ([8.0, 0.5, 0.05], 'sensed_link', lambda s, *p: (
        s.sensed_link - base_after(DT, s.friction - s.torque, *p))),
    'constant_link_torque': ([-0.02], 'link_torque', lambda s, a: s.link_torque + a),
    'encoder_skew': ([0.003], 'sensed_motor', lambda s, a: (
        s.sensed_motor - a * s.dq_motor + a ** 2 / 2 * s.ddq_motor)),
    'end_stop': ([0.5, 30.0], 'link_torque', lambda s, a, b: (
        s.link_torque - b * max(s.q_link - a, 0.0))),
    'friction_backlash': ([0.02, 0.003, 0.01], 'friction', lambda s, *p: s.friction),
    'friction_hysteresis': ([0.02, 0.01], 'friction', lambda s, *p: s.friction),  # begins so
    'friction_drift': ([0.3, 50.0], 'friction', lambda s, a, b: s.friction * (1 + a * s.time / b)),
    'input_delay': ([DT / 4], 'torque', lambda s, a: s.torque * 0.75),
    'kinematic_error': ([0.01, 0.4], 'torsion', lambda s, a, b: (
        s.torsion + a * np.sin(2 * s.q_motor + b))),
    'link_encoder_eccentricity': ([0.02, 0.3], 'sensed_link', lambda s, a, b: (
        s.sensed_link + a * np.sin(s.q_link + b))),
    'load_friction': ([0.1, 0.01], 'friction', lambda s, *p: s.friction),  # begins so
    'low_speed_friction': ([-0.3, 0.05], 'friction', lambda s, a, b: (
        s.friction * (1 + a * np.exp(-abs(s.dq_link) / b)))),
    'motor_coulomb': ([0.02], 'motor_torque', lambda s, a: (
        s.motor_torque - a * clip(s.dq_motor / 1e-3, 1.0))),
    'motor_inertia_coupling': ([0.004], 'motor_torque', lambda s, a: (
        s.motor_torque - a * s[sig.DDQ_LINK - sig.WIDTH])),
    'motor_torque_bias': ([0.01], 'motor_torque', lambda s, a: s.motor_torque + a),
    'motor_viscous': ([0.03], 'motor_torque', lambda s, a: s.motor_torque - a * s.dq_motor),
    'position_friction': ([0.2, 3.0, 0.5], 'friction', lambda s, a, b, c: (
        s.friction * (1 + a * np.cos(b * s.q_link + c)))),
    'quadratic_drag': ([0.05], 'link_torque', lambda s, a: (
        s.link_torque - a * s.dq_link * abs(s.dq_link))),
    'recording_delay': ([0.003], 'sensed_link', lambda s, a: (
        s.sensed_link - a * s.dq_link + a ** 2 / 2 * s.ddq_link)),
    'shear_thinning': ([0.03, 0.2, 0.6], 'friction', lambda s, a, b, c: (
        s.friction + a * arc(s.dq_link, b, c) / arc(steepest(b, c), b, c))),
    'spring_cubic': ([12.0], 'spring', lambda s, a: s.spring + a * s.torsion ** 3),
    'spring_damping': ([0.02], 'spring', lambda s, a: s.spring + a * s.torsion_rate),
    'spring_hysteresis': ([0.01, 0.005], 'spring', lambda s, *p: s.spring),  # begins so
    'spring_offset': ([0.01], 'torsion', lambda s, a: s.torsion + a),
    'stiffness_drift': ([0.2, 50.0], 'spring', lambda s, a, b: s.spring * (1 + a * s.time / b)),
    'supply_sag': ([0.05, 2.0], 'torque', lambda s, a, b: (
        s.torque * (1 + a * (s.supply - b) * (s.supply > 0)))),
    'torque_gain': ([0.1], 'torque', lambda s, a: s.torque * (1 + a)),
    **{name: ([0.01, order, 0.3], 'motor_torque', lambda s, a, b, c: (
        s.motor_torque + a * np.sin(b * s.q_motor + c)))
       for name, order in (('torque_ripple', 12.0), ('torque_ripple_2', 24.0),
                           ('torque_ripple_3', 36.0))},
    'viscous_asymmetry': ([0.03], 'friction', lambda s, a: s.friction + a * abs(s.dq_link)),
    'viscous_error': ([0.03], 'friction', lambda s, a: s.friction + a * s.dq_link)}
# what else a term may change
FURTHER = {'backlash': [sig.TORSION_RATE],
           'base_flexibility': [sig.SENSED_MOTOR, sig.SENSED_LINK_RATE, sig.SENSED_MOTOR_RATE,
                                sig.BASE, sig.BASE_RATE],
           'encoder_skew': [sig.SENSED_MOTOR_RATE],
           'link_encoder_eccentricity': [sig.SENSED_LINK_RATE],
           'motor_inertia_coupling': [sig.LINK_TORQUE - sig.WIDTH],
           'recording_delay': [row * sig.WIDTH + side for row in range(3)
                               for side in (sig.SENSED_LINK, sig.SENSED_MOTOR,
                                            sig.SENSED_LINK_RATE, sig.SENSED_MOTOR_RATE)]}
# values with which an effect does nothing
NOTHING = {name: [0.0] * len(registry.find(name).parameters) for name in TERMS}
NOTHING |= {'actuator_saturation': [1e6], 'end_stop': [10.0, 0.0], 'load_friction': [0.0, 1e-3]}


def row_of(name):
    """Return the row of signals that an effect of the second joint, or of the arm, is given."""
    return 0 if registry.find(name).whole_arm else 1


class Row:
    """The signals of one joint as an effect has them: a pointer, the neighbours' beside it."""

    def __init__(self, signals, joint):
        self._flat, self._first = signals.reshape(-1), joint * sig.WIDTH

    def __getattr__(self, name):
        return self[getattr(sig, name.upper())]

    def __getitem__(self, k):
        return self._flat[self._first + k]

    def __setitem__(self, k, value):
        self._flat[self._first + k] = value


def random_signals(n, seed):
    """Return signals of n joints, some of them small and some large."""
    rng = np.random.default_rng(seed)
    s = rng.standard_normal((n, sig.WIDTH)) * 10.0 ** rng.uniform(-3, 0, (n, sig.WIDTH))
    s[:, sig.TIME], s[:, sig.JOINT], s[:, sig.JOINTS] = rng.uniform(0, 30), range(n), n
    return s


def run_compiled(name, values, signals, joint=1, memory=None, dt=DT):
    """Return the signals after the compiled stage, dispatched by address."""
    entry = table.build([effect_on(f'j{joint}', name, *values)], ('j0', 'j1', 'j2'))
    out = signals.copy()
    memory = np.zeros(table.MEMORY_SIZE) if memory is None else memory
    table.run_stage(int(registry.find(name).stage), out, memory, dt, entry)
    return out


def along(name, values, given, inputs, taken=None, dt=DT):
    """Return a signal of the second joint along another's ``inputs`` (T,), or the same one."""
    memory, found = np.zeros(table.MEMORY_SIZE), []
    for value in inputs:
        signals = np.zeros((3, sig.WIDTH))
        signals[1, given] = value
        out = run_compiled(name, values, signals, memory=memory, dt=dt)
        found.append(out[1, given if taken is None else taken])
    return np.array(found)


def test_every_effect_of_the_catalogue_has_its_equation_here():
    """A new term needs an entry in EQUATIONS, so that it is never only believed."""
    assert sorted(EQUATIONS) == TERMS
    assert CHANGES == ['coulomb_error', 'friction_asymmetry', 'gravity_tilt',
                       'link_inertia_error', 'motor_inertia_error', 'presliding_error',
                       'stiffness_error', 'stribeck_error', 'tip_payload']


@pytest.mark.parametrize('name', TERMS)
def test_a_term_does_what_its_equation_says(name):
    """On its joint and its signal alone, over many random states."""
    values, changed, equation = EQUATIONS[name]
    row, changed = row_of(name), getattr(sig, changed.upper())
    for seed in range(50):
        before = random_signals(3, seed)
        after = run_compiled(name, values, before)
        assert after[row, changed] == pytest.approx(equation(Row(before, row), *values), rel=1e-12,
                                                    abs=1e-15)
        if name == 'backlash' and abs(before[1, sig.TORSION]) < values[0]:
            assert after[1, sig.TORSION_RATE] == 0.0
        for signal in (changed, *FURTHER.get(name, ())):
            Row(after, row)[signal] = Row(before, row)[signal]
        np.testing.assert_array_equal(after, before)


@pytest.mark.parametrize('name', TERMS)
def test_the_compiled_term_is_the_plain_python_one(name):
    """Bit for bit but for the last digit of a sine, memory included, over several steps."""
    kind, values = registry.find(name), np.array(EQUATIONS[name][0])
    compiled_memory, memory = np.zeros(table.MEMORY_SIZE), np.zeros(max(kind.memory_size, 1))
    for seed in range(20):
        signals = random_signals(3, seed)
        compiled = run_compiled(name, values, signals, memory=compiled_memory)
        plain = signals.copy()
        kind.apply(Row(plain, row_of(name)), values, memory, DT)
        np.testing.assert_allclose(compiled, plain, rtol=1e-14, atol=0)
        np.testing.assert_allclose(compiled_memory[:len(memory)], memory, rtol=1e-14, atol=0)


@pytest.mark.parametrize('name', TERMS)
def test_a_term_with_values_of_nothing_leaves_the_run_as_it_is(ideal_robot, name):
    spec = effect_on('joint1', name, *NOTHING[name])
    command = 0.3 * np.sin(np.arange(400)[:, None] * [0.01, 0.02])
    runs = [push_plant(robot, command, 2e-3, substeps=4)
            for robot in (ideal_robot, replace(ideal_robot, effects=(spec,)))]
    np.testing.assert_array_equal(runs[0], runs[1])


@pytest.mark.parametrize('name', sorted(set(TERMS) - {
    'base_flexibility', 'encoder_skew', 'end_stop', 'link_encoder_eccentricity',
    'recording_delay', 'supply_sag'}))
def test_a_term_with_values_changes_the_run(ideal_robot, name):
    """It is wired into the plant, not only into the table."""
    values = {'actuator_saturation': [0.05], 'backlash': [0.05]}.get(name, EQUATIONS[name][0])
    joint = 'joint2' if name == 'motor_inertia_coupling' else 'joint1'
    spec = effect_on(joint, name, *values)
    command = 0.4 * np.sin(np.arange(400)[:, None] * [0.01, 0.02])
    runs = [push_plant(robot, command, 2e-3, substeps=4)
            for robot in (ideal_robot, replace(ideal_robot, effects=(spec,)))]
    assert np.abs(runs[0][-1, 0] - runs[1][-1, 0]).max() > 1e-6


@pytest.mark.parametrize(('name', 'values'), [
    ('base_flexibility', (6.0, 0.05, 0.05)), ('encoder_skew', (2e-3,)),
    ('link_encoder_eccentricity', (0.1, 0.3)), ('recording_delay', (2e-3,))])
def test_an_encoder_that_reads_rates_reads_those_of_the_angles_it_reads(ideal_robot, name, values):
    """Against central differences of what was read, which are off by period^2 / 6 q'''."""
    spec = effect_on('joint1', name, *values)
    period, read, true = 2.5e-4, [], []
    plant = SteppedPlant(replace(ideal_robot, effects=(spec,)), period=period, substeps=20)
    plant.measure()
    for k in range(4000):
        seen = plant.measured
        read.append(np.array([[seen.q_link, seen.q_motor], [seen.dq_link, seen.dq_motor]]))
        true.append([plant.state.dq_link.copy(), plant.state.dq_motor.copy()])
        plant.advance(0.3 * np.sin(2 * np.pi * period * k * np.array([3.0, 4.0])))
    angles, rates = np.swapaxes(read, 0, 1)
    differences = (angles[2:] - angles[:-2]) / (2 * period)
    error, without = (np.abs(of[1:-1] - differences)[100:].max() for of in (rates, np.array(true)))
    assert error < 0.05 * without


@pytest.mark.parametrize('substep', [DT, 2e-3])
def test_a_lag_follows_a_step_exponentially(substep):
    """Its mean over each step, whatever the step: the end of a step would come too early."""
    lag, edges = 0.01, np.arange(301) * substep
    found = along('actuator_lag', [lag], sig.TORQUE, np.full(300, 0.5), dt=substep)
    gone = -lag / substep * np.diff(np.exp(-edges / lag))
    np.testing.assert_allclose(found, 0.5 * (1.0 - gone), rtol=1e-9)


@pytest.mark.parametrize('delay', [0.0031, 0.0117, 0.02])
@pytest.mark.parametrize('substep', [DT, 2e-3])
def test_a_delay_gives_every_held_command_later(delay, substep):
    """The mean over each substep of the held commands shifted, whatever the substep."""
    period, held = 2e-3, np.random.default_rng(1).standard_normal(60)
    given = along('input_delay', [delay], sig.TORQUE, np.repeat(held, round(period / substep)),
                  dt=substep)
    edges = np.arange(len(given) + 1) * substep - delay
    integral = np.interp(edges, np.arange(61) * period, np.cumsum([0.0, *held]) * period)
    np.testing.assert_allclose(given, np.diff(integral) / substep, atol=1e-11)


def test_hysteresis_yields_at_its_force_and_springs_back():
    """Up: force / yield per radian, then flat; back: the full slope again."""
    torsion = np.concatenate([np.linspace(0, 0.01, 101), np.linspace(0.01, 0.002, 81)[1:]])
    torque = along('spring_hysteresis', [0.01, 0.004], sig.TORSION, torsion, sig.SPRING)
    up = np.minimum(2.5 * torsion[:101], 0.01)
    down = np.maximum(0.01 - 2.5 * (0.01 - torsion[101:]), -0.01)
    np.testing.assert_allclose(torque, np.concatenate([up, down]), atol=1e-14)


@pytest.mark.parametrize(('wrong', 'sentence'), [
    ('backlsh', "effect 'backlsh' is not in the catalogue; did you mean 'backlash'?"),
    ('cubic_spring', "did you mean 'spring_cubic'?"),
    ('zzz', 'is not in the catalogue; known: actuator_deadzone, ')])
def test_an_unknown_effect_is_refused_with_the_nearest(wrong, sentence):
    with pytest.raises(ParameterError, match=re.escape(sentence)):
        registry.find(wrong)


@pytest.mark.parametrize(('given', 'sentence'), [
    ({}, r'effects.j.backlash.half_gap \[rad\] is missing: half width of the play'),
    *(({'half_gap': value}, f'half_gap must be a number from 0 to inf rad, got {value}')
      for value in (-0.1, np.nan, np.inf))])
def test_values_an_effect_does_not_allow_are_refused(given, sentence):
    with pytest.raises(ParameterError, match=sentence):
        registry.find('backlash').values(given, 'effects.j.backlash')


def test_terms_run_in_the_order_of_stages_then_of_the_file():
    """Gain before saturation as written; the spring after the torsion, wherever written."""
    joints = ('j0', 'j1', 'j2')
    names = (('spring_cubic', [100.0]), ('spring_offset', [0.1]), ('torque_gain', [1.0]),
             ('actuator_saturation', [0.5]))
    specs = [effect_on('j1', name, *values) for name, values in names]
    for order, torque in ((specs, 0.5), ([*specs[:2], specs[3], specs[2]], 1.0)):
        entry, signals = table.build(order, joints), np.zeros((3, sig.WIDTH))
        signals[:, sig.TORQUE] = 0.7
        memory = np.zeros(table.MEMORY_SIZE)
        for stage in Stage:
            table.run_stage(int(stage), signals, memory, DT, entry)
        np.testing.assert_allclose(signals[:, sig.TORQUE], [0.7, torque, 0.7])
        np.testing.assert_allclose(signals[:, sig.SPRING], [0.0, 100.0 * 0.1 ** 3, 0.0])


def test_terms_with_memory_do_not_share_it():
    """The same lag twice on one joint and once on another: three filters."""
    joints = ('j0', 'j1', 'j2')
    lag = [effect_on(joint, 'actuator_lag', 0.01) for joint in ('j1', 'j1', 'j0')]
    entry, memory = table.build(lag, joints), np.zeros(table.MEMORY_SIZE)
    for _ in range(100):
        signals = np.zeros((3, sig.WIDTH))
        signals[:, sig.TORQUE] = 1.0
        table.run_stage(int(Stage.ACTUATOR), signals, memory, DT, entry)
    once = 1.0 - 0.01 / DT * (np.exp(-99 * DT / 0.01) - np.exp(-100 * DT / 0.01))
    assert signals[0, sig.TORQUE] == pytest.approx(once, rel=1e-12)
    assert signals[1, sig.TORQUE] < 0.6 * once
    assert signals[2, sig.TORQUE] == 1.0


def test_more_effects_than_the_table_holds_are_refused():
    many = [effect_on('j0', 'torque_gain', 0.1)] * (table.MAX_TERMS + 1)
    with pytest.raises(ParameterError, match='65 effects are more than the 64 that'):
        table.build(many, ('j0',))
    table.build(many[1:], ('j0',))
    large = type('LargeMemory', (registry.find('actuator_lag'),), {'memory_size': 3000})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table, 'find', lambda name: large)
        with pytest.raises(ParameterError, match='3000 remembered numbers of effects are more'):
            table.build(many[:1], ('j0',))


def test_a_drift_ends_with_its_duration():
    """A robot that runs for longer than was recorded does not lose its spring."""
    signals = np.ones((3, sig.WIDTH))
    for name, signal in (('friction_drift', sig.FRICTION), ('stiffness_drift', sig.SPRING)):
        for time, expected in ((30.0, 0.75), (60.0, 0.5), (600.0, 0.5)):
            signals[:, sig.TIME] = time
            after = run_compiled(name, (-0.5, 60.0), signals)
            assert after[1, signal] == pytest.approx(expected)


def with_effect(robot, name, joint, *values):
    """Return the robot with one change put into its parameters."""
    return table.with_changes(affected(robot, joint, name, *values))


def test_changes_are_other_parameters(ideal_robot):
    """And leave no effect behind, nor touch the robot they started from."""
    changed = with_effect(ideal_robot, 'stiffness_error', 'joint2', 0.2)
    np.testing.assert_allclose(changed.arm.stiffness, ideal_robot.arm.stiffness * [1.0, 1.2])
    assert changed.effects == ()
    changed = with_effect(ideal_robot, 'motor_inertia_error', 'joint1', -0.5)
    np.testing.assert_allclose(changed.arm.motor_inertia, [0.003, 0.005])
    np.testing.assert_array_equal(ideal_robot.arm.motor_inertia, [0.006, 0.005])
    changed = with_effect(ideal_robot, 'gravity_tilt', 'arm', np.radians(1.0), np.pi / 2)
    np.testing.assert_allclose(changed.arm.gravity, [0.0, 9.80665 * np.sin(np.radians(1.0))],
                               atol=1e-15)


def test_the_order_in_a_file_does_not_change_the_robot(ideal_robot):
    """A link heavier than believed does not make heavier what it carries."""
    payload = effect_on('arm', 'tip_payload', 0.5)
    heavier = effect_on('joint2', 'link_inertia_error', 0.5)
    one, other = (table.with_changes(replace(ideal_robot, effects=effects)).arm
                  for effects in ((payload, heavier), (heavier, payload)))
    for name in ('mass', 'com', 'inertia'):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.mass[1] == 1.5 * ideal_robot.arm.mass[1] + 0.5


def test_errors_of_friction_and_inertia_are_other_parameters(ideal_robot):
    """Of their joint alone; a level below what is possible stops there."""
    before = ideal_robot.friction
    after = with_effect(ideal_robot, 'coulomb_error', 'joint2', 0.3).friction
    for side, changed in zip((before.forward, before.backward), (after.forward, after.backward),
                             strict=True):
        np.testing.assert_allclose(changed.static, side.static * [1.0, 1.3])
        np.testing.assert_allclose(changed.coulomb, side.coulomb * [1.0, 1.3])
    after = with_effect(ideal_robot, 'stribeck_error', 'joint1', 0.25).friction
    np.testing.assert_allclose(after.forward.static - before.forward.static,
                               [0.25 * before.forward.coulomb[0], 0.0])
    after = with_effect(ideal_robot, 'stribeck_error', 'joint1', -0.9).friction
    assert after.backward.static[0] == before.backward.coulomb[0]
    after = with_effect(ideal_robot, 'presliding_error', 'joint1', -0.4).friction
    np.testing.assert_allclose(after.stiffness, before.stiffness * [[0.6], [1.0]])
    np.testing.assert_array_equal(after.weight, before.weight)
    arm = with_effect(ideal_robot, 'link_inertia_error', 'joint2', 0.4).arm
    np.testing.assert_allclose(arm.mass, ideal_robot.arm.mass * [1.0, 1.4])
    np.testing.assert_allclose(arm.inertia, ideal_robot.arm.inertia * [1.0, 1.4])


def test_a_payload_adds_the_energy_of_a_mass_at_the_tip(ideal_robot):
    rng = np.random.default_rng(0)
    q, dq = rng.standard_normal(2), rng.standard_normal(2)
    loaded = with_effect(ideal_robot, 'tip_payload', 'arm', 0.25).arm
    theta, omega = np.cumsum(q), np.cumsum(dq)
    tip = (ideal_robot.arm.length * omega) @ np.stack([-np.sin(theta), np.cos(theta)], axis=1)
    added = (core_runs.energy(q, dq, q, dq, loaded)
             - core_runs.energy(q, dq, q, dq, ideal_robot.arm))
    assert added == pytest.approx(0.5 * 0.25 * tip @ tip, rel=1e-12)


def test_a_sensor_effect_changes_what_is_measured_and_not_what_is_true(ideal_robot, gains):
    spec = effect_on('joint2', 'link_encoder_eccentricity', 0.02, 0.5)
    robot = replace(ideal_robot, effects=(spec,))
    run = loop.run(robot, ideal_robot, gains, hold([0.0, 0.0]), duration=0.1)
    measured, true = run.measured[:, 0], run.true[:, 0]
    np.testing.assert_allclose(measured[:, 1], true[:, 1] + 0.02 * np.sin(true[:, 1] + 0.5),
                               rtol=1e-14)
    np.testing.assert_array_equal(measured[:, 0], true[:, 0])
