# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""From recordings to what the model lacks: named, sized, or said to be unexplained."""

from dataclasses import replace
import warnings

from bench.hidden_robots.cases import make_case
from bench.hidden_robots.motions import draw_reference
from bench.hidden_robots.plants import draw_belief, draw_robot
from bench.hidden_robots.truth import Disturbance
from core_runs import effect_on
from discrepancy_runs import driven
from gms_flex_control.discrepancy import workflow
from gms_flex_control.discrepancy.describe import named as described
from gms_flex_control.discrepancy.describe import paragraph
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE, FOUND, Signature, UNEXPLAINED
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.effects import registry
from gms_flex_control.errors import BagError, IdentificationError, SimulationError
from gms_flex_control.identification.assumed_robot import believed_model
from gms_flex_control.reports.answers import discrepancy_answer
from gms_flex_control.reports.discrepancy_values import report_values
import numpy as np
import pytest

SHORT = 12.0  # of a recording [s]
# what may be named besides single effects, all of which the bench tries: of disturbances that no
# effect explains, of two effects
CASES = {
    'an unknown motor torque': ('outside', 5, {'effect': 'periodic_motor_torque'}, UNEXPLAINED),
    'two effects': ('double', 2, {'duration': 16.0}, FOUND)}
# known parameters are 1 to 3 % off: a torque constant or inertia is known within this
DOUBT = 0.045


@pytest.fixture(scope='module')
def named():
    """Return a case with a quarter of a stiffness missing, and what is said of it."""
    case = make_case('single', 4, effect='stiffness_error', duration=SHORT)
    return case, find_discrepancy([case.recording], case.nominal)


def test_friction_of_the_same_recording_is_identified_anew_beside_what_is_missing():
    """It is as spoilt as by a kinematic error; of another recording it is left as it is."""
    case = make_case('single', 1, effect='kinematic_error', duration=16.0)
    (spec,), truth = case.truth.effects, case.truth.robot.friction.forward.coulomb[0]
    spoilt, friction = np.array([0.64, 1.0]), case.nominal.friction
    forward, backward = (replace(
        side, coulomb=spoilt * side.coulomb, velocity=spoilt ** -9 * side.velocity,
        viscous=spoilt ** -2 * side.viscous) for side in (friction.forward, friction.backward))
    found = replace(case.nominal, identified_from=(case.recording.identity,),
                    friction=replace(friction, forward=forward, backward=backward))
    elsewhere = find_discrepancy([case.recording], replace(
        found, identified_from=('another, 16.000 s',)))
    result = find_discrepancy([case.recording], found)
    assert [one.key for one in result.findings] == [spec.key]
    assert f'anew beside {spec.name} of {spec.joint}' in result.words
    assert [one['effect'] for one in report_values(result)['identified_beside']] == [spec.name]
    assert 'anew' not in elsewhere.words and not elsewhere.identified_beside
    alone = replace(result, robot=replace(result.robot, effects=tuple(
        one for one in result.robot.effects if one.key == spec.key)))
    commands = [discrepancy_answer(one, '.').command
                for one in (alone, replace(alone, identified_beside=()))]
    assert ['gms_flex identify' in one for one in commands] == [False, True]  # it has been
    assert result.gap.before == pytest.approx(elsewhere.gap.before)  # of the model as given
    errors = [abs(robot.friction.forward.coulomb[0] / truth - 1.0)
              for robot in (found, result.robot)]
    assert errors[1] < 0.3 * errors[0]
    assert result.gap.after[0] < elsewhere.gap.after[0]
    assert result.gap.free_after[0] < elsewhere.gap.free_after[0]


@pytest.mark.parametrize('name', CASES)
def test_no_more_is_named_than_is_hidden(name):
    """Where something is left that the catalogue lacks, equation and joint are reported."""
    kind, seed, options, verdict = CASES[name]
    case = make_case(kind, seed, **{'duration': SHORT, **options})
    result = find_discrepancy([case.recording], case.nominal,
                              SearchOptions(most=3 if kind == 'double' else 2))
    truth, found = case.truth, (*result.findings, *result.minor)
    assert result.verdict == verdict, result.words
    assert {(one.effect, one.joint) for one in found[:2]} == {
        spec.key for spec in truth.effects}, result.words
    if verdict == UNEXPLAINED:
        assert result.unexplained.joint == truth.outsider_joint
        assert result.unexplained.equation == ('motor' if 'motor' in name else 'link')
        assert 'does not explain' in result.words


