# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Friction that real axes asked for, its load, and recordings stamped late."""

from dataclasses import replace

from core_runs import effect_on, single_axis
from gms_flex_control import friction as gms
from gms_flex_control.data.recording import later
from gms_flex_control.effects import base as sig
from gms_flex_control.effects import table
from gms_flex_control.effects.base import Stage
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import FrictionParams, StribeckParams
from gms_flex_control.simulation import plant
import numpy as np
import pytest

pytestmark = pytest.mark.fast

VISCOUS = StribeckParams(static=[1e-14], coulomb=[1e-14], velocity=[1.0], viscous=[0.02])


@pytest.fixture(scope='module')
def single_rigid():
    """Return a rigid axis of 0.05 kg m^2 with viscous friction alone, 0.02 N m s/rad."""
    friction = FrictionParams(forward=VISCOUS, backward=VISCOUS, stiffness=[[1e-14]],
                              weight=[[1.0]], attraction=[1.0])
    return single_axis(friction, 0.05)


@pytest.mark.parametrize('delay', [0.0, 0.006, -0.004, 0.0047, -0.0113])
def test_torques_are_moved_to_where_the_angles_belong(delay):
    """By whole samples exactly; by parts of them the two torques share each sample."""
    torque = np.random.default_rng(4).standard_normal((50, 2))
    moved = later(torque, 2e-3 * np.arange(51), delay)
    whole, part = divmod(round(delay / 2e-3, 9), 1.0)
    for k in range(10, 40):
        source = k - int(whole)
        np.testing.assert_allclose(
            moved[k], (1.0 - part) * torque[source] + part * torque[source - 1], atol=1e-12)
    if delay > 0.0:
        np.testing.assert_allclose(moved[0], torque[0])


HYSTERESIS = 0.02, 0.01   # force [N m], reach [rad]
YIELDS = 0.01 * 10.0 ** (-0.5 * np.arange(4))


def torque_along(name, values, angle):
    """Return the torque that an effect on friction has along link angles (T,)."""
    entry = table.build([effect_on('axis', name, *values)], ('axis',))
    memory, torque = np.zeros(table.MEMORY_SIZE), []
    for q in angle:
        signals = np.zeros((1, sig.WIDTH))
        signals[0, sig.Q_LINK] = q
        table.run_stage(int(Stage.FRICTION), signals, memory, 1e-3, entry)
        torque.append(signals[0, sig.FRICTION])
    return np.array(torque)


def hysteresis_along(angle):
    """Return the torque of friction_hysteresis along link angles (T,)."""
    return torque_along('friction_hysteresis', HYSTERESIS, angle)


def test_friction_behind_a_play_is_absent_until_the_play_is_crossed():
    """Up it slips; back, it falls over its reach, is gone over the play, and rises again."""
    force, gap, reach = 0.02, 0.003, 0.002
    up, down = np.linspace(0.0, 0.02, 201), np.linspace(0.02, 0.0, 201)
    torque = torque_along('friction_backlash', (force, gap, reach),
                          3.0 + np.concatenate([up, down[1:]]))
    np.testing.assert_allclose(torque[:201], force * np.clip((up - gap) / reach, 0.0, 1.0),
                               atol=1e-12)
    back = 0.02 - down
    expected = np.where(back < reach, 1.0 - back / reach,
                        -np.clip((back - reach - 2.0 * gap) / reach, 0.0, 1.0))
    np.testing.assert_allclose(torque[200:], force * expected, atol=1e-12)


def test_friction_behind_a_play_without_play_is_an_elasto_plastic_element():
    """One of friction_hysteresis, whose four elements have a quarter of the force each."""
    angle = np.cumsum(np.random.default_rng(0).normal(0.0, 4e-3, 500))
    force, reach = HYSTERESIS
    alone = sum(torque_along('friction_backlash', (force / 4, 0.0, part), angle)
                for part in YIELDS)
    np.testing.assert_allclose(alone, hysteresis_along(angle), atol=1e-12)
    assert reach == YIELDS[0]


def test_friction_hysteresis_follows_masing_from_its_four_yields():
    """A virgin curve of four elements; back, the same curve at twice the size."""
    def virgin(displacement):
        return np.sum(HYSTERESIS[0] / 4 * np.minimum(displacement / YIELDS[:, None], 1.0), axis=0)
    up, down = np.linspace(0.0, 0.006, 61), np.linspace(0.006, -0.006, 121)
    torque = hysteresis_along(3.0 + np.concatenate([up, down[1:]]))
    np.testing.assert_allclose(torque[:61], virgin(up), atol=1e-14)
    np.testing.assert_allclose(torque[60:], virgin(up[-1:]) - 2.0 * virgin(0.5 * (0.006 - down)),
                               atol=1e-14)
    assert hysteresis_along([0.0, 1.0])[1] == pytest.approx(HYSTERESIS[0])


@pytest.mark.parametrize(('name', 'values'), [
    ('friction_hysteresis', (0.1, 1e-323)), ('friction_backlash', (0.1, 0.0, 1e-323))])
def test_a_reach_that_is_next_to_none_is_as_none(name, values):
    """Where shares of it are zero, torque would be no number."""
    assert not np.any(torque_along(name, values, np.linspace(0.0, 0.02, 50)))


