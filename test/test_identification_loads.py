# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Recordings under different loads separate what one recording cannot; MuJoCo is the robot."""

from dataclasses import replace

from bench.hidden_arms.wrong_links import base_values, friction_of, hidden_arm, moved
from gms_flex_control.data.conditions import Conditions, with_conditions
from gms_flex_control.data.recording import Operation, Recording
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.null_simulation import null_readings
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.errors import BagError, ConfigError, IdentificationError
from gms_flex_control.identification import assumed_robot
from gms_flex_control.identification.arm_differences import difference_estimates
from gms_flex_control.identification.arm_regression import fit_base_parameters, fit_differences
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.inertial_parameters import all_parameters, base_of
from gms_flex_control.identification.output import friction_values, with_friction_of
from gms_flex_control.identification.recording_checks import require
from gms_flex_control.identification.segments import drive_sides, one_by_one, segments_of
from gms_flex_control.params.arm import Body
from gms_flex_control.simulation import plant
import numpy as np
import pytest

pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")

LOAD = Body(30.0, np.array([0.02, -0.01, 0.12]), np.diag([0.4, 0.3, 0.2]))
SCALE = np.array([1.06, 0.94, 1.03, 0.92, 1.08, 0.97])    # recorded over true torque
ZERO = np.array([3.0, -2.0, 1.0, 2.0, -3.0, 0.0]) * 1e-3  # [rad] of the second recording
OFFSET = np.array([20.0, -30.0, 10.0, 3.0, -2.0, 1.0])    # [N m]
PER_LOAD = np.array([0.0, 0.04, 0.0, 0.0, 0.0, 0.0])
WARM = 0.8                                                # friction of the second recording


@pytest.fixture(scope='module')
def hidden():
    """Return the robot as believed, the true arm, recordings without and with a load."""
    robot, arm, urdf = hidden_arm()
    bare = moved(urdf, robot.arm, 16.0, per_load=PER_LOAD)
    heavy = moved(urdf, robot.arm, 16.0, seed=1, load=LOAD, per_load=PER_LOAD, warm=WARM)
    bare = replace(bare, tau_motor=SCALE * bare.tau_motor, operation=Operation(temperature='cold'))
    heavy = replace(heavy, tau_motor=SCALE * heavy.tau_motor + OFFSET,
                    q_link=heavy.q_link + ZERO, operation=Operation(LOAD, temperature='warm'))
    return robot, arm, [bare, heavy]


def with_unknown_load(recording):
    return replace(recording, operation=recording.operation._replace(load=None, load_unknown=True))


@pytest.fixture(scope='module')
def found(hidden):
    return fit_base_parameters(hidden[2], hidden[0])


def test_a_known_load_determines_the_scale_of_every_torque_that_it_loads(found):
    """Six scales 3 to 8 % off are found within 0.5 %."""
    differences = found.differences
    np.testing.assert_allclose(differences.scale, SCALE, rtol=0.005)
    assert np.all(differences.scale_sd < 0.005)


def test_base_parameters_are_those_without_the_load(hidden, found):
    truth = base_values(hidden[1])
    known = found.error < 0.05 * np.abs(found.values)
    off = np.abs(found.values - truth)
    assert known.sum() >= 20
    assert np.all(off[known] < 0.03 * np.abs(truth[known]))
    assert np.all(off < 5.0 * found.error)


def test_zeros_of_encoders_and_temperatures_differ_as_they_do(found):
    differences = found.differences
    known = differences.zero_sd[1] < 0.4e-3
    assert known.sum() >= 2
    assert np.all(np.abs(differences.zero[1] - ZERO)[known] < 0.5e-3)
    np.testing.assert_allclose(differences.level[1, PER_LOAD == 0.0], WARM, atol=0.05)


def test_friction_that_grows_with_the_load_is_found_where_it_does(found):
    differences = found.differences
    assert np.flatnonzero(differences.loaded).tolist() == [1]
    assert differences.loaded[1] == pytest.approx(PER_LOAD[1], rel=0.1)