def test_a_belief_that_is_two_percent_off_is_not_named():
    case = make_case('clean', 5, duration=20.0)
    arm = case.truth.robot.arm
    near = replace(case.nominal, arm=replace(case.nominal.arm, stiffness=1.02 * arm.stiffness))
    result = find_discrepancy([case.recording], near)
    assert (result.verdict, result.named) == (COMPLETE, ()), result.words
    assert result.unexplained is None and result.robot.effects == ()
    tried = {one.effect for one in result.searched.tried}
    again = {name for one in registry.names() for name in registry.find(one).again}
    assert tried | again | {'supply_sag', 'friction_backlash'} == set(registry.names())
    reported = {joint: change for name, joint, change in result.retuned if name == 'stiffness'}
    assert all(change == pytest.approx(-0.02, abs=0.01) for change in reported.values())
    np.testing.assert_allclose(result.robot.arm.stiffness, arm.stiffness, rtol=0.01)


def test_probabilities_of_what_is_found_are_those_of_the_models(named):
    """Of the credible set that is reported; effects of every likely model are certain."""
    case, result = named
    shares = [one.probability for one in result.searched.models]
    assert shares == sorted(shares, reverse=True) and 0.95 <= sum(shares) <= 1.0 + 1e-9
    true, = case.truth.effects
    assert all(true.key in one.effects for one in result.searched.models)
    assert result.findings[0].probability > 0.99
    assert result.findings[0].held_out.is_real()


@pytest.mark.parametrize('change', ['constant', 'short', 'light'])
def test_odd_input_ends_as_a_sentence_or_a_verdict(change):
    """A recording that stands still, one of 3 s, an inertia believed five times too small."""
    case = make_case('clean', 3, duration=SHORT if change == 'light' else 6.0)
    recording, believed = case.recording, case.nominal
    if change == 'constant':
        channels = ('q_link', 'q_motor', 'dq_link', 'dq_motor', 'tau_motor', 'command')
        recording = replace(recording, **{name: np.zeros_like(getattr(recording, name))
                                          for name in channels})
    elif change == 'short':
        recording = make_case('clean', 3, duration=3.0).recording
    else:
        arm = believed.arm
        believed = replace(believed, arm=replace(
            arm, mass=arm.mass / 5.0, inertia=arm.inertia / 5.0,
            motor_inertia=arm.motor_inertia / 5.0))
    refused = False
    for force in (False, True):
        if force and not refused:
            return  # the same would be done again
        with warnings.catch_warnings():
            warnings.simplefilter('error')
            try:
                result = find_discrepancy(
                    [recording], believed, SearchOptions(force=force, most=2))
            except (BagError, SimulationError) as error:
                refused = True
                assert str(error).startswith(recording.source) and len(str(error)) > 40
            else:
                refused = result.verdict == BAD_DATA
                assert result.verdict in (COMPLETE, FOUND, UNEXPLAINED, BAD_DATA)
                assert result.words and 'nan' not in result.words.lower()
                if change == 'light' and result.verdict != BAD_DATA:
                    assert result.verdict != COMPLETE


def test_a_known_effect_whose_value_is_wrong_is_reported():
    case = make_case('single', 1, duration=10.0)
    hidden, = case.truth.effects
    halved = replace(hidden, values=(0.5 * hidden.values[0],))
    result = find_discrepancy([case.recording], replace(case.nominal, effects=(halved,)))
    assert f'{hidden.name} of {hidden.joint} is in the model already' in result.words


def test_a_hole_in_an_angle_is_left_out():
    """A straight line through 0.4 s of motion would be a torque that nothing explains."""
    case = make_case('single', 1, duration=10.0)
    q_link = case.recording.q_link.copy()
    q_link[1000:1200, 0] = np.nan
    result = find_discrepancy([replace(case.recording, q_link=q_link)], case.nominal,
                              SearchOptions(most=1))
    hidden, = case.truth.effects
    assert [one.effect for one in result.findings] == [hidden.name], result.words
    assert result.findings[0].values[0].value == pytest.approx(hidden.values[0], rel=0.02)
    assert 'is not a number in 200 samples' in result.words


