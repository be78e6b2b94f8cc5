# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Effects that the robot file names are part of the model an identification relies on."""

from dataclasses import replace
from functools import cache
import re

from bench.hidden_robots.motions import draw_reference
from bench.identification_simulated import simulate_identification
from core_runs import affected, effect_on
from discrepancy_runs import driven
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import rms
from gms_flex_control.errors import IdentificationError
from gms_flex_control.experiment.identification_plan import plan_identification
from gms_flex_control.identification.assumed_robot import believed_model, cleared, with_actuators
from gms_flex_control.identification.believed_arm import Believed
from gms_flex_control.identification.coordinates import Coordinates
from gms_flex_control.identification.objective import Objective
from gms_flex_control.identification.problem import Problem
from gms_flex_control.identification.recording_checks import check
from identified_axis import axis, GAINS, JOINT, part, PLAN
import numpy as np
import pytest

STRONG = {
    'constant_link_torque': (0.03,), 'quadratic_drag': (0.05,), 'spring_offset': (0.02,),
    'spring_cubic': (60.0,), 'backlash': (0.02,),
    'position_friction': (0.3, 4.0, 0.0), 'load_friction': (0.3, 0.001),
    'friction_drift': (2.0, 60.0), 'friction_hysteresis': (0.03, 0.005),
    'spring_hysteresis': (0.02, 0.005), 'stiffness_error': (0.2,), 'stiffness_drift': (0.3, 60.0)}


def specs(*names):
    """Return strong effects on the joint."""
    return tuple(effect_on(JOINT, name, *STRONG[name]) for name in names)


def plan_of(robot):
    """Return the plan of slow and fast strokes."""
    return plan_identification(
        {f'identification.{key}': value for key, value in PLAN.items()}, robot, GAINS)


@cache
def recorded(name, rigid):
    """Return a recording of slow and fast strokes of an axis that has an effect."""
    plain = axis(rigid=rigid)
    robot = replace(plain, effects=specs(name))
    return simulate_identification(plan_of(plain), robot, GAINS, 1, rate=500, model=robot)


def steady_error(name, effects, rigid):
    """Return how far steady friction of fast strokes is from the truth, at worst over F_c."""
    robot = replace(axis(rigid=rigid), effects=effects,  # another spring may stand for one
                    uncertainty={('stiffness', JOINT): 1e-4})
    (friction,) = Problem([recorded(name, rigid)], (), believed_model(robot)).maps
    off = []
    for sign, truth in ((1.0, axis().friction.forward), (-1.0, axis().friction.backward)):
        kept = friction.steady & (sign * friction.velocity > 4.0 * truth.velocity[0])
        expected = truth.coulomb[0] + truth.viscous[0] * sign * friction.velocity[kept]
        off.append(np.median(sign * friction.torque[kept] - expected) / truth.coulomb[0])
    return np.abs(off).max()


@pytest.mark.parametrize(('name', 'rigid'), [
    *((name, False) for name in STRONG), ('constant_link_torque', True),
    ('quadratic_drag', True), ('position_friction', True), ('load_friction', True)])
def test_an_effect_that_is_named_does_not_end_in_the_friction(name, rigid):
    """With it the steady friction is near the truth; farther off without, if nothing shows it."""
    known, ignored = (steady_error(name, effects, rigid) for effects in (specs(name), ()))
    assert known < 0.09
    if name == 'spring_offset':
        assert ignored < 0.09
    else:
        assert ignored > 2.0 * known


@pytest.mark.parametrize('name', ['actuator_lag', 'torque_gain', 'input_delay'])
def test_torques_that_acted_follow_from_commands_where_drives_have_effects(name):
    """As the simulated drive applied them, from commands, or from efforts that were commands."""
    values = {'actuator_lag': (0.02,), 'torque_gain': (0.3,), 'input_delay': (0.01,)}[name]
    drive = affected(axis(rigid=True), JOINT, name, *values)
    recording, _ = simulate_identification(plan_of(drive), drive, GAINS, 1, torque_noise=0.0)
    acted, asked = recording.tau_motor[1:], recording.command[:-1]
    assert rms(asked - acted) > 0.1 * rms(acted)
    commands_alone = replace(recording, tau_motor=np.full_like(recording.tau_motor, np.nan))
    efforts_alone = replace(recording, command=np.full_like(recording.command, np.nan),
                            tau_motor=np.roll(recording.command, 1, axis=0))
    for one in (commands_alone, efforts_alone):
        assert rms(with_actuators(one, drive).tau_motor[1:] - acted) < 0.01 * rms(acted)
    assert with_actuators(recording, axis(rigid=True)) is recording


@pytest.mark.parametrize('kind', ['command', 'tau_motor'])
def test_a_torque_that_was_not_recorded_is_the_last_one(kind):
    """A drive of 1.3 times the torque asked for gives that of the last command in a gap."""
    drive = affected(axis(rigid=True), JOINT, 'torque_gain', 0.3)
    torque, none = 1.0 + np.arange(400.0)[:, None], np.full((400, 1), np.nan)
    torque[200:203] = np.nan
    recording = Recording(joints=(JOINT,), time=2e-3 * np.arange(400), source='here',
                          **{'command': none, 'tau_motor': none} | {kind: torque})
    acted = with_actuators(recording, drive).tau_motor[1:, 0]
    asked = torque[:-1, 0] if kind == 'command' else torque[1:, 0]
    known = np.isfinite(asked)
    np.testing.assert_allclose(acted[known], 1.3 * asked[known])
    np.testing.assert_allclose(acted[~known], 1.3 * 200.0)