def test_one_recording_cannot_determine_the_scale(hidden):
    robot, _, (_, heavy) = hidden
    differences = fit_base_parameters([heavy], robot).differences
    assert not differences.prior_sd.any()
    np.testing.assert_array_equal(differences.scale, 1.0)


def test_links_that_are_relied_on_leave_the_differences(hidden):
    """The true arm given: zeros and offsets of the second recording."""
    robot, arm, recordings = hidden
    given = replace(robot, arm=arm)
    recordings = [replace(one, tau_motor=one.tau_motor / SCALE) for one in recordings]
    differences = fit_differences(recordings, given)
    known = differences.zero_sd[1] < 0.4e-3
    assert known.sum() >= 3
    assert np.all(np.abs(differences.zero[1] - ZERO)[known] < 0.5e-3)
    np.testing.assert_allclose(differences.offset[1][:3], (OFFSET / SCALE)[:3], rtol=0.3)
    names = {one.name for part in difference_estimates(differences, robot.joints, ('a', 'b'))
             for one in part}
    assert 'friction.joint2.at_warm' in names


def test_currents_of_one_known_constant_determine_the_others(hidden):
    """Links that several joints move relate their torques; joint 2 is known."""
    robot, _, (bare, _) = hidden
    constant = np.array([40.0, 1.0, 25.0, 12.0, 9.0, 7.0])  # N m per ampere
    currents = replace(bare, tau_motor=bare.tau_motor / SCALE / constant,
                       scale_sd=[np.inf, 0.0, np.inf, np.inf, np.inf, np.inf])
    differences = fit_base_parameters([currents], robot).differences
    reported = (differences.scale_sd < 0.05) & (differences.prior_sd > 0.0)
    assert reported.sum() >= 3
    np.testing.assert_allclose(differences.scale[reported], 1.0 / constant[reported], rtol=0.06)


def test_unknown_constants_of_all_joints_have_the_scale_of_the_masses_described(hidden):
    """Relative to each other within 3 %; the arm goes with them, not with the URDF's masses."""
    robot, _, (bare, _) = hidden
    constant = np.array([40.0, 50.0, 25.0, 12.0, 9.0, 7.0])
    currents = replace(bare, tau_motor=bare.tau_motor / SCALE / constant, scale_sd=np.inf)
    found = fit_base_parameters([currents], replace(robot, arm=robot.arm.scaled(np.full(6, 2.0))))
    factor = found.differences.scale * constant
    np.testing.assert_allclose(factor, np.median(factor), rtol=0.03)
    assert np.median(factor) == pytest.approx(0.5, rel=0.05)
    base = base_of(robot.arm)
    off = base.combination @ all_parameters(found.arm) - found.values
    sure = found.error < found.differences.scale_sd.min() * np.abs(found.values)
    assert np.all(np.abs(off[sure]) < 0.03 * np.abs(found.values[sure]))


def test_a_load_that_was_weighed_determines_constants_and_its_centre_of_mass(hidden):
    """Six unknown constants within 2 %, the centre of mass within 5 mm."""
    robot, _, (bare, heavy) = hidden
    constant = np.array([40.0, 50.0, 25.0, 12.0, 9.0, 7.0])
    weighed = Operation(Body(LOAD.mass, np.zeros(3), 1e-9 * np.eye(3)), load_unknown=True)
    recordings = [replace(one, tau_motor=one.tau_motor / constant, scale_sd=np.inf)
                  for one in (bare, replace(heavy, operation=weighed))]
    found = fit_base_parameters(recordings, robot).differences
    load = found.loads[1].body
    np.testing.assert_allclose(found.scale * constant, SCALE, rtol=0.02)
    assert load.mass == pytest.approx(LOAD.mass, rel=0.01)
    np.testing.assert_allclose(load.com, LOAD.com, atol=5e-3)


