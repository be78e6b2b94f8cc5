# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Friction is fitted beside links that may be off: those of closed forms come out right."""

from dataclasses import replace

from bench import coverage
from bench.hidden_robots.cases import make_case
from bench.hidden_robots.motions import draw_reference
from core_runs import effect_on
from discrepancy_runs import driven
from gms_flex_control.identification.arm_fit import with_axis
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.identification.believed_arm import Believed, believed
from gms_flex_control.identification.identify import identify, IdentifyOptions
from identified_axis import axis, experiment, JOINT, part, pendulum
import numpy as np
import pytest

INERTIA, PULL, OFFSET = 0.02, 0.5, -1.2
COULOMB = 0.06


def described(heavier=1.0, **uncertainty):
    """Return the robot of `pendulum` as it is described, its gravity so many times the true."""
    robot = rigid_joints(['swing'])
    pull = heavier * PULL
    return replace(robot, arm=with_axis(robot.arm, 0, INERTIA, pull * np.cos(OFFSET),
                                        -pull * np.sin(OFFSET)),
                   uncertainty={(kind, 'swing'): sd for kind, sd in uncertainty.items()})


@pytest.mark.parametrize('heavier', [0.96, 1.0, 1.04])
def test_friction_is_that_of_the_joint_where_a_link_weighs_less_than_described(heavier):
    """Gravity that is 4 % off is a third of this friction: relied on, it makes that 55 % wrong."""
    found = identify([pendulum()], described(heavier), options=IdentifyOptions(blocks=(1,)))
    for side in (found.robot.friction.forward, found.robot.friction.backward):
        assert side.coulomb[0] == pytest.approx(COULOMB, rel=0.05)
    assert found.robot.arm.mass[0] == found.believed.arm.mass[0]  # as described


def test_recordings_show_the_arm_that_is_hardly_known():
    found = believed([pendulum()], described(1.3, gravity=0.3, inertia=0.3))
    pull = found.arm.mass[0] * found.arm.com[0] * np.hypot(*found.arm.gravity)
    assert pull == pytest.approx(PULL, rel=5e-3)


def test_a_soft_block_that_swings_along_with_a_sinusoid_makes_no_link_lighter():
    """It slips at the turning points, if at all: its torque goes with the angle, as inertia's."""
    seed = 143  # swings by 0.187 rad, a quarter of its friction yields at 0.195 rad
    robot = coverage.axis(seed)
    recording, _ = coverage.recorded('sinusoids', robot, robot, seed)
    found = believed([recording], robot).arm
    assert found.inertia == robot.arm.inertia and found.motor_inertia == robot.arm.motor_inertia


@pytest.mark.parametrize(('sd', 'within'), [(0.1, 3e-3), (0.015, 0.02)])
def test_the_torque_of_a_motor_shows_how_stiff_its_spring_is(sd, within):
    """The spring's own torque does not: links and friction would be off by the same factor."""
    recording, robot = experiment(rigid=False)[0], axis(rigid=False)
    stiff = replace(robot, arm=replace(robot.arm, stiffness=1.06 * robot.arm.stiffness),
                    uncertainty={('stiffness', JOINT): sd})
    found = believed([recording], stiff).arm
    assert found.stiffness == pytest.approx(robot.arm.stiffness, rel=within)
    surely = replace(stiff, uncertainty={('stiffness', JOINT): 1e-4})
    assert believed([recording], surely).arm.stiffness == stiff.arm.stiffness


def test_friction_beside_a_spring_that_is_stiffer_than_described_is_that_of_the_joint():
    """With the friction found the links are looked at again: that is of the stiffness found."""
    robot = axis(rigid=False)
    soft = replace(robot, arm=replace(robot.arm, stiffness=0.92 * robot.arm.stiffness),
                   uncertainty={('stiffness', JOINT): 0.1})
    found = identify([part(experiment(rigid=False), 0.0, 60.0)], soft,
                     options=IdentifyOptions(blocks=(4,)))
    for side, true in ((found.robot.friction.forward, robot.friction.forward),
                       (found.robot.friction.backward, robot.friction.backward)):
        assert side.coulomb[0] == pytest.approx(true.coulomb[0], rel=0.01)
    assert f'a spring of {JOINT} that is 8.' in found.warnings[0]


