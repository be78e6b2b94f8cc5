# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Data faults before a fit: healthy recordings pass, faults and coupled axes are named."""

from dataclasses import replace
from functools import cache
import warnings

from bench.hidden_arms.plant import recording_of
from bench.hidden_robots.cases import make_case
import faulty
from faulty import FAULTS, healthy, ROOT, SIDES, taken, UNLIKE
from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.data.recording import Recording
from gms_flex_control.errors import GmsFlexError, IdentificationError
from gms_flex_control.experiment.simulated import read_plan, simulate
from gms_flex_control.identification.assumed_robot import believed_model, only_joints, rigid_joints
from gms_flex_control.identification.coordinates import Coordinates
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.objective import held_out, Objective
from gms_flex_control.identification.prediction_error import coupling_sentences
from gms_flex_control.identification.problem import Problem
from gms_flex_control.identification.recording_checks import check, of_all, require, standing
from gms_flex_control.identification.segments import drive_sides, TorqueWarning
from gms_flex_control.schema.files import load_robot
from identified_axis import pendulum
import numpy as np
import pytest

DATA = ROOT.parent / 'shared' / 'data'
# faults of an experiment whose motions are short, and rest
OF_EXPERIMENT = ('1 % dropped', 'bursts dropped', '5 % repeated', 'clock ahead', 'clock back',
                 'torque reversed', 'motor side torque', 'torques exchanged', 'clipped',
                 'sides exchanged')


@pytest.mark.parametrize('name', [*faulty.HEALTHY, 'experiment'])
def test_a_healthy_recording_has_no_finding(name):
    assert check(*healthy(name)) == ()


@pytest.mark.parametrize('name', ['sinusoid', 'polynomial', 'unlike', 'stiff', 'rigid'])
def test_neither_wrong_parameters_nor_lag_nor_skew_are_taken_for_faults(name):
    recording, robot = healthy(name)
    time = recording.time

    def late(channel, delay):
        return np.stack([np.interp(time - delay, time, part) for part in channel.T], axis=1)
    ratio = np.array([1.5, 0.7])
    rough = replace(robot, arm=replace(
        robot.arm, mass=robot.arm.mass * ratio, stiffness=robot.arm.stiffness / ratio,
        motor_inertia=robot.arm.motor_inertia * ratio))
    assert check(recording, rough) == ()
    assert check(replace(recording, tau_motor=late(recording.tau_motor, 0.02)), robot) == ()
    skewed = replace(recording, q_link=late(recording.q_link, 0.004),
                     dq_link=recording.dq_link * np.nan)
    assert check(skewed, robot) == ()
    jitter = np.random.default_rng(1).uniform(-0.2, 0.2, len(time)) * recording.period
    assert check(taken(recording, np.arange(len(time)), time + jitter), robot) == ()


@pytest.mark.parametrize(('base', 'fault'), [
    *(('unlike', fault) for fault in (*FAULTS, *SIDES)), *(('stiff', fault) for fault in SIDES),
    *(('rigid', fault) for fault in FAULTS), *(('experiment', fault) for fault in OF_EXPERIMENT)])
def test_an_injected_fault_is_named(base, fault):
    kind, severity, inject = (FAULTS | SIDES)[fault]
    recording, robot = healthy(base)
    found = check(inject(recording), robot)
    named = next(finding for finding in found if finding.kind == kind)
    assert named.severity == severity or base == 'experiment'
    assert named.text.startswith(f'{recording.source}: ') and '; ' in named.text + '; '
    if kind not in ('still', 'too_short'):
        assert {finding.kind for finding in found} == {kind}, found


