# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What to record next: motions keep limits, and the planned one separates what is left."""

from dataclasses import replace
import json
from pathlib import Path
from types import SimpleNamespace

from core_runs import affected
from gms_flex_control import friction as gms
from gms_flex_control.cli.main import main
from gms_flex_control.data.conditions import conditions_of, repeat_conditions
from gms_flex_control.data.recording import Operation
from gms_flex_control.data.writer import write_recording
from gms_flex_control.design import determination, motions, separation
from gms_flex_control.design import plan as planning
from gms_flex_control.design.determination import experiments_for, missing_of, plan_determination
from gms_flex_control.design.motions import candidates
from gms_flex_control.design.plan import plan_next, SHORTEST, surviving
from gms_flex_control.design.separation import beliefs_of, loop_of, predicted, Prediction
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.dynamics.chain import mass_matrices
from gms_flex_control.errors import BagError, ConfigError
from gms_flex_control.experiment.identification_plan import plan_identification
from gms_flex_control.experiment.simulated import Plan, simulate
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.arm import Body, carrying
from gms_flex_control.schema.files import load_limits, read_values
from gms_flex_control.simulation.plant import constants_of
from gms_flex_control.trajectory import builders
import numpy as np
import pytest

PERIOD = 0.002
JOINTS = ('joint1', 'joint2')
LIMITS = Limits(torque=[2.0, 2.0], torque_rate=[50.0, 50.0], velocity=[1.5, 2.0],
                velocity_margin=[0.5, 0.5], lower=[-1.2, -1.5], upper=[1.0, 1.5],
                position_margin=[0.1, 0.1], torsion=[0.9, 0.9])
BIAS = frozenset({('constant_link_torque', 'joint2')})
ASYMMETRY = frozenset({('friction_asymmetry', 'joint2')})
ONE_WAY = builders.via_points(np.outer(np.linspace(0.0, 1.0, 4), [0.9, 1.2]), 2.0, 0.0)


def candidate(name, pace=1.0, **options):
    """Return the candidate of a name."""
    return next(one for one in candidates(LIMITS, JOINTS, pace, **options) if one.name == name)


@pytest.mark.parametrize('pace', [1.0, 2.5])
def test_references_keep_range_and_velocity(pace):
    time = np.linspace(0.0, 40.0, 8001)
    for one in (*candidates(LIMITS, JOINTS, pace), motions.random_moves(LIMITS, JOINTS, 3)):
        angle, velocity = np.moveaxis(one.trajectory(JOINTS).sample(time)[:, :2], 1, 0)
        assert (angle >= LIMITS.lower).all() and (angle <= LIMITS.upper).all(), one.name
        assert (np.abs(velocity) <= LIMITS.velocity).all(), one.name
        assert np.ptp(angle, axis=0).max() > 0.0, one.name


def test_tones_are_chirps_that_hardly_peak_and_joints_are_not_in_step():
    """A sine peaks at 1.41 times its rms, tones of random phases at 2.5 times."""
    rate = candidate('tones').trajectory(JOINTS).sample(PERIOD * np.arange(500, 3500))[:, 1]
    assert (np.abs(rate).max(axis=0) < 2.0 * rate.std(axis=0)).all()
    assert abs(np.corrcoef(rate.T)[0, 1]) < 0.1


def test_indistinguishable_effects_of_a_finding_survive_beside_the_credible_models():
    backlash = {'effect': 'backlash', 'joint': 'joint1'}
    gain = {'effect': 'torque_gain', 'joint': 'joint2'}
    report = {'credible': [{'effects': [backlash, gain], 'probability': 0.97}], 'minor': [],
              'findings': [gain | {'indistinguishable_from': [
                  {'effect': 'stiffness_error', 'joint': 'joint2'},
                  {'effect': 'tip_payload', 'joint': 'arm'}]},
                  backlash | {'indistinguishable_from': []}]}
    kept = ('backlash', 'joint1')
    assert surviving(report) == [
        frozenset({kept, ('torque_gain', 'joint2')}),
        frozenset({kept, ('stiffness_error', 'joint2')}),
        frozenset({kept, ('tip_payload', 'arm')})]
    report['credible'].append({'effects': [gain], 'probability': 0.01})
    for minor, count in (([], 4), ([backlash | {'indistinguishable_from': []}], 3)):
        assert len(surviving(report | {'minor': minor})) == count