@pytest.mark.parametrize('early', [-0.004, 0.005])
def test_friction_is_that_of_the_joint_where_torques_are_stamped_early_or_late(early):
    """A log of 100 Hz has a torque that acts 4 ms later in the mean, or held 5 ms earlier."""
    recording = pendulum(early=early, pace=2.0)
    found = believed([recording], described())
    assert found.delay == pytest.approx([early], abs=2e-4)
    result = identify([recording], described(), options=IdentifyOptions(blocks=(1,)))
    for side in (result.robot.friction.forward, result.robot.friction.backward):
        assert side.coulomb[0] == pytest.approx(COULOMB, rel=0.05)
    assert f'{abs(1e3 * early):g} ms {"later" if early > 0.0 else "earlier"}' in result.warnings[0]


def test_torques_in_time_stay_as_they_were_recorded():
    recording = pendulum()
    assert believed([recording], described()).delay == 0.0


def test_a_ramp_of_torque_that_acts_later_is_lower_by_what_it_rose_in_between():
    recording = replace(pendulum(), tau_motor=3.0 * pendulum().time[:, None])
    late = Believed(described().arm, np.array([0.013]), np.zeros(1)).cleared(recording).tau_motor
    np.testing.assert_allclose(late[5:-5], recording.tau_motor[5:-5] - 3.0 * 0.013, atol=1e-12)


def test_an_axis_that_slides_is_believed_as_one_that_turns():
    """The equations are the same: m for rad, N for N m, kg for kg m^2."""
    recording, robot = experiment(rigid=True)[0], axis(rigid=True)
    turns, slides = (believed([recording], replace(robot, arm=replace(robot.arm, axes=axes)))
                     for axes in ('rotary', 'linear'))
    assert slides.arm.axes == 'linear'
    for name in ('inertia', 'motor_inertia', 'mass'):
        assert getattr(slides.arm, name) == getattr(turns.arm, name)


@pytest.mark.parametrize('mass', [0.5, 1.0])
def test_a_load_does_not_soften_springs_that_are_as_stiff_as_their_motors_say(robot, gains, mass):
    """Without gravity heavier links are as softer springs: the motors alone distinguish them."""
    time = np.arange(15000) * 2e-3
    reference = draw_reference(np.random.default_rng(7), 'rich', 'soft', time)
    payload = effect_on('arm', 'tip_payload', mass)
    found = believed([driven(robot, robot, gains, reference, time, payload)], robot).arm
    assert found.stiffness == pytest.approx(robot.arm.stiffness, rel=0.015)
    assert found.mass.sum() > robot.arm.mass.sum() + 0.3 * mass


@pytest.mark.parametrize('effect, seed', [
    ('spring_offset', 1), ('constant_link_torque', 1), ('motor_torque_bias', 2)])
def test_encoders_that_read_a_torsion_without_torque_are_seen_by_both_equations(effect, seed):
    """A torque that one equation alone lacks is not of the spring."""
    case = make_case('single', seed, effect=effect, duration=16.0)
    spec, = case.truth.effects
    wanted = np.zeros(2)
    if effect == 'spring_offset':  # torsion at which the spring gives no torque, as in the effect
        wanted[case.nominal.joints.index(spec.joint)] = -spec.values[0]
    found = believed([case.recording], case.nominal)
    np.testing.assert_allclose(found.zero, wanted, rtol=0.03)
    left = found.cleared(case.recording).q_motor - case.recording.q_motor
    np.testing.assert_allclose(left, np.broadcast_to(-found.zero, left.shape), atol=1e-9)
    assert ('of torsion where its spring' in found.words(case.nominal)) is any(wanted)
