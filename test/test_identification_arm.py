# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Inertia, gravity, stiffness and motor inertia nobody has reported."""

from dataclasses import replace
from types import SimpleNamespace

from gms_flex_control.data.recording import Recording
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification import axis_fit
from gms_flex_control.identification.arm_fit import arm_estimates, estimate_arm, folded
from gms_flex_control.identification.arm_regression import fit_base_parameters
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.identification.axis_fit import fit_axis, held_torque
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.inertial_parameters import all_parameters, base_of, IN_PLANE
from gms_flex_control.identification.motor_equation import motor_equation_of
from gms_flex_control.params.arm import ArmParams, in_space
from gms_flex_control.simulation import plant
from identified_axis import axis, experiment, pendulum
import numpy as np
import pytest

ALL = IdentifyOptions(estimate='all', blocks=(1, 3))


def fitted(recorded):
    """Return the AxisFit of one recording."""
    return fit_axis(axis_fit.axis_samples([recorded], held_torque(0), 0), 'swing', 'here')


@pytest.mark.parametrize(('pull', 'constant'), [(0.5, 0.0), (0.0, 0.0), (0.0, 0.2)])
def test_inertia_gravity_and_a_constant_torque_are_those_a_pendulum_was_made_with(pull, constant):
    """Neither gravity nor a constant is made up; one too large for asymmetric friction is one."""
    recorded = pendulum(pull=pull, constant=constant)
    fit = fitted(recorded)
    assert fit.has_gravity == (pull > 0.0) and fit.per_load == 0.0
    assert fit.inertia == pytest.approx(0.02, rel=0.02)
    assert fit.constant == pytest.approx(constant, rel=0.03)
    if pull:
        assert fit.gravity_torque == pytest.approx(pull, rel=0.02)
        assert fit.offset == pytest.approx(-1.2, abs=0.02)


def test_a_bent_torque_is_no_gravity_that_a_constant_torque_takes_away():
    """As of a cable: a parabola of the angle is gravity but for its mean, which is not there."""
    recorded = pendulum(pull=0.0)
    angle = 0.5 * recorded.q_link
    recorded = replace(recorded, q_link=angle, tau_motor=recorded.tau_motor + 0.015 * angle ** 2)
    fit = fitted(recorded)
    assert (fit.has_gravity, fit.constant) == (False, 0.0)
    assert fit.inertia == pytest.approx(0.04, rel=0.05)
    assert fit.friction == pytest.approx(0.08, rel=0.2)  # viscous part included


def test_gravity_that_is_there_without_a_constant_torque_is_taken_beside_a_bent_torque():
    """As of an arm with a counterweight: a slope of the angle, and a bend that has no mean."""
    take = pendulum(pull=0.0)
    wander = np.convolve(np.random.default_rng(3).standard_normal(len(take.time) + 59),
                         np.full(60, 60.0 ** -0.5), 'valid')[:, None]
    bent = 0.15 * np.sin(take.q_link) + 0.05 * (1.0 - np.cos(take.q_link)) + 0.05 * wander
    take = replace(take, tau_motor=take.tau_motor + bent)
    fit = fitted(take)
    assert fit.has_gravity and fit.sine == pytest.approx(0.15, rel=0.1)
    assert fit.inertia == pytest.approx(0.02, rel=0.03)


def test_inertia_and_gravity_are_those_below_the_resonance_of_what_carries_the_axis():
    """Shaken at 10 Hz, above its resonance, it looks as if it had a negative inertia."""
    take = pendulum()
    shaken = 0.01 * np.sin(20.0 * np.pi * take.time)
    torque = 0.02 * (20.0 * np.pi) ** 2 * shaken
    torque[1:] = 0.5 * (torque[1:] + torque[:-1])
    take = replace(take, q_link=take.q_link + shaken[:, None],
                   tau_motor=take.tau_motor + torque[:, None])
    fit = fit_axis(axis_fit.samples_that_agree([take], held_torque(0), 0, True), 'swing', 'here')
    assert fit.inertia == pytest.approx(0.02, rel=0.1)
    assert fit.gravity_torque == pytest.approx(0.5, rel=0.1)


def test_what_is_beside_gaps_that_cut_a_quick_motion_does_not_bend_friction():
    take = pendulum(rate=50.0, seconds=50.0, pace=2.0, pull=0.0)
    kept = (take.time % 2.6 > 0.05) | (take.time < 1.0)
    found = identify([(take.of_samples(kept), ())], rigid_joints(take.joints), options=ALL)
    for steady in (found.robot.friction.forward, found.robot.friction.backward):
        assert steady.coulomb[0] == pytest.approx(0.06, rel=0.2)