def _recording(robot, model, gains, trajectory, duration=6.0):
    """Return the closed loop of a robot that the controller believes to be ``model``."""
    return simulate(Plan(robot=robot, model=model, gains=gains, trajectory=trajectory,
                         motion='test', duration=duration, period_ns=2_000_000, substeps=20,
                         seed=5, q_link=np.zeros(2)))


@pytest.fixture(scope='module')
def forward_only(robot, gains):
    """Return the robot with a link torque, and a recording of moves in one direction."""
    biased = affected(robot, 'joint2', 'constant_link_torque', 0.012)
    return biased, _recording(biased, robot, gains, ONE_WAY, 6.5)


@pytest.fixture(scope='module')
def beliefs(robot, forward_only):
    """Return the Beliefs that recording leaves: a torque on the link, or an asymmetry."""
    return beliefs_of([forward_only[1]], robot, [BIAS, ASYMMETRY])


@pytest.fixture
def few(monkeypatch):
    """Compare four motions instead of all, the best among them."""
    names = ('joint2_alone_short', 'short_swings', 'strokes', 'joint1_alone')
    monkeypatch.setattr('gms_flex_control.design.plan.candidates', lambda *args, **options: [
        one for one in candidates(*args, **options) if one.name in names])


def test_the_planned_motion_is_expected_to_separate_what_is_left_and_keeps_limits(
        robot, gains, few):
    """While a joint turns one way, its friction presses the gear to one side of a play."""
    loose = affected(robot, 'joint2', 'backlash', 0.004)
    first = _recording(loose, robot, gains, builders.velocity_levels([[0.1, 0.15]], [8.0]))
    beliefs = beliefs_of([first], robot, [frozenset({(name, 'joint2')}) for name in (
        'backlash', 'spring_offset')])
    assert len(beliefs.left(np.log(99.0)).hypotheses) == 2
    plan = plan_next(beliefs, gains, LIMITS, period=PERIOD, longest=12.0)
    assert plan.probability > 0.8 and plan.best.duration <= 12.0
    assert 'spring_offset of joint2' in plan.sentence()
    found = _recording(loose, robot, gains, plan.best.candidate.trajectory(JOINTS),
                       plan.best.duration)
    assert (np.abs(found.dq_link) <= 1.1 * LIMITS.velocity).all()


def test_a_robot_that_would_have_crossed_a_limit_along_a_recording_is_refuted(
        robot, gains, forward_only):
    """A lag of 50 ms makes the loop unstable: after a recording such a robot need keep nothing."""
    lagging = affected(robot, 'joint2', 'actuator_lag', 0.05)
    beliefs = SimpleNamespace(robot=robot, likelihood=None, recordings=[forward_only[1]],
                              hypotheses=[SimpleNamespace(robot=lambda *args, one=one: one)
                                          for one in (robot, lagging)])
    loop = loop_of(beliefs, gains, LIMITS, period=PERIOD)
    assert loop.fitted == (robot, lagging)
    assert len(loop.kept) == 6 and all(one is robot for one in loop.kept)
    blind = SimpleNamespace(**vars(beliefs) | {'recordings': [replace(
        forward_only[1], reference=np.full_like(forward_only[1].reference, np.nan))]})
    assert lagging in loop_of(blind, gains, LIMITS, period=PERIOD).kept


def test_torque_may_be_at_its_limit_at_peaks_only():
    still = np.zeros((1000, 4, 2))
    for clipped, kept in ((9, True), (11, False)):
        command = np.zeros((1000, 2))
        command[:clipped, 1] = -LIMITS.torque[1]
        assert separation.keeps(SimpleNamespace(true=still, command=command), LIMITS) == kept


def test_limits_that_no_motion_keeps_are_refused(gains, beliefs, few):
    tight = replace(LIMITS, torsion=[1e-4, 1e-4])
    with pytest.raises(ConfigError, match='every motion would cross a limit'):
        plan_next(beliefs, gains, tight, period=PERIOD)


CONFIG = Path(__file__).parents[1] / 'config'


@pytest.mark.parametrize(('effects', 'sentence'), [
    (['friction_asymmetry:joint2'] * 2, 'is named twice'),
    ([f'friction_asymmetry:joint{k}' for k in (1, 2)] + [
        f'constant_link_torque:joint{k}' for k in (1, 2)] + ['backlash:joint1'],
     'at most 4 are separated')])