@pytest.mark.parametrize('seed', range(4))
def test_friction_hysteresis_gives_back_no_more_than_it_took(seed):
    """Work along any cycle, once it repeats, is lost; before, stored energy is never below 0."""
    rng = np.random.default_rng(seed)
    cycle = rng.standard_normal(30) * 10.0 ** rng.uniform(-4.0, -1.0)
    cycle = np.concatenate([np.linspace(a, b, 20, endpoint=False)
                            for a, b in zip(cycle, np.roll(cycle, -1), strict=True)])
    angle = np.concatenate([np.tile(cycle, 3), cycle[:1]])
    torque = hysteresis_along(angle)
    work = np.cumsum(torque[1:] * np.diff(angle))  # torque at the end of a step: never too small
    assert work.min() >= 0.0
    assert work[-1] - work[-1 - len(cycle)] >= 0.0


@pytest.mark.parametrize('rotor', [0.0, 0.02])
def test_the_load_of_a_rigid_joint_is_what_its_link_takes(single_rigid, rotor):
    """Weight, inertia and friction of the link; what turns the rotor is not transmitted."""
    arm = ArmParams(kind='planar', mass=[0.5], length=[0.4], com=[0.2], inertia=[0.01],
                    motor_inertia=[rotor], stiffness=[np.inf], damping=[0.0], gravity=[0.0, -9.81])
    spec = effect_on('axis', 'load_friction', 0.2, 1e-9)
    robot = replace(single_rigid, arm=arm, effects=(spec,))
    state, work = plant.init(robot, [0.3]), plant.workspace(1)
    state.dq_link[:] = state.dq_motor[:] = 0.7
    for k in range(20):  # the acceleration is that of the substep before
        q, v = float(state.q_link[0]), float(state.dq_link[0])
        plant.substep(state, np.array([1.5]), k * 1e-7, 1e-7, plant.constants_of(robot), work)
    load = 0.5 * 0.2 * 9.81 * np.cos(q) + 0.03 * work.signals[0, sig.DDQ_LINK]
    friction = 0.02 * v  # without it
    load = (load + friction) / (1.0 - 0.2)
    assert work.signals[0, sig.SPRING] == pytest.approx(load, rel=1e-6)
    assert work.signals[0, sig.FRICTION] == pytest.approx(friction + 0.2 * load)


@pytest.mark.parametrize('delay', [0.02, -0.005])
def test_a_recording_delay_shifts_all_that_is_sensed_and_moves_nothing(ideal_robot, delay):
    """Along sines of 1 Hz to third order of the delay; the robot itself runs as without it."""
    spec = effect_on('arm', 'recording_delay', delay)
    robot, w = replace(ideal_robot, effects=(spec,)), 2.0 * np.pi
    state, work = plant.init(robot), plant.workspace(2)
    constants, motion = plant.constants_of(robot), np.empty((1, 6, 2))
    for t in np.linspace(0.0, 1.0, 21):
        phase = w * t + np.arange(2)
        motion[0, :3] = np.sin(phase), w * np.cos(phase), -w * w * np.sin(phase)
        motion[0, 3:] = 1.1 * motion[0, :3]
        plant.take_place(0, motion, np.zeros(2), t, state, work)
        plant.run_sensors(state, 2e-3, constants, work)
        older = np.sin(phase - w * delay)
        np.testing.assert_allclose(work.signals[:, sig.SENSED_LINK], older,
                                   atol=abs(w * delay) ** 3 / 6)
        np.testing.assert_allclose(work.signals[:, sig.SENSED_MOTOR], 1.1 * older,
                                   atol=1.1 * abs(w * delay) ** 3 / 6)


@pytest.mark.parametrize(('name', 'values'), [
    ('friction_hysteresis', HYSTERESIS), ('load_friction', (0.1, 1e-3)),
    ('low_speed_friction', (-0.3, 0.05)), ('shear_thinning', (0.03, 0.1, 0.5)),
    ('viscous_asymmetry', (0.03,))])
def test_friction_along_a_motion_is_that_of_the_run_that_made_it(ideal_robot, name, values):
    """What a residual is formed with: the same kernels, called along the path of a plant."""
    spec = effect_on('joint1', name, *values)
    robot = replace(ideal_robot, effects=(spec,))
    constants, dt = plant.constants_of(robot), 1e-3
    state, again = plant.init(robot), plant.init(robot)
    work, replay, added = plant.workspace(2), plant.workspace(2), []
    before = state.q_link.copy()
    for k in range(2000):
        command = 0.4 * np.sin(k * np.array([0.004, 0.006]))
        motion = np.array([[state.q_link, state.dq_link, work.signals[:, sig.DDQ_LINK],
                            state.q_motor, state.dq_motor, work.signals[:, sig.DDQ_MOTOR]]])
        gms.advance(again.friction, state.q_link - before, state.dq_link, dt, constants.friction)
        before = state.q_link.copy()
        plant.substep(state, command, k * dt, dt, constants, work)
        plant.take_place(0, motion, command, k * dt, again, replay)
        plant.torques(again, dt, constants, replay)
        np.testing.assert_allclose(replay.signals[:, sig.FRICTION],
                                   work.signals[:, sig.FRICTION], rtol=1e-9, atol=1e-13)
        added.append(replay.signals[0, sig.FRICTION] - replay.friction[0])
    assert np.ptp(added) > 2e-3