def test_motor_inertia_that_no_file_states_is_found_all_the_same(hidden):
    """Links stay as heavy as they were, instead of bodies that would be as hard to turn."""
    robot, arm, recordings = hidden
    bare = replace(recordings[0], tau_motor=recordings[0].tau_motor / SCALE)
    unstated = replace(robot, arm=replace(robot.arm, motor_inertia=np.zeros(6)))
    again = fit_base_parameters([bare], unstated).arm
    np.testing.assert_allclose(again.motor_inertia[3:], arm.motor_inertia[3:], rtol=0.1)
    np.testing.assert_allclose(again.mass, robot.arm.mass, rtol=0.5)


def test_errors_are_shares_of_what_the_drives_gave(hidden):
    """What the other links require is taken off each torque; together they are what was read."""
    robot, arm, (bare, _) = hidden
    given = replace(robot, arm=arm)
    pieces = segments_of(bare, given, drive_sides(bare, given))
    (alone,), _ = one_by_one([pieces], given)
    for piece, one in zip(pieces, alone, strict=True):
        np.testing.assert_allclose(one.torque + one.taken, piece.torque)
        assert np.std(one.torque[:, 1]) < 0.5 * np.std(piece.torque[:, 1])


def test_discrepancy_takes_the_load_from_the_recording(hidden):
    """Without the load what is left of the torque is several times as much."""
    with pytest.raises(BagError, match='its load is not known in full; gms_flex'):
        motion_of(with_unknown_load(hidden[2][1]), hidden[0])
    robot, arm, (_, heavy) = hidden
    given, true = replace(robot, arm=arm), replace(heavy, tau_motor=(
        heavy.tau_motor - OFFSET) / SCALE, q_link=heavy.q_link - ZERO)
    constants, motion = plant.constants_of(given), motion_of(true, given)
    left, bare = (np.sqrt(np.mean(unexplained(one, constants)[200:-200, :6] ** 2, axis=0))
                  for one in (motion, replace(motion, samples=replace(motion.samples, load=None))))
    assert np.all(left[1:] < 0.3 * bare[1:]), (left, bare)  # the first joint is vertical
    again = null_readings(motion, constants)(np.random.default_rng(0))
    assert again.samples.load is motion.samples.load


@pytest.mark.parametrize(('changed', 'sentence'), [
    ({'q_link': np.degrees}, 'joint1 goes to .* rad, its limits in the URDF end at .*: its angles '
                             'look like degrees; record radians'),
    ({'tau_motor': lambda tau: tau * [1, 1, 1, -1, 1, 1]},
     'the torque of joint4 has the wrong sign: .*reverse it'),
    ({'joints': lambda names: (*names[:5], 'flange')},
     "has no joint 'joint6', it has joint1, .*flange; use the names of the recording"),
])
@pytest.mark.parametrize('whole', [False, True])
def test_a_recording_that_is_not_of_this_urdf_is_refused_in_a_sentence(
        changed, sentence, whole, hidden):
    robot, arm, (bare, _) = hidden
    wrong = replace(bare, **{name: change(getattr(bare, name)) for name, change in
                             changed.items()})
    given = robot if whole else replace(robot, arm=arm)
    with pytest.raises(IdentificationError, match=sentence):
        require(wrong, assumed_robot.believed_model(given, whole, False), rough=whole)
    assert not require(bare, assumed_robot.believed_model(given, whole, False), rough=whole)


def test_a_load_that_is_unknown_is_found_beside_a_recording_without_one(hidden):
    """Mass within 1 %, centre of mass within 2 mm, both within 4 standard deviations."""
    robot, _, (bare, heavy) = hidden
    recordings = [bare, with_unknown_load(heavy)]
    recordings = [replace(one, tau_motor=one.tau_motor / SCALE) for one in recordings]
    found = fit_base_parameters(recordings, robot).differences
    load = found.loads[1]
    assert load.body.mass == pytest.approx(LOAD.mass, abs=min(4.0 * load.mass_sd, 0.3))
    assert np.all(np.abs(load.body.com - LOAD.com) < np.minimum(4.0 * load.com_sd, 2e-3))
    names = [one.name for part in difference_estimates(found, robot.joints, ('a', 'b'))
             for one in part]
    assert {'recordings.2.load.mass', 'recordings.2.load.com_z'} <= set(names)
    with pytest.raises(IdentificationError, match='the load of every recording is unknown'):
        fit_base_parameters(recordings[1:], robot)