def test_an_answer_says_where_errors_are_noise_without_the_effects_as_well(named, tmp_path):
    _, result = named
    gap = result.gap
    quiet = replace(gap, after=1.03 * gap.retuned, free_after=1.03 * gap.free_before,
                    floor=gap.retuned, free_floor=gap.free_before)
    said = discrepancy_answer(replace(result, gap=quiet), tmp_path).sentence
    assert said.count('is at its noise floor either way') == 2
    loud = replace(quiet, floor=0.5 * gap.retuned)
    said = discrepancy_answer(replace(result, gap=loud), tmp_path).sentence
    assert 'the residual torque grows by 3 %' in said and said.count('either way') == 1
    for share, words in ((0.9, 'at'), (1.2, 'below')):
        low = replace(gap, after=0.5 * gap.retuned, floor=share * gap.retuned)
        said = discrepancy_answer(replace(result, gap=low), tmp_path).sentence
        assert (f'the residual torque, {words} its noise floor already, shrinks by 50 %' in said)
        assert 'both to about the noise floor' not in said


@pytest.mark.parametrize('loud', [False, True])
def test_a_model_that_lacks_nothing_is_described_alike_in_long_and_in_short(named, tmp_path, loud):
    """Where its error exceeds the noise floor the residual is not called noise."""
    _, result = named
    gap = replace(result.gap, floor=result.gap.after * (0.5 if loud else 1.0),
                  free_floor=result.gap.free_after)
    none = replace(result, verdict=COMPLETE, findings=(), minor=(), unexplained=None, gap=gap)
    said = discrepancy_answer(none, tmp_path).sentence
    assert paragraph(none, (), ())[0].startswith(said)
    assert ('by a relevant amount, though its error exceeds the noise floor' in said) == loud


@pytest.mark.parametrize('name', registry.names())
def test_the_next_command_takes_the_model_that_was_written(named, tmp_path, name):
    """Friction that `identify` does not find is tried on the data held out, then controlled."""
    _, result = named
    kind = registry.find(name)
    spec = effect_on('arm' if kind.whole_arm else 'joint1', name, *(
        max(one.lower, 0.1) if one.upper > 0.1 else one.upper for one in kind.parameters))
    result = replace(result, robot=replace(result.robot, effects=(spec,)))
    model = f"--robot {tmp_path / 'robot.yaml'} "
    said = discrepancy_answer(result, tmp_path, ['held_out']).command.partition('gms_flex ')[2]
    try:
        believed_model(result.robot)
        assert said.startswith('identify ') and model in said
    except IdentificationError:
        assert said.startswith(f'discrepancy held_out {model}')
        said = discrepancy_answer(replace(result, verdict=COMPLETE), tmp_path).command
        assert f'gms_flex tune {model}--torque-limit' in said


def test_one_joint_is_named_where_another_is_unexplained(tmp_path):
    """A torque of time on the link of joint1, which no effect explains; a level on joint2."""
    rng, time = np.random.default_rng(4), np.arange(8000) * 2e-3
    robot, gains = draw_robot(rng, 'stiff')
    nominal, reference = draw_belief(rng, robot), draw_reference(rng, 'rich', 'stiff', time)
    level = effect_on('joint2', 'coulomb_error', 0.4)
    tone = Disturbance('periodic_link_torque', 0, (
        0.3 * robot.friction.forward.static[0], 2.0 * np.pi * 4.5, 0.3), np.zeros(len(time)))
    recording = driven(robot, nominal, gains, reference, time, level, disturbance=tone)
    result = find_discrepancy([recording], nominal, SearchOptions(most=2))
    assert (result.verdict, result.is_open) == (FOUND, True), result.words
    assert [one.key for one in result.added if one.main] == [('coulomb_error', 'joint2')]
    assert result.added[0].values[0].value == pytest.approx(0.4, abs=DOUBT)
    assert result.robot.effects[0].name == 'coulomb_error'
    assert result.unexplained.joints == ('joint1',)
    said = f'joint1 remains unexplained: {result.unexplained.sentence}'
    assert said in result.words and said in discrepancy_answer(result, tmp_path).sentence
    before, after, floor = result.gap.retuned, result.gap.after, result.gap.floor
    assert after[1] < 2.0 * floor[1] and after[0] > 0.9 * before[0]
    own = result.gap.of_joints(['joint2'])  # a joint that remains does not hide how well it is
    left = max(after[1] ** 2 - floor[1] ** 2, 0.0)  # above its noise
    share = 1.0 - left / (before[1] ** 2 - floor[1] ** 2)
    assert own.energy_ratio == pytest.approx(1.0 - share) and own.after == after[1]
    assert f'explains {100.0 * share:.0f} % of what is missing in joint2' in result.words
    shrinks = f'the residual torque shrinks by {100.0 * (1.0 - after[1] / before[1]):.0f} %'
    assert shrinks in discrepancy_answer(result, tmp_path).sentence