def test_a_source_slower_than_the_log_does_not_jump():
    """One reading for 16 samples of a while moves as much farther; half a turn is a jump."""
    recording, robot = healthy('rigid')
    rows = np.arange(len(recording.time))
    slow = (rows >= 1600) & (rows < 2000)
    held = taken(recording, np.where(slow, rows // 16 * 16, rows), recording.time)
    assert 'jump' not in {one.kind for one in check(held, robot)}
    turned = faulty.changed(held, q_link=lambda q, time: q + np.pi * (time > 5.0))
    assert [one.kind for one in check(turned, robot)][-1] == 'jump'


@pytest.mark.parametrize(('size', 'said'), [(0.0, 'does not move;'), (1e-4, 'never moves (by ')])
def test_a_joint_at_rest_is_told_from_one_whose_motion_is_not_resolved(size, said):
    recording, robot = healthy('rigid')
    angle = recording.q_link.copy()
    angle[:, 1] = size * (np.arange(len(angle)) % 2)
    found = check(replace(recording, q_link=angle, dq_link=np.nan * angle), robot)
    assert said in next(one.text for one in found if one.kind == 'still')


def test_a_joint_that_stands_may_give_way_once():
    """Twelve counts are no jump of an encoder that goes by one otherwise."""
    recording, robot = healthy('rigid')
    count, rng = 2.0 * np.pi / 16384, np.random.default_rng(0)
    angle = recording.q_link.copy()
    angle[:, 1] = count * (rng.integers(0, 2, len(angle)) + 12 * (recording.time > 5.0))
    found = check(replace(recording, q_link=angle, dq_link=np.nan * angle), robot)
    assert 'jump' not in {one.kind for one in found}


@pytest.mark.parametrize('name', ['sinusoid', 'gravity', 'rigid gravity'])
def test_one_direction_is_named_with_the_parameters_it_costs(name):
    recording, robot = healthy(name)
    found = [finding for finding in check(faulty.one_way(recording), robot)
             if finding.kind == 'one_direction']
    assert [finding.joint for finding in found] == ['joint1', 'joint2']
    assert 'friction.joint1.backward is not identifiable' in found[0].text


def test_recordings_of_other_joint_order_are_found_by_name():
    recording, robot = healthy('unlike')
    turned = replace(faulty.with_columns(recording, [1, 0]), joints=recording.joints[::-1],
                     reference=recording.reference[:, :, ::-1])
    assert check(turned, robot) == ()


def test_torques_of_an_arm_that_are_all_reversed_are_not_called_exchanged():
    """Joints that turn alike fit each other's motion better than their own the wrong way round."""
    robot = load_robot(ROOT / 'examples' / 'light_arm' / 'robot.yaml')
    recording = recording_of(robot, robot, seconds=10.0, noise=0.03, motors_only=False, seed=3)
    assert check(recording, robot) == ()
    found = check(replace(recording, tau_motor=-recording.tau_motor), robot)
    assert {one.kind for one in found} == {'torque_sign'}


def test_stamps_in_bursts_are_times_of_receipt():
    recording, robot = healthy('unlike')
    rows = np.arange(len(recording.time))
    last = np.minimum(rows // 5 * 5 + 4, rows[-1])
    found = check(replace(recording, time=recording.time[last] + 2e-5 * (rows % 5)), robot)
    assert [(one.kind, one.severity) for one in found] == [('clock', 'refuse')]
    assert 'bursts' in found[0].text


def test_joints_without_any_torque_are_not_called_still():
    recording, robot = healthy('unlike')
    nothing = replace(recording, tau_motor=np.zeros_like(recording.tau_motor))
    axes = replace(robot, motors=('', ''), arm=replace(
        robot.arm, stiffness=np.full(robot.n_joints, np.inf)))
    with pytest.raises(IdentificationError, match='no joint has a torque that ever changes'):
        Problem([(nothing, ())], [], axes)


def test_require_raises_the_first_fault_unless_forced():
    recording, robot = healthy('unlike')
    assert require(recording, robot) == ()
    reversed_torque = replace(recording, tau_motor=-recording.tau_motor)
    with pytest.raises(IdentificationError, match='joint1 has the wrong sign: .* with --force'):
        require(reversed_torque, robot)
    assert {finding.kind for finding in require(reversed_torque, robot, force=True)} == {
        'torque_sign'}
    warnings = require(faulty.dropped(recording, 0.01), robot)
    assert [finding.severity for finding in warnings] == ['warn']
    assert issubclass(IdentificationError, GmsFlexError)


def test_placeholders_for_inertia_make_a_factor_a_warning():
    recording, robot = healthy('rigid')
    arm = robot.arm
    guessed = replace(robot, arm=replace(arm, mass=30 * arm.mass, inertia=30 * arm.inertia))
    for rough, severity in ((False, 'refuse'), (True, 'warn')):
        found = check(recording, guessed, rough=rough)
        assert {finding[0] for finding in found} == {'torque_scale'}
        assert {finding.severity for finding in found} == {severity}


def test_a_drive_that_gives_but_a_part_of_what_is_asked_is_no_fault_of_the_data():
    """Its torque is clipped at 0.08 N m of up to 2.4 that are asked for."""
    case = make_case('single', 14, motion='polynomial', duration=20.0)
    clipped, = case.truth.effects
    assert clipped.key == ('actuator_saturation', 'joint2')
    recording = case.held_out
    assert np.nanmax(np.abs(recording.tau_motor[:, 1])) > 20.0 * clipped.values[0]
    assert not [one for one in check(recording, case.nominal) if one.kind == 'torque_scale']
    factors = np.array([1.0, 6.0])
    found = check(replace(recording, tau_motor=factors * recording.tau_motor), case.nominal)
    assert [(one.kind, one.joint) for one in found if one.severity == 'refuse'] == [
        ('torque_scale', 'joint2')]


@pytest.mark.parametrize(('share', 'severity'), [(1 / 20, 'warn'), (1 / 500, 'refuse')])
def test_where_friction_is_nearly_all_an_inertia_hardly_determines_the_scale(share, severity):
    """One that was not identifiable is no reason to refuse the same machine."""
    recorded = pendulum(inertia=8e-4, pull=0.0)
    robot = rigid_joints(recorded.joints)
    robot = replace(robot, arm=replace(robot.arm, inertia=[8e-4 * share]))
    found, = check(recorded, robot)
    assert (found[0], found.severity) == ('torque_scale', severity)


def test_the_gap_is_measured():
    recording, robot = healthy('unlike')
    keep = np.flatnonzero((recording.time < 6.0) | (recording.time > 6.2))
    found, = check(taken(recording, keep), robot)
    assert 'in 1 gaps, the longest 202' in found.text or 'the longest 20' in found.text
    assert found.kind == 'dropped'


@pytest.mark.parametrize('name', ['rec_A', 'rec_B'])
def test_kr300_is_healthy_and_its_faults_are_found(name):
    """With the maintainers' stiffness and a guessed inertia; friction is not looked at."""
    path = DATA / 'kr300' / f'{name}.csv'
    if not path.is_file():
        pytest.skip(f'{path} is not on this machine')
    recording = import_csv(path, ROOT / 'config' / 'import_kr300.yaml').recording
    robot = rigid_joints(recording.joints)
    robot = replace(robot, motors=tuple(f'{joint}_motor' for joint in robot.joints), arm=replace(
        robot.arm, stiffness=[4.58e6, 7.52e6, 4.10e6], inertia=np.full(3, 1000.0),
        motor_inertia=np.full(3, 1000.0)))
    assert check(recording, robot) == ()
    for kind, fault in (
            ('torque_sign', replace(recording, tau_motor=-recording.tau_motor)),
            ('swapped_sides', faulty.exchanged_sides(recording)),
            ('torque_scale', replace(recording, tau_motor=recording.tau_motor / 256.9))):
        assert kind in {finding.kind for finding in check(fault, robot)}


def test_a_torque_of_friction_alone_is_no_error_of_the_program():
    """Viscous friction explains all of it, and inertia nothing: its weight is 0."""
    time = np.arange(0.0, 10.0, 0.002)
    angle = 0.7 * np.sin(2.0 * np.pi * time)[:, None]
    recording = Recording(time=time, joints=('joint1',), source='friction alone', q_link=angle,
                          tau_motor=np.gradient(angle, time, axis=0))
    assert [one.kind for one in check(recording, rigid_joints(['joint1']))] == ['torque_scale']


def test_cogging_that_a_drive_works_against_does_not_reverse_its_torque():
    """
    A rotor turned past its teeth: it speeds up where the teeth pull and the drive holds back.

    Torque and acceleration have opposite signs then, though the drive overcomes the friction.
    """
    inertia, friction, tooth, order, mean = 2e-3, 0.1, 0.06, 6.0, 2.0
    like = pendulum()
    time, pace = like.time, order * mean
    acceleration = 0.3 * tooth / inertia * np.sin(pace * like.time)
    angle = mean * time - acceleration / pace ** 2
    torque = inertia * acceleration + friction - tooth * np.sin(pace * time)
    assert np.corrcoef(torque, acceleration)[0, 1] < -0.99 and torque.min() > 0.0
    recording = replace(like, q_link=angle[:, None], tau_motor=torque[:, None])
    axis = rigid_joints(recording.joints)
    robot = replace(axis, arm=replace(axis.arm, inertia=[inertia]))
    assert 'torque_sign' not in {one.kind for one in check(recording, robot)}


@pytest.mark.parametrize(('rate', 'said'), [(1000.0, False), (200.0, True)])
def test_samples_that_are_repeated_are_said_where_they_bias_the_inertia(rate, said):
    """As by clocks that drift: 1.5 % of them, each as late as one period."""
    recording = faulty.repeated(pendulum(seconds=10.0, pull=0.0, rate=rate), 0.015)
    axis = rigid_joints(recording.joints)
    robot = replace(axis, arm=replace(axis.arm, inertia=[0.02]))
    assert [one.kind for one in check(recording, robot)] == ['frozen'][:said]
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        found = identify([recording], axis, options=IdentifyOptions(estimate='all', blocks=(1,)))
    assert (found.robot.arm.inertia[0] == pytest.approx(0.02, rel=0.02)) != said


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_velocity_of_another_unit_hides_no_other_fault(sign):
    """Angle and time may be wrong as well, so it is refused; --force goes on and checks those."""
    like = pendulum(seconds=20.0, pull=0.0)
    axis = rigid_joints(like.joints)
    robot = replace(axis, arm=replace(axis.arm, inertia=[0.02]))
    faulty_one = replace(like, tau_motor=sign * like.tau_motor, dq_link=0.6 * np.gradient(
        like.q_link, like.time, axis=0))
    assert [one.kind for one in check(faulty_one, robot)] == ['velocity', 'torque_sign'][
        :1 if sign > 0.0 else 2]
    with pytest.raises(IdentificationError, match='0.6 times it .* angle or time are, .*--force'):
        require(faulty_one, robot)
    with warnings.catch_warnings(record=True) as caught:
        found = identify([faulty_one], robot, options=IdentifyOptions(
            blocks=(1,), force=True)) if sign > 0.0 else None
    if found is not None:
        assert found.robot.friction.forward.coulomb[0] == pytest.approx(0.06, rel=0.05)
        assert any('0.6 times it' in text for text in found.warnings) and not caught


@pytest.mark.parametrize('pushed', [True, False])
def test_a_drive_that_brakes_what_others_move_is_asked_about(pushed):
    """Its spring and damper follow the motion; one that is reversed pushes the wrong way."""
    like = pendulum(seconds=20.0, pull=0.0)
    q = like.q_link
    torque = -0.2 * q - 0.1 * np.gradient(q, like.time, axis=0) if pushed else -like.tau_motor
    axis = rigid_joints(like.joints)
    robot = replace(axis, arm=replace(axis.arm, inertia=[0.02]))
    fault, = check(replace(like, tau_motor=torque), robot)
    assert fault.kind == 'torque_sign'
    assert ('do other joints or a load move it? Then go on with --force' in fault.text) == pushed
    assert ('has the wrong sign' in fault.text) != pushed


def switched(levels, seconds=20.0, rate=150.0):
    """Return a Recording of a mass pushed by torques in turn, each as long as the others."""
    time = np.arange(int(seconds * rate)) / rate
    torque = np.array(levels)[(time / 0.4).astype(int) % len(levels)]
    rate_of = np.cumsum(torque - 0.5 * np.sin(time)) / rate
    return Recording(joints=('cart',), time=time, source='switched', tau_motor=torque[:, None],
                     q_link=(np.cumsum(rate_of) / rate)[:, None])


@pytest.mark.parametrize('levels', [(4.0, -4.0), (4.0, 0.0, -4.0, 0.0)])
def test_a_torque_that_is_switched_is_not_clipped(levels):
    """It has no other values than those of its levels: nothing was cut off."""
    recording = switched(levels)
    assert 'saturated' not in {one.kind for one in check(recording, rigid_joints(['cart']))}
    torque = np.clip(6.0 * np.sin(3.0 * recording.time), -4.0, 4.0)
    cut = replace(recording, tau_motor=torque[:, None])
    assert 'saturated' in {one.kind for one in check(cut, rigid_joints(['cart']))}


@pytest.mark.parametrize('alone', [True, False])
def test_torque_that_other_joints_may_explain_is_said_to_be(alone):
    """Gravity of links that others turn is no function of the joint's own angle."""
    one, other = pendulum(seed=1), pendulum(pace=1.3)
    turned = 5.0 * np.cos(other.q_link + 0.4)
    if alone:
        recording = replace(one, tau_motor=turned)
    else:
        recording = Recording(
            joints=('upper', 'lower'), time=one.time, source='arm',
            q_link=np.column_stack([one.q_link, other.q_link]),
            tau_motor=np.column_stack([turned, other.tau_motor]))
    robot = rigid_joints(recording.joints)
    robot = replace(robot, arm=replace(robot.arm, inertia=np.full(robot.n_joints, 0.02)))
    fault, = check(recording, robot)
    assert fault.kind == 'unexplained' and fault.joint == recording.joints[0]
    assert ('a robot file of the whole arm explains it' in fault.text) != alone


def parts_of(recording, seconds):
    """Return parts of a Recording, each so long [s] and from time 0."""
    number = (recording.time / seconds + 1e-9).astype(int)
    cuts = [recording.of_samples(number == k) for k in range(number[-1] + 1)]
    return [replace(one, time=one.time - one.time[0]) for one in cuts]


def test_recordings_fitted_together_are_long_and_move_both_ways_together():
    """A joint tested speed by speed moves one way in each bag, and each is short."""
    recording, robot = pendulum(seconds=18.0, pull=0.0), rigid_joints(['swing'])
    parts = parts_of(recording, 3.0)
    assert {one.kind for one in check(parts[0], robot, rough=True)} >= {'too_short'}
    assert of_all(parts, robot) == []
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        found = identify(parts, robot, options=IdentifyOptions(estimate='all', blocks=(1,)))
    assert not [text for text in found.warnings if 'too short' in text or ' only' in text]
    time = parts[0].time
    there, back = (replace(parts[0], q_link=sign * np.cumsum(0.2 + 0.1 * np.sin(time))[:, None])
                   for sign in (1.0, -1.0))
    assert [one.kind for one in of_all([there, there], robot)] == ['one_direction']
    assert of_all([there, back], robot) == []
    assert [one.kind for one in of_all([there], robot)] == ['too_short', 'one_direction']


def with_still_joints(recording):
    """Return a Recording with two joints that its noise alone moves, around one that moves."""
    noise = 1e-4 * np.round(np.random.default_rng(3).standard_normal((len(recording.time), 2)))
    load = 0.4 + 0.05 * recording.tau_motor
    return replace(
        recording, joints=('first', *recording.joints, 'last'),
        **{name: np.full((len(recording.time), 3), np.nan) for name in (
            'dq_link', 'q_motor', 'dq_motor', 'command', 'friction_hat')},
        reference=np.full((len(recording.time), 5, 3), np.nan), scale_sd=np.zeros(3),
        q_link=np.column_stack([noise[:, :1], recording.q_link, noise[:, 1:]]),
        tau_motor=np.column_stack([load, recording.tau_motor, -load]))


def test_joints_that_stand_still_in_all_recordings():
    one = with_still_joints(pendulum(seconds=8.0))
    other = replace(one, q_link=np.roll(one.q_link, 1, axis=1))  # 'last' moves
    assert standing([one]) == ('first', 'last')
    assert standing([one, other]) == ('first',)
    assert standing([replace(one, q_link=np.zeros_like(one.q_link))]) == ()
    assert standing([replace(one, q_motor=one.q_link)]) == ()


def test_axes_that_stand_still_keep_their_friction():
    """As those of an arm do: nothing of them is in the recording."""
    recording = with_still_joints(pendulum(seconds=12.0, pull=0.0))
    robot = rigid_joints(recording.joints)
    robot = replace(robot, arm=replace(robot.arm, inertia=[1.0, 0.02, 1.0]))
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        found = identify([recording], robot, options=IdentifyOptions(blocks=(1,)))
    assert [one.joint for one in found.joints] == ['swing']
    coulomb = found.robot.friction.forward.coulomb
    assert coulomb[1] == pytest.approx(0.06, rel=0.05)
    assert coulomb[0] == coulomb[2] == robot.friction.forward.coulomb[0]


def test_some_joints_of_a_robot_file_are_taken_in_their_order():
    axes = rigid_joints(['x', 'y', 'z'])
    axes = replace(axes, arm=replace(axes.arm, inertia=[1.0, 2.0, 3.0]))
    chosen = only_joints(axes, ['z', 'x'])
    assert chosen.joints == ('z', 'x') and chosen.motors == ('', '')
    np.testing.assert_array_equal(chosen.arm.inertia, [3.0, 1.0])
    assert chosen.friction.stiffness.shape == (2, axes.friction.stiffness.shape[1])
    with pytest.raises(IdentificationError, match='--joints w: the robot has x, y, z'):
        only_joints(axes, ['w'])


@pytest.mark.parametrize('name', ['sinusoid', 'noise', 'polynomial', 'fast moves', 'slow',
                                  'stick-slip', 'gravity', 'stiff', 'damped'])
def test_the_spring_is_believed_where_its_stiffness_is_right(name):
    """A controller's answer to the steps of encoders is no contradiction."""
    with warnings.catch_warnings():
        warnings.simplefilter('error', TorqueWarning)
        assert drive_sides(*healthy(name)) == ('spring', 'spring')


@pytest.mark.parametrize('factor', [0.3, 2.5])
def test_a_stiffness_far_off_is_a_contradiction(factor):
    """Spring and motor torque differ by more than half: the motor torque is taken, and said."""
    recording, robot = healthy('unlike')
    stiffness = robot.arm.stiffness * np.array([1.0, factor])
    wrong = replace(robot, arm=replace(robot.arm, stiffness=stiffness))
    with pytest.warns(TorqueWarning, match='joint2 differs from the motor equation'):
        assert drive_sides(recording, wrong) == ('spring', 'motor')


@cache
def data(kind):
    """Return the robot as decoupled axes, and Data of two links moving together as ``kind``."""
    files = [ROOT / 'config' / f'{stem}.yaml' for stem in ('robot', 'controller', 'sinusoid')]
    plan = read_plan(files, overrides=UNLIKE | {'arm.kind': kind, 'duration': 30.0})
    axes = read_plan(files, overrides=UNLIKE | {'arm.kind': 'decoupled'}).robot
    return axes, Problem([(simulate(plan, kind), ())], (), believed_model(axes))


def theta(robot, j):
    """Return the true parameters of a joint."""
    f = robot.friction
    sides = [[getattr(side, name)[j] for side in (f.forward, f.backward)]
             for name in ('static', 'coulomb', 'velocity', 'viscous')]
    coordinates = Coordinates(6)
    yields = np.mean(sides[0]) / 6.0 / f.stiffness[j]
    return coordinates.unpack(coordinates.pack(*sides, f.attraction[j], yields))[0]


def sentences(kind, joint):
    """Return what is said of a joint whose friction is known."""
    robot, found = data(kind)
    thetas = [theta(robot, j) for j in range(2)]
    return coupling_sentences(Objective(found.bundle, joint, thetas),
                              thetas[joint], robot.joints, held_out(found.bundle.period))


@pytest.mark.parametrize(('joint', 'other'), [(0, 'joint2'), (1, 'joint1')])
def test_links_of_a_chain_taken_for_single_axes_are_reported(joint, other):
    """The other link's acceleration accounts for what the model of an axis leaves."""
    sentence, = sentences('planar', joint)
    assert f'with the motion of {other}' in sentence and 'act on each other' in sentence


@pytest.mark.parametrize('joint', [0, 1])
def test_axes_of_their_own_are_not_accused(joint):
    """Where each axis moves by itself nothing is said."""
    assert sentences('decoupled', joint) == ()