def test_known_links_determine_an_unknown_load_of_one_recording(hidden):
    robot, arm, (bare, heavy) = hidden
    heavy = replace(heavy, tau_motor=(heavy.tau_motor - OFFSET) / SCALE,
                    q_link=heavy.q_link - ZERO)
    found = fit_differences([with_unknown_load(heavy)], replace(robot, arm=arm)).loads[0]
    assert found.body.mass == pytest.approx(LOAD.mass, abs=0.1)
    np.testing.assert_allclose(found.body.com, LOAD.com, atol=2e-3)
    none = replace(bare, tau_motor=bare.tau_motor / SCALE, operation=Operation(load_unknown=True))
    with pytest.raises(IdentificationError, match='there is no load: leave load away'):
        fit_differences([none], replace(robot, arm=arm))


def test_friction_of_a_motor_that_two_joints_turn_is_separated_from_theirs(hidden):
    """Coupled wrist: within 3 %; base parameters stay, which a motor taken as its own spoils."""
    robot, arm, (bare, _) = hidden
    bare = replace(bare, tau_motor=bare.tau_motor / SCALE, operation=Operation())
    together = np.eye(6)
    together[5, 4] = 1.0
    turning = np.gradient(bare.q_link @ together[5], bare.period)
    further = np.outer(15.0 * np.tanh(turning / 0.005) + 5.0 * turning, together[5])
    of_motors = replace(bare, tau_motor=(bare.tau_motor + further) @ np.linalg.inv(together))
    recording = with_conditions(of_motors, Conditions(coupling={'joint6': {'joint5': 1.0}}))
    np.testing.assert_allclose(recording.tau_motor, bare.tau_motor + further, atol=1e-9)
    found, alone = (fit_base_parameters([one], robot)
                    for one in (recording, replace(recording, coupling=None)))
    coupled = found.differences.coupled
    np.testing.assert_allclose(coupled.friction[5], [15.0, 5.0], rtol=0.03)
    assert not coupled.friction[:5].any()
    names = [one.name for part in difference_estimates(found.differences, robot.joints, ('a',))
             for one in part]
    assert names.count('friction.joint6.coupled_coulomb') == 1
    truth = base_of(arm, together)[1] @ all_parameters(arm)
    known = found.error < 0.05 * np.abs(found.values)
    assert known.sum() >= 20
    np.testing.assert_allclose(found.values[known], truth[known], rtol=0.03)
    assert found.names[-1] == alone.names[-1] == 'joint6.motor_inertia'
    assert alone.error[-1] > 100.0 * found.error[-1]


@pytest.mark.parametrize(('coupling', 'sentence'), [
    ({'joint9': {}}, "coupling names 'joint9'"),
    ({'joint6': {'joint7': 1.0}}, "coupling names 'joint7', the recording has"),
    ({'joint6': {'joint6': 1.0}}, 'coupling.joint6 names joint6 itself')])
def test_a_coupling_of_no_joint_is_refused(coupling, sentence, hidden):
    with pytest.raises(ConfigError, match=sentence):
        with_conditions(hidden[2][0], Conditions(coupling=coupling))


def test_an_arm_is_identified_that_was_recorded_joint_by_joint():
    """The friction of the joints that moved is found, that of all others stays as described."""
    robot, arm, urdf = hidden_arm()
    recordings = [moved(urdf, robot.arm, 10.0, seed=j, moving=np.arange(6) == j) for j in (3, 0)]
    found = identify(recordings, replace(robot, arm=arm), options=IdentifyOptions(blocks=(1,)))
    assert any('joint2, joint3, joint5, joint6 hardly move' in one for one in found.warnings)
    assert [one.joint for one in found.joints] == ['joint1', 'joint4']
    coulomb, viscous = friction_of(robot.arm)
    for own, other in ((found.robot.friction.forward, robot.friction.forward),
                       (found.robot.friction.backward, robot.friction.backward)):
        np.testing.assert_allclose(own.coulomb[[0, 3]], coulomb[[0, 3]], rtol=0.03)
        np.testing.assert_allclose(own.viscous[[0, 3]], viscous[[0, 3]], rtol=0.03)
        np.testing.assert_array_equal(own.coulomb[[1, 2, 4, 5]], other.coulomb[[1, 2, 4, 5]])
    values = friction_values(found)
    assert 'uncertainty.joint4.level' in values
    assert 'uncertainty.joint3.level' not in values