def test_a_torque_of_another_joint_is_unexplained_and_says_so():
    """As of a spring or a cable from the one to the other."""
    case = make_case('clean', 3, duration=20.0)
    extra = 0.1 * case.recording.q_link[:, [1, 1]] * np.array([1.0, 0.0])
    recording = replace(case.recording, command=case.recording.command + extra,
                        tau_motor=case.recording.tau_motor + extra)
    result = find_discrepancy([recording], case.nominal, SearchOptions(most=1))
    assert result.verdict == UNEXPLAINED, result.words
    assert result.unexplained.joint == 'joint1'
    assert result.unexplained.variable == 'link angle of joint2'


def test_a_wave_that_hardly_turns_is_none():
    """A constant torque, without what is the same, resembles the longest wave there is."""
    case = make_case('deleted', 15, duration=SHORT)
    hidden, = case.truth.effects
    same = ('motor_torque_bias', 'spring_offset', 'constant_link_torque',
            'link_encoder_eccentricity', 'kinematic_error', 'friction_asymmetry', 'gravity_tilt')
    result = find_discrepancy([case.recording], case.nominal, SearchOptions(without=same, most=2))
    assert result.verdict == UNEXPLAINED, result.words
    assert result.unexplained.variable == 'constant'
    assert result.unexplained.joint == hidden.joint


def test_torque_constant_and_inertia_are_separated_by_the_spring():
    """Both scale the motor's side; the torque of the spring is known to a few percent."""
    rng, time = np.random.default_rng(2), np.arange(6000) * 2e-3
    robot, gains = draw_robot(rng, 'stiff')
    nominal, reference = draw_belief(rng, robot), draw_reference(rng, 'rich', 'stiff', time)
    hidden = {'torque_gain': 0.14, 'motor_inertia_error': -0.26}
    recording = driven(robot, nominal, gains, reference,
                       time, *(effect_on('joint1', name, value) for name, value in hidden.items()))
    result = find_discrepancy([recording], nominal)
    assert {one.effect: one.joint for one in result.named} == dict.fromkeys(hidden, 'joint1')
    for one in result.named:
        assert one.values[0].value == pytest.approx(hidden[one.effect], abs=DOUBT)


def test_what_makes_a_model_worse_is_named_and_not_added(named, monkeypatch):
    """It is named all the same, in the words and in the answer: something is missing."""
    monkeypatch.setattr(workflow._Choice, 'written', lambda self, *_: 2 * (self._found.before,))
    case, before = named
    result = find_discrepancy([case.recording], case.nominal, holdout=[case.held_out])
    assert result.searched.tried == before.searched.tried  # the same seed, the same numbers
    true, = case.truth.effects
    assert (result.verdict, result.robot.effects, result.added) == (UNEXPLAINED, (), ())
    assert [one.key for one in result.not_added] == [true.key]
    said = f'The recordings show {described(result.findings[0])}, but no model with it predicts'
    assert result.words.startswith(said)
    assert discrepancy_answer(result, '').sentence.startswith(said)
    assert report_values(result)['findings'][0]['added'] is False
    np.testing.assert_allclose(result.gap.after, result.gap.retuned, rtol=1e-3)