def test_explanations_that_cannot_be_separated_are_refused(effects, sentence, forward_only,
                                                           robot, tmp_path, capsys):
    write_recording(tmp_path / 'bag', forward_only[1], robot.motors)
    (tmp_path / 'report.json').write_text(json.dumps({
        'sources': [str(tmp_path / 'bag')], 'credible': [], 'findings': [], 'minor': []}))
    assert main(list(map(str, [
        'next', tmp_path, '--robot', CONFIG / 'robot.yaml', '--limits', CONFIG / 'bridge.yaml',
        '--out', tmp_path / 'plan', '--effects', *effects]))) == 2
    assert sentence in capsys.readouterr().err


def test_what_predicts_the_same_ends_as_inseparable_and_no_budget_as_spent(
        robot, gains, forward_only, beliefs, monkeypatch):
    """A plan that separates nothing is driven twice: the first recordings may foresee badly."""
    monkeypatch.setattr('gms_flex_control.design.separation.predicted', lambda beliefs, candidate,
                        duration, loop: Prediction(candidate, duration, beliefs.odds, ()))
    monkeypatch.setattr('gms_flex_control.design.separation.beliefs_of',
                        lambda recordings, robot, sets: beliefs)
    driven = []

    def drive(plan, number):
        driven.append(number)
        return forward_only[1]
    for budget, verdict in ((60.0, planning.INSEPARABLE), (2.0, planning.BUDGET)):
        driven.clear()
        found = planning.separate([forward_only[1]], robot, [BIAS, ASYMMETRY], gains, LIMITS,
                                  drive, period=PERIOD, budget=budget, longest=30.0)
        assert found.verdict == verdict and len(found.left) == 2
        assert driven == ([1, 2] if budget > SHORTEST else [])
        assert all(one.words in found.sentence() for one in found.left)


def test_odds_as_wanted_are_even_chances_and_each_explanation_is_confirmed_by_its_own(
        beliefs):
    beliefs = replace(beliefs, odds=np.log([[1.0, 4.0], [0.2, 1.0]]))
    wanted = np.log(99.0)
    assert beliefs.probabilities == pytest.approx([0.8, 0.2])

    def chances(first, second):
        return separation.resolving(beliefs, np.array([[0.0, first], [second, 0.0]]), wanted)
    assert chances(wanted, -50.0) == pytest.approx([0.5, 0.0], abs=1e-3)
    assert chances(-50.0, 60.0) == pytest.approx([0.0, 1.0], abs=0.1)
    assert (chances(60.0, 60.0) > chances(20.0, 20.0)).all()


def test_a_motion_separates_as_fast_as_its_worst_pair(beliefs):
    """From 1 to 9 and from -1 to 5 in 4 s: 1.5 a second."""
    one = Prediction(None, 4.0, np.array([[0.0, 9.0], [5.0, 0.0]]), ())
    odds = np.array([[0.0, 1.0], [-1.0, 0.0]])
    plan = planning.NextRecording(beliefs=replace(beliefs, odds=odds), wanted=np.log(99.0),
                                  best=one, probability=0.9, compared=(one,), refused=())
    assert plan.pace(one) == pytest.approx(1.5)


def test_the_motion_is_chosen_that_confirms_the_truth_soonest_whichever_it_is(
        gains, beliefs, monkeypatch):
    """A sure half in 5 s is driven in vain where the other half is true; 8 s separate both."""
    def foreseen(beliefs, candidate, duration, loop):
        odds = {'fast_swings': (60.0, -50.0), 'strokes': (20.0, 20.0)}.get(
            candidate.name, (-50.0, -50.0))
        gained = duration / 5.0 if candidate.name == 'strokes' else 1.0
        return Prediction(candidate, duration, np.array(
            [[0.0, odds[0] * gained / 3.0], [odds[1] * gained / 3.0, 0.0]]), ())
    monkeypatch.setattr('gms_flex_control.design.separation.predicted', foreseen)
    beliefs = replace(beliefs, odds=np.zeros((2, 2)))
    plan = plan_next(beliefs, gains, LIMITS, period=PERIOD, longest=20.0)
    assert plan.best.candidate.name == 'strokes' and plan.probability > 0.8
    assert SHORTEST < plan.best.duration <= 20.0