@pytest.mark.parametrize(('change', 'left'), [(-0.5, 0.5), (-8.0, 0.1)])
def test_an_inertia_is_reported_as_it_is_written(change, left):
    """Where friction takes more than all of it, a part stays."""
    recorded = pendulum(seconds=12.0, pull=0.0)
    fit = estimate_arm([recorded], rigid_joints(recorded.joints))
    joint, = fit.joints
    theta = np.append(np.zeros(3), change * joint.axis.inertia / joint.units)
    (inertia, *_), = arm_estimates(fit.robot, fit, [theta], [
        SimpleNamespace(covariance=np.eye(len(theta)))])
    assert inertia.value == folded(fit.robot, fit, [theta]).arm.inertia[0]
    assert inertia.value == pytest.approx(left * joint.axis.inertia)


def test_a_linear_axis_has_no_gravity_that_turns_with_its_position():
    recorded = pendulum()
    robot = rigid_joints(recorded.joints)
    found = estimate_arm([recorded], replace(robot, arm=replace(robot.arm, axes='linear')))
    assert not {1, 2} & set(found.joints[0].numbers) and not found.robot.arm.gravity.any()


def test_motion_one_way_has_no_constant_torque_beside_friction():
    """Half of it would be as much friction, and half of the friction a constant torque."""
    recorded = pendulum(pull=0.0)
    forward = np.cumsum(np.abs(np.diff(recorded.q_link[:, 0], prepend=recorded.q_link[0, 0])))
    rate = np.gradient(forward, recorded.time)
    torque = 0.06 + 0.01 * rate + 0.02 * np.gradient(rate, recorded.time)
    fit = fitted(replace(recorded, q_link=forward[:, None], tau_motor=torque[:, None]))
    assert fit.constant == 0.0
    assert fit.friction == pytest.approx(0.06 + 0.01 * np.median(rate), rel=0.1)


def test_friction_is_alike_both_ways_beside_a_constant_torque():
    """Both are the same in motion, and forces that the model lacks would divide them."""
    recorded, rng = pendulum(pull=0.0, constant=0.2), np.random.default_rng(0)
    waves = np.sin(2.0 * np.pi * np.outer(recorded.time, rng.uniform(0.3, 3.0, 6))
                   + rng.uniform(0.0, 6.0, 6))
    recorded = replace(recorded, tau_motor=recorded.tau_motor + 0.04 * waves.sum(axis=1)[:, None])
    found = identify([(recorded, ())], rigid_joints(('swing',)), options=ALL).robot
    forward, backward = (steady.coulomb[0] for steady in (
        found.friction.forward, found.friction.backward))
    assert forward == pytest.approx(backward, rel=0.05)
    assert forward == pytest.approx(0.06, rel=0.2)
    assert found.effects[0].values[0] == pytest.approx(-0.2, rel=0.05)


def test_a_torque_that_never_changes_shows_no_inertia():
    recorded = pendulum()
    with pytest.raises(IdentificationError, match='never changes'):
        fitted(replace(recorded, tau_motor=np.full_like(recorded.tau_motor, 0.3)))


def test_a_ripple_of_the_gear_is_found_and_friction_is_not_bent_by_it():
    recorded = pendulum(ripple=(0.03, 40.0, 0.6), seconds=20.0)
    found = identify([(recorded, ())], rigid_joints(recorded.joints), options=ALL)
    ripple, = found.robot.effects
    amplitude, order, phase = ripple.values
    assert ripple.name == 'torque_ripple'
    assert amplitude == pytest.approx(0.03, rel=0.1)
    assert order == pytest.approx(40.0, abs=0.1)
    assert np.angle(np.exp(1j * (phase - 0.6))) == pytest.approx(0.0, abs=0.1)
    by_name = {estimate.name: estimate for estimate in found.joints[0].estimates}
    low, high = by_name['effects.swing.torque_ripple.order'].interval
    assert low < 40.0 < high
    steady = found.robot.friction.forward
    assert steady.coulomb[0] == pytest.approx(0.06, rel=0.05)
    assert steady.viscous[0] == pytest.approx(0.01, rel=0.3)


