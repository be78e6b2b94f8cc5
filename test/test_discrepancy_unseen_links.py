# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Flexible joints of which only the motors were recorded: what the workflow still says of them."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from core_runs import affected
from discrepancy_runs import as_believed, likelihood_of, retuned_of
from gms_flex_control.discrepancy.evidence import state_of
from gms_flex_control.discrepancy.fitting import refitted, with_white_noise
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.residuals import drive_torque, motion_as_modelled, unexplained
from gms_flex_control.discrepancy.result import FOUND
from gms_flex_control.discrepancy.torque_noise import white_noise
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.effects.registry import find
from gms_flex_control.identification.unseen_links import with_links
from gms_flex_control.simulation import plant
import numpy as np
import pytest


def blind(recording, joints=slice(None)):
    """Return a Recording whose links have no encoder."""
    q_link, dq_link = recording.q_link.copy(), recording.dq_link.copy()
    q_link[:, joints] = dq_link[:, joints] = np.nan
    return replace(recording, q_link=q_link, dq_link=dq_link)


def off_recorded(case, angle):
    """Return by how much link angles (T, n) differ from those recorded, of their motion (n,)."""
    inner = slice(500, -500)  # filters settle at both ends
    return (np.std((angle - case.recording.q_link)[inner], axis=0)
            / np.std(case.recording.q_link[inner], axis=0))


@pytest.mark.parametrize('plant_name', ['soft', 'stiff'])
def test_the_link_is_where_its_encoder_saw_it(plant_name):
    case = make_case('clean', 3, plant=plant_name, duration=20.0)
    computed = with_links(blind(case.recording), case.truth.robot)
    assert np.all(off_recorded(case, computed.q_link) < 0.02)
    motors = off_recorded(case, case.recording.q_motor)
    assert np.all(motors > 4.0 * off_recorded(case, computed.q_link))  # it is not just the motor's


@pytest.mark.parametrize('effect', ['spring_damping', 'spring_hysteresis', 'backlash'])
def test_an_effect_of_no_size_changes_nothing(effect):
    """What is computed of a link must not depend on how many steps it is computed in."""
    case = make_case('clean', 15, duration=10.0)
    motion = motion_of(blind(case.recording), case.nominal)
    values = [parameter.upper if np.isfinite(parameter.upper) else 1.0
              for parameter in find(effect).parameters]
    values[0] = 1e-13
    other = affected(case.nominal, 'joint1', effect, *values)
    rows = [unexplained(motion, plant.constants_of(robot)) for robot in (case.nominal, other)]
    assert np.std(rows[1] - rows[0]) < 1e-6 * np.std(rows[0])


def test_a_spring_that_stiffens_puts_the_link_where_its_encoder_saw_it():
    case = make_case('single', 1, effect='spring_cubic', plant='stiff', duration=20.0)
    true = case.truth.robot
    seen, motion = (motion_of(one, true) for one in (case.recording, blind(case.recording)))
    joint, off = true.joints.index(true.effects[0].joint), []
    for robot in (replace(true, effects=()), true):
        constants = plant.constants_of(robot)
        states, _ = motion_as_modelled(motion, constants, drive_torque(motion, constants))
        off.append(np.std((states - seen.states)[200:-200, 0, joint]))
    assert off[1] < 0.2 * off[0]


def test_links_that_have_encoders_are_taken_from_them():
    case = make_case('clean', 3, duration=20.0)
    motion = motion_of(blind(case.recording, [1]), case.nominal)
    assert [link.joint for link in motion.samples.unseen] == [1]
    assert motion_of(case.recording, case.nominal).samples.unseen == ()
    np.testing.assert_allclose(motion.samples.readings[:, 0, 0], case.recording.q_link[:, 0])


def test_torque_noise_is_measured_though_it_moves_the_links_computed():
    case = make_case('clean', 4, population='noise_6', duration=20.0)
    likelihood = likelihood_of(replace(case, recording=blind(case.recording)))
    reported = white_noise(likelihood, retuned_of(likelihood)[0])
    np.testing.assert_allclose(reported[0, :2], case.truth.torque_noise, rtol=0.25)
    noisy = likelihood.with_noise(reported)
    model, _ = retuned_of(noisy)
    assert np.mean(model.whitened ** 2) == pytest.approx(np.mean(noisy.clean ** 2), rel=0.3)


@pytest.mark.parametrize('population, seed', [('noise_3', 8), ('noise_6', 9), ('noise_6', 7)])
def test_parameters_that_only_lessen_noise_of_computed_links_are_no_likelier(population, seed):
    case = make_case('clean', seed, population=population, duration=20.0)
    exact = replace(case, recording=blind(case.recording), nominal=case.truth.robot)
    likelihood, _ = with_white_noise(likelihood_of(exact))
    np.testing.assert_allclose(likelihood.noise[0, :2], case.truth.torque_noise, rtol=0.3)
    gained = as_believed(likelihood).cost - retuned_of(likelihood)[0].cost
    # chance gives 1 per parameter; with the noise in torques alone 79, 299 and 1056 are gained
    assert gained < 3.0 * len(likelihood.nuisances)


def test_an_effect_is_named_by_the_motors_alone_and_it_is_said_what_is_lost():
    case = make_case('single', 8, effect='motor_coulomb', duration=10.0)
    result = find_discrepancy([blind(case.recording)], case.nominal, SearchOptions(most=1))
    assert result.verdict == FOUND, result.words
    assert 'No link encoder of joint1, joint2 was recorded' in result.words
    assert 'kinematic_error' in result.words.split('Not identifiable there:')[1]
    true, first = case.truth.effects[0], result.findings[0]
    assert first.key == true.key
    assert first.values[0].value == pytest.approx(true.values[0], rel=0.2)


def test_torque_that_was_recorded_late_is_named_by_the_motors_alone():
    case = make_case('clean', 3, plant='stiff', duration=20.0)
    seen = blind(case.recording)
    late = np.roll(seen.command, 3, axis=0), np.roll(seen.tau_motor, 3, axis=0)
    result = find_discrepancy([replace(seen, command=late[0], tau_motor=late[1])],
                              case.truth.robot, SearchOptions(most=1))
    first = result.findings[0]
    assert (first.effect, first.joint) == ('recording_delay', 'arm'), result.words
    assert first.values[0].value == pytest.approx(-6e-3, rel=0.2)


def test_a_spring_so_soft_that_the_computed_link_runs_away_is_no_model():
    case = make_case('clean', 3, plant='stiff', duration=10.0)
    likelihood = likelihood_of(replace(case, recording=blind(case.recording)))
    robot = affected(case.nominal, 'joint2', 'spring_cubic', -5e8)
    nuisances = likelihood.jacobian(as_believed(likelihood))
    with np.errstate(all='ignore'):
        model, columns = refitted(likelihood, robot, np.zeros(len(likelihood.sd)), nuisances)
        assert state_of(likelihood, model, columns, 2).evidence == -np.inf
    assert model.robot is robot