def test_a_motion_that_cannot_be_stopped_within_the_limits_is_driven_slower():
    """At 2 s of braking a swing goes on by a second of its speed: half the pace keeps it."""
    for pace, kept in ((1.0, False), (2.5, True)):
        one = candidate('fast_swings', pace)
        assert separation.stops_within(one, JOINTS, 8.0, LIMITS) == kept


def test_motions_swing_about_zero_within_the_range():
    elbow = replace(LIMITS, lower=[-1.2, 0.0])
    assert 'joint2_alone' not in [one.name for one in candidates(elbow, JOINTS)]
    with pytest.raises(ConfigError, match='limits.joint2: motions swing about zero'):
        candidates(replace(LIMITS, lower=[-1.2, 0.3]), JOINTS)


def test_noise_of_encoders_that_two_models_show_differently_is_no_evidence(beliefs):
    """The margin is two standard deviations: twice the root of 2 sum w d^2."""
    models = [one.model for one in beliefs.hypotheses]
    alike = separation.log_odds(beliefs.likelihood, [models[0]] * 2, [3.0, 1.0])
    assert alike == pytest.approx(np.array([[0.0, 1.0], [-1.0, 0.0]]))
    odds = separation.log_odds(beliefs.likelihood, models, [3.0, 1.0])
    noise = [np.subtract(*beliefs.likelihood.of_pair(one.robot, one.x)) for one in models]
    weight = np.minimum(*(beliefs.likelihood.weights(one.sums.groups) for one in models))
    margin = 2.0 * np.sqrt(weight @ (noise[0] - noise[1]) ** 2)
    assert odds[0, 1] == pytest.approx(1.0 - margin) and odds[1, 0] == pytest.approx(-1.0 - margin)
    assert margin > 0.3


def test_a_joint_at_rest_steers_no_fit(robot, gains, forward_only):
    """While joint1 stands its inertia is all encoder noise: the torque of joint2 is found."""
    biased, _ = forward_only
    believed = replace(robot, arm=replace(robot.arm, inertia=1.03 * robot.arm.inertia,
                                          stiffness=0.98 * robot.arm.stiffness))
    recordings = [_recording(biased, believed, gains, motion, duration) for motion, duration in (
        (ONE_WAY, 6.5), (candidate('joint2_alone').trajectory(JOINTS), 8.0))]
    beliefs = beliefs_of(recordings, believed, [BIAS, ASYMMETRY])
    best = beliefs.hypotheses[0]
    assert best.effects == BIAS
    assert best.model.robot.effects[0].values[0] == pytest.approx(0.012, rel=0.15)
    assert np.abs(best.model.x / beliefs.likelihood.sd).max() < 3.0


@pytest.mark.parametrize('motion', ['fast_swings', 'slow_swings'])
def test_a_friction_that_differs_by_direction_is_no_constant_torque(motion, robot, gains):
    """Levels differ where joints slide; the sign of a velocity at rest is noise and no effect."""
    uneven = affected(robot, 'joint2', 'friction_asymmetry', -0.1)
    recordings = [_recording(uneven, robot, gains, along, duration) for along, duration in (
        (ONE_WAY, 6.5), (candidate(motion, 1.95).trajectory(JOINTS), 10.0))]
    best = beliefs_of(recordings, robot, [BIAS, ASYMMETRY]).hypotheses[0]
    assert best.effects == ASYMMETRY
    assert best.model.robot.effects[0].values[0] == pytest.approx(-0.1, rel=0.25)


SOFTER = frozenset({('stiffness_error', 'joint2')})
WEAKER = frozenset({('torque_gain', 'joint2')})
WEIGHT = Body(0.5, np.zeros(3), np.zeros((3, 3)))


@pytest.fixture(scope='module')
def swings(robot, gains):
    """Return swings of a robot whose drive of joint2 gives 8 % more than it believes."""
    weaker = affected(robot, 'joint2', 'torque_gain', 0.08)
    return _recording(weaker, robot, gains, builders.sinusoid(
        [0.3, 0.3], [4.0, 5.0], ramp_time=2.0))


