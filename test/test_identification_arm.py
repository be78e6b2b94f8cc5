# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Inertia, gravity, stiffness and motor inertia nobody has told; and recordings of machines."""

from dataclasses import replace
from pathlib import Path

from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.arm_fit import estimate_arm
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.identification.axis_fit import fit_axis, fit_motor, held_torque, rows_of
from gms_flex_control.identification.base_parameters import (
    base_values,
    nearest_arm,
)
from gms_flex_control.identification.identify import identify, Options
from gms_flex_control.simulation import plant
from identified_axis import axis, experiment, pendulum
import numpy as np
import pytest

DATA = Path(__file__).parents[2] / 'shared' / 'data'
ALL = Options(estimate='all', blocks=(1, 3))
real = pytest.mark.skipif(not DATA.is_dir(), reason='the recordings are not beside the project')


def test_inertia_and_gravity_of_a_pendulum_are_those_it_was_made_with():
    fit = fit_axis(rows_of([pendulum()], held_torque(0), 0), 'swing', 'here')
    assert fit.has_gravity
    assert fit.inertia == pytest.approx(0.02, rel=0.02)
    assert fit.gravity_torque == pytest.approx(0.5, rel=0.02)
    assert fit.offset == pytest.approx(-1.2, abs=0.02)
    assert fit.constant == fit.per_load == 0.0


def test_gravity_is_not_made_up_where_there_is_none():
    fit = fit_axis(rows_of([pendulum(pull=0.0)], held_torque(0), 0), 'swing', 'here')
    assert not fit.has_gravity
    assert fit.inertia == pytest.approx(0.02, rel=0.02)


def test_a_linear_axis_has_no_gravity_that_turns_with_its_position():
    take = pendulum()
    robot = rigid_joints(take.joints)
    found = estimate_arm([take], replace(robot, arm=replace(robot.arm, axes='linear')))
    assert found.has_gravity == (False,) and not found.robot.arm.gravity.any()


def test_a_torque_too_large_for_asymmetry_of_friction_is_a_constant():
    fit = fit_axis(rows_of([pendulum(pull=0.0, constant=0.2)], held_torque(0), 0), 'swing', '-')
    assert fit.constant == pytest.approx(0.2, rel=0.03)


def test_motion_one_way_has_no_constant_torque_beside_friction():
    """Half of it would be as much friction, and half of the friction a constant torque."""
    take = pendulum(pull=0.0)
    forward = np.cumsum(np.abs(np.diff(take.q_link[:, 0], prepend=take.q_link[0, 0])))
    rate = np.gradient(forward, take.time)
    torque = 0.06 + 0.01 * rate + 0.02 * np.gradient(rate, take.time)
    fit = fit_axis(rows_of([replace(take, q_link=forward[:, None], tau_motor=torque[:, None])],
                           held_torque(0), 0), 'swing', 'here')
    assert fit.constant == 0.0
    assert fit.friction == pytest.approx(0.06 + 0.01 * np.median(rate), rel=0.1)


def test_a_torque_that_never_changes_tells_no_inertia():
    take = pendulum()
    with pytest.raises(IdentificationError, match='never changes'):
        fit_axis(rows_of([replace(take, tau_motor=np.full_like(take.tau_motor, 0.3))],
                         held_torque(0), 0), 'swing', 'here')


def test_a_ripple_of_the_gear_is_found_and_friction_is_not_bent_by_it():
    take = pendulum(ripple=(0.03, 40.0, 0.6))
    found = identify([(take, ())], rigid_joints(take.joints), options=ALL)
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
    take = pendulum(per_load=0.15)
    found = identify([(take, ())], rigid_joints(take.joints), options=ALL)
    load, = found.robot.effects
    assert load.name == 'load_friction' and load.values[0] == pytest.approx(0.15, rel=0.1)
    grown = {row.name: row for row in found.joints[0].estimates}['friction.swing.per_load']
    assert grown.value == pytest.approx(0.15, rel=0.05)
    for steady in (found.robot.friction.forward, found.robot.friction.backward):
        assert steady.coulomb[0] == pytest.approx(0.06, rel=0.1)
    left = unexplained(motion_of(take, found.robot), plant.constants_of(found.robot))
    assert np.std(left) < 0.1 * np.std(take.tau_motor)


def test_no_ripple_is_made_up_where_there_is_none():
    take = pendulum()
    arm_fit = estimate_arm([take], rigid_joints(take.joints))
    assert arm_fit.ripples == (None,) and not arm_fit.robot.effects


def test_the_nearest_arm_is_possible_even_for_impossible_base_parameters(robot):
    wanted = base_values(robot.arm, False) * np.array([1.0, 3.0, 0.1])
    arm = nearest_arm(robot.arm, wanted, np.diag(1e4 / wanted ** 2), False)
    assert (arm.mass > 0.0).all()
    assert (arm.inertia > 0.0).all()


def test_motor_inertia_and_stiffness_come_from_the_motors_equation():
    fit = fit_motor([experiment()[0]], 0)
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


def imported(folder, pattern, mapping):
    """Return real recordings as (Recording, ())."""
    mapping = Path(__file__).parents[1] / 'config' / mapping
    return [(import_csv(path, mapping).recording, ())
            for path in sorted((DATA / folder).glob(pattern))]


def assert_no_worse(found):
    """Raise if a joint predicts held-out torque or free motion worse than Coulomb + viscous."""
    for result in found.joints:
        errors = result.held_out
        assert errors.relative < 1.06 * errors.coulomb_viscous, result.joint
        assert errors.free_run_rms < 1.06 * errors.free_run_coulomb_viscous, result.joint


@real
def test_an_industrial_robot_is_predicted_no_worse_than_by_coulomb_and_viscous():
    take, other = ([(recording.of_joints(['axis1']), ())] for name in 'AB'
                   for recording, _ in imported('kr300', f'rec_{name}.csv', 'import_kr300.yaml'))
    found = identify(take, rigid_joints(['axis1']), holdouts=other, options=ALL)
    assert_no_worse(found)
    assert any(estimate.name == 'arm.axis1.stiffness' and 'not identifiable' in estimate.flags
               for estimate in found.joints[0].estimates)


@real
def test_a_servo_with_a_pendulum_is_predicted_no_worse_than_by_coulomb_and_viscous():
    takes, others = (imported('bam_xl330', f'*kp{gain}.csv', 'import_bam_xl330.yaml')
                     for gain in (100, 400))
    found = identify(takes, rigid_joints(takes[0][0].joints), holdouts=others, options=ALL)
    assert_no_worse(found)
    gravity = next(estimate for estimate in found.joints[0].estimates
                   if estimate.name == 'arm.joint1.gravity_torque')
    assert 0.3 < gravity.value < 0.7  # 0.49 kg at 0.1 m and the arm that carries it