def test_friction_of_one_joint_of_an_arm_is_found_and_the_others_keep_theirs():
    """As MuJoCo has it, from half of that; so does how well the others are known."""
    robot, arm, urdf = hidden_arm()
    coulomb, viscous = friction_of(robot.arm)
    believed, others = coulomb * np.where(np.arange(6) == 3, 0.5, 1.0), np.arange(6) != 3
    friction = robot.friction.each_way(lambda steady: replace(
        steady, static=believed, coulomb=believed, viscous=viscous))
    robot = replace(robot, arm=arm, friction=friction, uncertainty={
        ('level', 'joint1'): 0.011, ('level', 'joint4'): 0.012})
    found = identify([moved(urdf, arm, 10.0, seed=3)], robot, options=IdentifyOptions(
        blocks=(1,), joints=('joint4',)))
    assert [one.joint for one in found.joints] == ['joint4']
    own = found.robot.friction.forward
    assert own.coulomb[3] == pytest.approx(coulomb[3], rel=0.03)
    assert own.viscous[3] == pytest.approx(viscous[3], rel=0.03)
    np.testing.assert_array_equal(own.coulomb[others], believed[others])
    known = with_friction_of(robot, found).uncertainty
    assert known['level', 'joint1'] == 0.011 and known['level', 'joint4'] != 0.012


@pytest.mark.parametrize('torque', [np.nan, 0.0])
def test_a_joint_without_torque_keeps_its_friction_and_the_others_are_identified(torque):
    """As drives have it that report no current, or always the same."""
    robot, arm, urdf = hidden_arm()
    recorded = moved(urdf, robot.arm, 8.0, seed=3, moving=np.isin(np.arange(6), (0, 1, 3)))
    known = np.where(np.arange(6) == 1, torque, recorded.tau_motor)
    recorded = replace(recorded, tau_motor=known)
    found = identify([recorded], replace(robot, arm=arm), options=IdentifyOptions(blocks=(1,)))
    reported, = [one for one in found.warnings if 'have no torque' in one]
    assert reported.startswith('hidden: joint2 have no torque that was recorded')
    assert [one.joint for one in found.joints] == ['joint1', 'joint4']
    coulomb, _ = friction_of(robot.arm)
    np.testing.assert_allclose(found.robot.friction.forward.coulomb[[0, 3]], coulomb[[0, 3]],
                               rtol=0.05)
    assert found.robot.friction.forward.coulomb[1] == robot.friction.forward.coulomb[1]
    links = fit_base_parameters([assumed_robot.with_torques(recorded, robot)], robot)
    assert np.isfinite(links.values).all() and np.isfinite(links.error).all()


def test_an_axis_without_torque_does_not_end_the_fit_of_another():
    time = np.arange(0.0, 20.0, 0.004)
    q = 0.5 * np.sin(time) + 0.3 * np.sin(2.3 * time)
    rate, bend = np.gradient(q, time), np.gradient(np.gradient(q, time), time)
    robot = assumed_robot.rigid_joints(('turn', 'lift'))
    drive = bend + 0.8 * np.tanh(rate / 1e-3) + 0.2 * rate
    recorded = Recording(joints=robot.joints, time=time, source='axes', q_link=np.stack([q, q], 1),
                         tau_motor=np.stack([drive, np.full(len(q), np.nan)], axis=1))
    found = identify([recorded], robot, options=IdentifyOptions(blocks=(1,)))
    assert [one.joint for one in found.joints] == ['turn']
    assert found.robot.friction.forward.coulomb == pytest.approx([0.8, 1.0], rel=0.05)