def test_what_is_foreseen_of_a_motion_is_what_its_recording_shows(robot, gains):
    """A payload makes accelerations, and so encoder noise, weigh more: that is no evidence."""
    laden = affected(robot, 'arm', 'tip_payload', 0.03)
    first = _recording(laden, robot, gains, builders.sinusoid(
        [0.0, 0.5], [3.0, 3.0], ramp_time=2.0))
    sets = [frozenset({('tip_payload', 'arm')}), frozenset({('link_inertia_error', 'joint2')})]
    beliefs = beliefs_of([first], robot, sets)
    loop = loop_of(beliefs, gains, LIMITS, period=PERIOD)
    foreseen = predicted(beliefs, candidate('strokes', 1.5625), 5.0, loop)
    for a, (hypothesis, run) in enumerate(zip(beliefs.hypotheses, foreseen.runs, strict=True)):
        then = beliefs_of([first, run], robot, sets)
        order = [one.effects for one in then.hypotheses]
        k = order.index(hypothesis.effects)
        assert foreseen.odds[a, 1 - a] == pytest.approx(then.odds[k, 1 - k], abs=2.0)


def test_ramps_below_break_away_load_friction_to_half_of_it_at_most(robot):
    reach = motions.below_break_away(robot)
    trajectory = candidate('below_break_away', stuck=reach).trajectory(JOINTS)
    angle, rate = np.moveaxis(trajectory.sample(PERIOD * np.arange(4000))[:, :2], 1, 0)
    assert np.abs(angle).max(axis=0) == pytest.approx(reach, rel=0.05)
    torque = gms.replay(angle, rate, PERIOD, gms.constants_of(robot.friction))
    assert (np.abs(torque).max(axis=0) < 0.55 * robot.friction.forward.static).all()


def test_a_planar_arm_carries_a_point_mass_as_its_jacobian_has_it(robot):
    """M of the arm with a mass m at the tip is M + m J^T J."""
    load = WEIGHT._replace(com=np.array([0.1, 0.0, 0.0]))
    poses = np.array([[0.3, -0.7], [-1.0, 0.4]])
    first, second = robot.arm.length[0], robot.arm.length[1] + 0.1
    for pose, without, with_load in zip(poses, mass_matrices(poses, robot.arm), mass_matrices(
            poses, carrying(robot.arm, load)), strict=True):
        a, b = pose[0], pose.sum()
        jacobian = np.array([[-first * np.sin(a) - second * np.sin(b), -second * np.sin(b)],
                             [first * np.cos(a) + second * np.cos(b), second * np.cos(b)]])
        assert with_load == pytest.approx(without + 0.5 * jacobian.T @ jacobian)


def test_a_stated_load_of_a_planar_arm_leaves_no_torque_and_one_beside_it_is_refused(
        robot, gains):
    recording = _recording(separation.loaded(robot, WEIGHT), robot, gains, builders.sinusoid(
        [0.3, 0.3], [3.0, 2.0], ramp_time=1.0))
    left = []
    for load in (None, WEIGHT):
        torque = unexplained(motion_of(replace(recording, operation=Operation(load)), robot),
                             constants_of(robot))[:, 1]
        left.append(np.std(np.convolve(torque, np.full(50, 0.02), 'valid')))  # without noise
    assert left[1] < 0.3 * left[0]
    with pytest.raises(BagError, match='0.1 m beside the line of the last link'):
        motion_of(replace(
            recording, operation=Operation(WEIGHT._replace(com=np.array([0.0, 0.1, 0.0])))), robot)


def test_a_weight_at_the_tip_separates_stiffness_from_torque_gain(robot, gains, swings):
    """Along every motion both predict the same torque; a known mass gives torque its scale."""
    beliefs = beliefs_of([swings], robot, [SOFTER, WEAKER])
    loop = loop_of(beliefs, gains, LIMITS, period=PERIOD)
    motion = candidate('medium_swings', 2.0)
    weighted, = motions.by_hand([motion], 0.5)
    assert '0.5 kg are hung at the tip' in weighted.words
    without, with_weight = (predicted(beliefs, one, 6.0, loop) for one in (motion, weighted))
    assert with_weight.runs[0].operation.load.mass == 0.5
    assert without.runs[0].operation.load is None
    assert with_weight.odds[0, 1] > without.odds[0, 1] + 3.0
    assert with_weight.odds[1, 0] > without.odds[1, 0] + 3.0