def test_friction_that_grows_with_the_load_is_found_and_stands_beside_the_rest():
    recorded = pendulum(per_load=0.15, seconds=20.0)
    found = identify([(recorded, ())], rigid_joints(recorded.joints), options=ALL)
    load, = found.robot.effects
    assert load.name == 'load_friction' and load.values[0] == pytest.approx(0.15, rel=0.1)
    grown = {row.name: row for row in found.joints[0].estimates}['friction.swing.per_load']
    assert grown.value == pytest.approx(0.15, rel=0.05)
    for steady in (found.robot.friction.forward, found.robot.friction.backward):
        assert steady.coulomb[0] == pytest.approx(0.06, rel=0.1)
    left = unexplained(motion_of(recorded, found.robot), plant.constants_of(found.robot))
    assert np.std(left) < 0.1 * np.std(recorded.tau_motor)


def test_of_axes_that_are_wholly_unknown_those_that_are_asked_for_are_found():
    one, other = pendulum(seconds=20.0), pendulum(seconds=20.0, inertia=0.04, seed=3, pace=1.3)
    both = Recording(
        joints=('one', 'other'), time=one.time, source='two axes',
        **{name: np.hstack([getattr(one, name), getattr(other, name)])
           for name in ('q_link', 'tau_motor')})
    found = identify([(both, ())], rigid_joints(both.joints),
                     options=replace(ALL, joints=('other',))).robot
    alone = identify([(both.of_joints(['other']), ())], rigid_joints(['other']), options=ALL).robot
    assert found.joints == ('other',)
    assert found.arm.inertia == alone.arm.inertia
    assert found.friction.forward.coulomb == alone.friction.forward.coulomb


def test_viscous_friction_that_bends_is_found_where_it_does_alone():
    """As of a lubricant that thins: 1.8 times as steep as a straight line where it begins."""
    straight = pendulum(seconds=30.0)
    rate = np.gradient(straight.q_link[:, 0], straight.time)
    bent = replace(straight, tau_motor=(straight.tau_motor[:, 0] + 0.03 * np.arcsinh(
        rate / 0.3))[:, None])
    assert not identify([(straight, ())], rigid_joints(straight.joints), options=ALL).robot.effects
    found = identify([(bent, ())], rigid_joints(bent.joints), options=ALL)
    effect, = found.robot.effects
    assert (effect.name, effect.joint) == ('shear_thinning', 'swing')
    assert found.robot.arm.inertia + found.robot.arm.mass * found.robot.arm.com ** 2 == (
        pytest.approx(0.02, rel=0.02))
    joint, = found.joints
    speed = joint.steady_velocity[np.abs(joint.steady_velocity) > 0.1]
    truth = 0.06 * np.sign(speed) + 0.01 * speed + 0.03 * np.arcsinh(speed / 0.3)
    shown = np.interp(speed, joint.steady_velocity, joint.steady_torque)
    assert np.abs(shown - truth).max() < 0.05 * np.abs(truth).max()
    assert joint.held_out.relative < 0.5 * joint.held_out.coulomb_viscous
    row = {row.name: row for row in joint.estimates}['effects.swing.shear_thinning.torque']
    assert row.value == effect.values[0] and row.interval.low < row.value < row.interval.high
    left = unexplained(motion_of(bent, found.robot), plant.constants_of(found.robot))
    assert np.std(left) < 0.03 * np.std(bent.tau_motor)


def varying(recorded, size, order, phase=0.0):
    """Return a Recording whose friction varies with the angle as well, by ``size`` [N m]."""
    q = recorded.q_link[:, 0]
    further = size * np.cos(order * q + phase) * np.tanh(np.gradient(q, recorded.time) / 0.01)
    return replace(recorded, tau_motor=recorded.tau_motor + further[:, None])


@pytest.mark.parametrize(('order', 'size', 'within'), [
    (1, 0.01, 0.2), (2, 0.007, 0.2), (1, 0.02, 0.05), (2, 0.02, 0.05)])
def test_friction_by_load_is_found_beside_friction_that_varies_with_the_angle(order, size, within):
    """Beside little of it that alone follows the torque better, much of it is found as such."""
    found = fitted(varying(pendulum(per_load=0.15, offset=0.0, pace=0.3), size, order, 1.0))
    assert found.per_load == pytest.approx(0.15, rel=within)