def test_errors_of_encoders_are_taken_off_the_readings():
    """A motor read late on a sinusoid, a link encoder off centre: what is left is the motion."""
    base, _ = part(recorded('backlash', False), 0.0, 10.0)
    time = base.time
    q, late, off = np.sin(2.0 * time), 4e-3, 0.02 * np.sin(np.sin(2.0 * time) + 0.3)
    motor = q + 0.1
    recording = replace(base, q_link=(q + off)[:, None],
                        q_motor=(np.sin(2.0 * (time - late)) + 0.1)[:, None])
    robot = replace(axis(), effects=(effect_on(JOINT, 'encoder_skew', late),
                                     effect_on(JOINT, 'link_encoder_eccentricity', 0.02, 0.3)))
    found = cleared(recording, believed_model(robot))
    assert np.abs(found.q_motor[:, 0] - motor)[50:-50].max() < 1e-4
    assert np.abs(found.q_link[:, 0] - q)[50:-50].max() < 5e-4


def test_a_late_encoder_is_cleared_where_its_motor_is_quick():
    """At 4 Hz 4 ms are a tenth of a radian: its square is a hundredth of the motion."""
    base, _ = part(recorded('backlash', False), 0.0, 10.0)
    speed, late = 2.0 * np.pi * 4.0, 4e-3
    motor = 0.1 * np.sin(speed * base.time)
    recording = replace(base, q_link=motor[:, None],
                        q_motor=0.1 * np.sin(speed * (base.time - late))[:, None])
    robot = affected(axis(), JOINT, 'encoder_skew', late)
    found = cleared(recording, believed_model(robot))
    assert np.abs(found.q_motor[:, 0] - motor)[50:-50].max() < 0.004 * 0.1
    assert found.q_link == pytest.approx(recording.q_link, abs=1e-12)


@pytest.mark.parametrize(('name', 'values'), [
    ('coulomb_error', (0.1,)), ('stribeck_error', (0.1,)), ('presliding_error', (0.1,)),
    ('viscous_error', (0.1,)),
    ('base_flexibility', (5.0, 1.0, 0.05))])
def test_an_effect_that_is_indistinguishable_is_refused_by_name(name, values):
    """What changes the friction itself would be counted twice; with force it is left out."""
    robot = affected(axis(), JOINT, name, *values)
    with pytest.raises(IdentificationError, match=f'effects.{JOINT}.{name}.* take it out'):
        believed_model(robot)
    with pytest.warns(UserWarning, match='left out'):
        assert believed_model(robot, force=True).effects == ()


def test_a_flexible_joint_whose_link_nobody_sees_is_refused_with_the_way_out():
    recording, _ = part(recorded('backlash', False), 0.0, 10.0)
    unseen = replace(recording, q_link=np.full_like(recording.q_link, np.nan))
    said = [one.text for one in check(unseen, axis()) if one.severity == 'refuse']
    assert re.search(f'record either, .* as rigid, .* {JOINT}_motor', *said)


def test_where_the_arm_is_estimated_effects_are_refused_but_the_one_found_anew():
    """A constant torque is found with the arm; a cubic spring would change what is found."""
    robot = replace(axis(), effects=specs('constant_link_torque'))
    assert believed_model(robot, whole=True).effects == robot.effects
    with pytest.raises(IdentificationError, match='spring_cubic: --estimate all'):
        believed_model(replace(axis(), effects=specs('spring_cubic')), whole=True)


def innovations(recording, robot, alone):
    """Return the innovations of the first joint with its true friction, rms [rad]."""
    bundle = Problem([(recording, ())], (), robot, alone=alone,
                     beside=Believed(robot.arm, *np.zeros((2, robot.n_joints)))).bundle
    blocks = Coordinates(robot.friction.stiffness.shape[1])
    sides = (robot.friction.forward, robot.friction.backward)
    numbers = [blocks.pack(
        *(np.array([getattr(side, name)[j] for side in sides])
          for name in ('static', 'coulomb', 'velocity', 'viscous')), robot.friction.attraction[j],
        np.mean([side.static[j] for side in sides]) * robot.friction.weight[j]
        / robot.friction.stiffness[j]) for j in range(robot.n_joints)]
    objective = Objective(bundle, 0, [blocks.parameters(each) for each in numbers])
    return np.sqrt(np.mean(objective.evaluate(blocks, numbers[0], 1.0).square))


def test_what_one_joint_lacks_does_not_disturb_another_taken_alone(robot, gains):
    """A spring that loses energy at joint 2: innovations of joint 1 grow if both move."""
    time = np.arange(6000) * 2e-3
    reference = draw_reference(np.random.default_rng(7), 'rich', 'soft', time)
    lacking = effect_on(robot.joints[1], 'spring_hysteresis', 0.01, 0.002)
    growth = {alone: np.divide(*(
        innovations(driven(robot, robot, gains, reference, time, *effects), robot, alone)
        for effects in ((lacking,), ()))) for alone in (False, True)}
    assert growth[False] > 20.0
    assert growth[True] < 2.0