def test_a_weight_costs_minutes_and_is_chosen_where_motions_do_not_do(
        robot, gains, swings, monkeypatch):
    beliefs = replace(beliefs_of([swings], robot, [SOFTER, WEAKER]), odds=np.zeros((2, 2)))
    for alone, by_person in ((60.0, False), (1.0, True)):
        monkeypatch.setattr(
            'gms_flex_control.design.separation.predicted',
            lambda beliefs, one, duration, loop, alone=alone: Prediction(one, duration, (
                60.0 if one.load else alone if one.name == 'tones' else 0.0)
                * np.array([[0.0, 1.0], [1.0, 0.0]]), ()))
        plan = plan_next(beliefs, gains, LIMITS, period=PERIOD, longest=6.0, weight=0.5)
        assert (plan.best.candidate.load is not None) == by_person
        assert ('(by hand, 2 min)' in plan.sentence()) == by_person


def test_a_new_bag_states_the_load_of_the_last_and_the_weight_together(tmp_path):
    for name in ('old', 'new'):
        (tmp_path / name).mkdir()
    (tmp_path / 'old' / 'recording.yaml').write_text('load: {mass: 1.5}\ntemperature: warm\n')
    repeat_conditions(tmp_path / 'old', tmp_path / 'new', ('load', 'temperature'), WEIGHT)
    known = conditions_of(tmp_path / 'new').operation
    assert known.load.mass == pytest.approx(2.0) and known.temperature == 'warm'


def test_information_about_what_is_missing_has_all_else_eliminated():
    """The variance is the inverse of a - b^2 / (c + prior), and of a determinant its logarithm."""
    information = np.array([[5.0, 3.0], [3.0, 2.0]])
    worth = determination._Information(
        information, [], np.array([0.1, 1.0]), {0: ('blocks', 'joint1')}).worth()
    left = 5.0 + 1e-4 - 9.0 / 3.0
    assert worth.information == pytest.approx(np.log(left))
    assert worth.sd == pytest.approx(0.1 / np.sqrt(left))


def test_what_a_motion_hardly_determines_is_left_open_in_words():
    strokes = motions.Candidate('strokes', 'strokes of both', {})
    so_far, best = (determination.MotionWorth(strokes, 0.0, np.array(sd))
                    for sd in ([1.0, 9.0], [0.02, 58.0]))
    plan = determination.Determination(
        missing=('blocks of joint2', 'forward level of joint1'), experiments=None, before=so_far,
        compared=(best,), duration=8.0)
    assert ('it determines presliding stiffness of joint2 to 2 % (standard deviations) and leaves '
            'forward Coulomb friction of joint1 open') in plan.sentence()
    assert plan.helps and not replace(plan, compared=(so_far,)).helps


def test_experiments_measure_what_they_can_within_limits(robot, gains):
    """A payload is none of theirs; with a range of nothing there are none."""
    missing = [('static', 'joint1'), ('blocks', 'joint2'), ('inertia', 'joint2')]
    found = experiments_for(missing, [robot], gains, LIMITS)
    assert found.measured == (('static', 'joint1'), ('blocks', 'joint2'))
    assert found.values['identification.experiments'] == ['break_away', 'presliding']
    assert found.values['identification.joints'] == ['joint1', 'joint2']
    assert found.duration > 10.0
    assert found.sentence().startswith('break away and presliding of joint1 and joint2, about')
    assert 'static friction of joint1, presliding stiffness of joint2' in found.sentence()
    assert experiments_for(missing[2:], [robot], gains, LIMITS) is None
    for tight, why in (
            (replace(LIMITS, lower=[-0.02] * 2, upper=[0.02] * 2), 'must be above lower'),
            (replace(LIMITS, torque=[0.01] * 2), 'the limit is 0.01 N m')):
        found = experiments_for(missing, [robot], gains, tight)
        assert not found.measured and why in found.refused and found.refused in found.sentence()


def test_experiments_are_slowed_down_until_they_keep_the_limits_of_a_bridge(robot, gains):
    """At 0.9 of its velocities joint1 would need 0.8 s and twice its range to get to speed."""
    limits = load_limits([CONFIG / 'bridge.yaml'], JOINTS)
    found = experiments_for([('level', 'joint1'), ('static', 'joint1')], [robot], gains, limits)
    assert found.values['identification.experiments'] == ['constant_velocity', 'break_away']
    assert found.values['identification.joint1.velocity'] < limits.velocity[0]
    assert not found.refused
    plan = plan_identification(found.values, robot, gains)
    assert (plan.limits.torque <= limits.torque).all()