@pytest.mark.parametrize('phase', [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
@pytest.mark.parametrize('order', [1, 2])
def test_friction_that_varies_with_the_angle_is_not_called_friction_by_load(order, phase):
    assert fitted(varying(pendulum(), 0.03, order, phase)).per_load == 0.0


def planar_arm(**changes):
    """Return a robot of two rigid joints in a vertical plane."""
    fields = {'mass': [2.0, 1.2], 'length': [0.4, 0.0], 'com': [0.15, 0.2],
              'inertia': [0.03, 0.012], 'motor_inertia': [0.02, 0.01], 'damping': [0.0, 0.0],
              'offset': [-1.2, 0.3]}
    arm = ArmParams(kind='planar', stiffness=[np.inf] * 2, gravity=9.81, **fields | changes)
    robot = rigid_joints(('shoulder', 'elbow'))
    return replace(robot, arm=arm)


def shaken(arm, gravity=9.81, seconds=40.0, rate=500.0):
    """Return a Recording of such an arm, of Spong's equations, with friction and noise."""
    time, rng = np.arange(int(seconds * rate)) / rate, np.random.default_rng(3)
    turns = 2.0 * np.pi * np.array([[[0.21], [0.53], [1.3]], [[0.29], [0.71], [1.1]]])
    size, phase = np.array([[[0.8], [0.4], [0.15]]] * 2), rng.uniform(0.0, 6.0, (2, 3, 1))
    q, dq, ddq = (np.sum(size * turns ** k * np.sin(turns * time + phase + 0.5 * np.pi * k),
                         axis=1) for k in range(3))
    (m1, m2), (c1, c2), (i1, i2), (j1, j2) = arm.mass, arm.com, arm.inertia, arm.motor_inertia
    reach, (a1, a2) = arm.length[0], q + arm.offset[:, None]
    both = m2 * reach * c2
    own = i2 + m2 * c2 ** 2 + both * np.cos(a2)
    h, pull = both * np.sin(a2), m2 * c2 * gravity * np.cos(a1 + a2)
    torque = np.stack([
        (i1 + m1 * c1 ** 2 + m2 * reach ** 2 + j1 + own + both * np.cos(a2)) * ddq[0]
        + own * ddq[1] - h * dq[1] * (2.0 * dq[0] + dq[1])
        + (m1 * c1 + m2 * reach) * gravity * np.cos(a1) + pull,
        own * ddq[0] + (i2 + m2 * c2 ** 2 + j2) * ddq[1] + h * dq[0] ** 2 + pull])
    torque = torque + 0.3 * np.tanh(dq / 0.01) + 0.05 * dq
    held = 0.5 * (torque + np.roll(torque, 1, axis=1)) + 0.02 * rng.standard_normal(torque.shape)
    return Recording(joints=('shoulder', 'elbow'), time=time, source='planar', q_link=q.T,
                     tau_motor=held.T)


def test_a_wrong_planar_chain_is_put_right_within_its_intervals():
    truth = planar_arm()
    wrong = planar_arm(mass=[1.4, 2.0], com=[0.12, 0.25], inertia=[0.06, 0.006])
    fit = fit_base_parameters([shaken(truth.arm)], wrong)
    assert not any('moment_y' in name for name in fit.names)  # of a plane that is not loaded
    for found, described, true in zip(*map(moments_of, (fit.arm, wrong.arm, truth.arm)),
                                      strict=True):
        assert found == pytest.approx(true, rel=0.01)
        assert described != pytest.approx(true, rel=0.1)
    true = base_of(in_space(truth.arm), numbers=IN_PLANE).combination @ all_parameters(
        in_space(truth.arm))
    assert (np.abs(fit.values - true) < 4.0 * fit.error).all()
    assert fit.arm.kind == 'planar'
    assert (fit.arm.mass > 0.0).all() and (fit.arm.inertia > 0.0).all()


def moments_of(arm):
    """Return what motion determines of two planar links, inertias with their motors'."""
    (m1, m2), (c1, c2), reach = arm.mass, arm.com, arm.length[0]
    i1, i2 = arm.inertia + arm.mass * arm.com ** 2 + arm.motor_inertia
    return i1 + m2 * reach ** 2, i2, m2 * c2, m1 * c1 + m2 * reach


def test_motor_inertia_and_stiffness_come_from_the_motors_equation():
    fit = motor_equation_of([experiment()[0]], 0).fit()
    assert fit.believed[:2].all()
    assert fit.motor_inertia == pytest.approx(0.005, rel=0.01)
    assert fit.stiffness == pytest.approx(1.5, rel=0.01)


def test_a_wrong_robot_file_is_put_right_before_friction_is_fitted():
    wrong = axis()
    wrong = replace(wrong, arm=replace(
        wrong.arm, stiffness=[2.0], motor_inertia=[0.003], inertia=[0.06]))
    arm = estimate_arm([experiment()[0]], wrong).robot.arm
    assert arm.stiffness[0] == pytest.approx(1.5, rel=0.01)
    assert arm.motor_inertia[0] == pytest.approx(0.005, rel=0.01)
    assert arm.inertia[0] == pytest.approx(0.03, rel=0.15)