def test_nothing_is_named_where_much_is_left_that_the_written_model_does_not_explain(
        named, monkeypatch):
    """What explains something only beside an effect that makes free runs worse, explains none."""
    left = Signature(0.5, 'link', 'joint1', '', 'Something is left.')
    monkeypatch.setattr(workflow, '_left_over', lambda *_: left)
    monkeypatch.setattr(workflow, '_named', lambda likelihood, findings, *_: (findings, left))
    monkeypatch.setattr(workflow._Choice, 'written', lambda self, *_: 2 * (self._found.before,))
    case, _ = named
    result = find_discrepancy([case.recording], case.nominal, holdout=[case.held_out])
    assert (result.verdict, result.findings, result.unexplained) == (UNEXPLAINED, (), left)


def test_no_model_is_written_that_predicts_worse_than_the_one_given():
    """The robot that was fitted has an effect; the one that is predicted is as believed."""
    rng, time = np.random.default_rng(3), np.arange(7000) * 2e-3
    robot, gains = draw_robot(rng, 'stiff')
    reference = draw_reference(rng, 'rich', 'stiff', time)
    recordings = [driven(robot, robot, gains, reference, time, *effects)
                  for effects in ((effect_on('joint1', 'motor_viscous', 0.03),), ())]
    result = find_discrepancy(recordings[:1], robot, SearchOptions(most=1), holdout=recordings[1:])
    assert [one.effect for one in result.minor] == ['motor_viscous'] and not result.findings
    assert result.robot.effects == ()
    assert np.linalg.norm(result.gap.after) <= np.linalg.norm(result.gap.before)
    for without, found in (('retuned', 'after'), ('free_before', 'free_after')):
        np.testing.assert_array_equal(getattr(result.gap, without), getattr(result.gap, found))


@pytest.mark.parametrize(('angle', 'stiffness', 'fitted'), [(-0.58, 8.0, 1), (-0.63, 10.0, 2)])
def test_an_effect_matters_that_other_recordings_do_not_touch(angle, stiffness, fitted):
    """A stop is met in one recording; those that stay clear of it neither deny nor belittle it."""
    rng, time = np.random.default_rng(3), np.arange(7000) * 2e-3
    robot, gains = draw_robot(rng, 'stiff')
    references = [draw_reference(rng, 'rich', 'stiff', time) for _ in range(3)]
    stop = effect_on('joint1', 'end_stop', angle, stiffness)
    recordings = []
    for scale, reference in zip((1.0, 0.6, 0.6), references, strict=True):
        recordings.append(driven(robot, robot, gains, scale * reference, time, stop))
        assert (scale == 1.0) == (recordings[-1].q_link[:, 0].min() < angle)
    result = find_discrepancy(recordings[:fitted], robot, SearchOptions(most=1),
                              holdout=recordings[fitted:])
    assert result.verdict == FOUND, result.words
    assert [one.key for one in result.findings] == [one.key for one in result.added] == [stop.key]
    assert 'The held-out motion hardly meets what was found' in result.words


def test_what_differs_between_recordings_is_no_effect():
    """A zero that an encoder lost and a new offset of a drive are said of their recording."""
    case = make_case('clean', 0, duration=SHORT)
    other = replace(case.held_out, q_link=case.held_out.q_link + [4e-3, 0.0],
                    command=case.held_out.command + [0.0, 0.02],
                    tau_motor=case.held_out.tau_motor + [0.0, 0.02])
    result = find_discrepancy([case.recording, other], case.nominal, SearchOptions(most=1))
    assert result.verdict == COMPLETE and not result.named
    reported = {sentence.split(' joint')[0]: sentence for sentence in result.data.differences}
    assert set(reported) == {'zero of the link encoder of', 'torque of'}
    for what, joint, expected in (('zero of the link encoder of', 'joint1', 4.0),
                                  ('torque of', 'joint2', 0.02)):
        said, value = reported[what].split(f'{what} ')[1].split()[:2]
        assert said == joint and float(value) == pytest.approx(expected, rel=0.1)
        assert reported[what].endswith('in recording 2') and reported[what] in result.words