def test_an_experiment_that_no_pace_allows_takes_no_other_along(robot, gains):
    """Where v_s is believed to be 0.6 rad/s there is no room to slide at 5 times of it."""
    curve = robot.friction.forward
    fast = replace(robot, friction=replace(robot.friction, forward=replace(
        curve, velocity=[0.6, curve.velocity[1]])))
    found = experiments_for([('attraction', 'joint1'), ('static', 'joint1')], [fast], gains,
                            load_limits([CONFIG / 'bridge.yaml'], JOINTS))
    assert found.values['identification.experiments'] == ['break_away']
    assert found.measured == (('static', 'joint1'),)
    assert 'Left out within these limits: identification.joint1: step sliding/' in found.sentence()


def test_a_draw_is_two_standard_deviations_away():
    root = np.random.default_rng(1).normal(size=(5, 5))
    shift = separation.two_sigma(root @ root.T, np.random.default_rng(2))
    assert np.linalg.norm(np.linalg.solve(root, shift)) == pytest.approx(2.0)


def test_what_determines_keeps_limits_with_the_load_and_two_deviations_away(
        robot, gains, swings, monkeypatch):
    loads = []

    def keeps_limits(loop, one, believed, candidate, duration):
        loads.append(loop.load)
        return one is believed or candidate.name == 'strokes'
    monkeypatch.setattr(separation.PlannedLoop, 'keeps', keeps_limits)
    found = plan_determination(robot, [replace(swings, operation=Operation(WEIGHT))],
                               [('blocks', 'joint2')], gains, LIMITS, period=PERIOD, duration=5.0)
    assert [one.candidate.name for one in found.compared] == ['strokes']
    assert all(one is WEIGHT for one in loads)


def test_what_identify_left_open_is_determined_by_the_motion_planned(
        robot, gains, swings, tmp_path, capsys):
    write_recording(tmp_path / 'bag', swings, robot.motors)
    names = {'friction.joint2.stiffness[0]': 'not identifiable',
             'friction.joint2.attraction': 'doubtful', 'friction.joint2.forward.coulomb': 'good',
             'friction.joint2.forward.velocity': 'doubtful'}
    (tmp_path / 'report.json').write_text(json.dumps({
        'sources': [str(tmp_path / 'bag')], 'joints': [{
            'joint': 'joint2', 'estimates': [
                {'name': name, 'standing': standing} for name, standing in names.items()]}]}))
    assert missing_of(json.loads((tmp_path / 'report.json').read_text())) == [
        ('blocks', 'joint2'), ('attraction', 'joint2'), ('velocity', 'joint2')]
    arguments = ['next', tmp_path, '--robot', CONFIG / 'robot.yaml', '--limits',
                 CONFIG / 'bridge.yaml', '--longest', '8', '--out', tmp_path / 'plan']
    assert main(list(map(str, arguments))) == 0
    values = json.loads((tmp_path / 'plan' / 'plan.json').read_text())
    assert set(values['missing']) == {
        'blocks of joint2', 'attraction of joint2', *(
            f'{direction} velocity of joint2' for direction in ('forward', 'backward'))}
    best = values['compared'][0]
    assert best['log_determinant'] == max(one['log_determinant'] for one in values['compared'])
    assert (np.array(best['sd']) < values['sd_before']).all()
    printed = ' '.join(capsys.readouterr().out.split())
    assert 'attraction of joint2 ' in printed and 'blocks' not in printed
    assert 'identification.yaml' in printed and 'by identification_node, measure' in printed
    assert (tmp_path / 'plan' / 'trajectory.yaml').is_file()
    planned, _ = read_values([tmp_path / 'plan' / 'identification.yaml'])
    steps = plan_identification(planned, robot, gains).experiments
    assert {(one.phase, one.joint) for one in steps} == {
        ('constant_velocity', 'joint2'), ('presliding', 'joint2'), ('sliding', 'joint2')}
    limits = load_limits([CONFIG / 'bridge.yaml'], JOINTS)
    assert planned['identification.joint1.upper'] == limits.upper[0]
    assert main([*map(str, arguments), '--weight', '1']) == 2
    assert 'separate explanations of discrepancy' in capsys.readouterr().err
