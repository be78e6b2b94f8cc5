# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Which effects only resemble what is there or could take its place; what is said of them."""

from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

from bench.hidden_robots.cases import make_case
from core_runs import effect_on
from discrepancy_runs import as_believed, driven_motion
from gms_flex_control.discrepancy import findings, friction_anew, workflow
from gms_flex_control.discrepancy.describe import evidence_of, torque_scale
from gms_flex_control.discrepancy.findings import evidence_shares
from gms_flex_control.discrepancy.gap import Errors, HeldOut
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.remainder import dependence, Free, predicted_share, signature_of
from gms_flex_control.discrepancy.result import Signature
from gms_flex_control.discrepancy.thresholds import RESEMBLES
from gms_flex_control.discrepancy.validation import Gain
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.discrepancy.worth import Worth
import numpy as np
import pytest

RATE = 'link rate'
OUTRIGHT = {'low_speed_friction': 1000.0, 'friction_hysteresis': 60.0, 'torque_ripple': 10.0}


def free(evidence, variable=RATE):
    return Free('slide', 'link', variable, (), evidence=evidence, torque=0.1)


def shares_of(instead, beside, left=None):
    """Return the share of each effect of ``instead``, dict of evidence in its place, by name."""
    names = list(instead)
    model = SimpleNamespace(robot=SimpleNamespace(
        effects=tuple(effect_on('slide', name, 0.1, 0.1, 0.1) for name in names)))
    worths = [SimpleNamespace(index=i, outright=OUTRIGHT[name], less=name,
                              rest=SimpleNamespace(jacobian=None)) for i, name in enumerate(names)]
    functions = SimpleNamespace(ranked=lambda less, columns, joint: [free(instead[less])])
    return dict(zip(names, evidence_shares(functions, model, worths, left, [free(beside)],
                                           ('slide',)), strict=True))


def test_a_function_of_more_evidence_in_its_place_makes_an_effect_a_resemblance():
    """It has what the effect has, and 500 beside; one of as much beside explains what is left."""
    assert shares_of({'low_speed_friction': 1500.0}, 500.0)['low_speed_friction'] == (
        pytest.approx(1000.0 / 1500.0))
    assert shares_of({'torque_ripple': 31.0}, 30.0)['torque_ripple'] > RESEMBLES


@pytest.mark.parametrize('left', [None, free(30.0)])
def test_effects_whose_place_one_function_takes_explain_it_together(left):
    """Each alone but for the other's part: the small one would be 60 of 90."""
    both = shares_of({'low_speed_friction': 1030.0, 'friction_hysteresis': 90.0}, 30.0, left)
    assert both == pytest.approx(dict.fromkeys(both, 1060.0 / 1090.0))
    alone = shares_of({'friction_hysteresis': 90.0}, 30.0, left)
    assert alone['friction_hysteresis'] == pytest.approx(60.0 / 90.0)


def test_what_another_effect_explains_is_no_rival():
    """Of two effects one may be found: the other gains as much in its place as beside it."""
    case = make_case('double', 2, duration=16.0)
    hidden = {spec.key for spec in case.truth.effects}
    result = find_discrepancy([case.recording], case.nominal, SearchOptions(most=1))
    found, = (*result.findings, *result.minor)
    (name, joint), = hidden - {found.key}
    assert (name, joint) not in found.indistinguishable_from
    assert found.runner_up != f'{name} of {joint}'


def state_of_errors(torque, free, *effects):
    """Return a State of which only its effects and errors by joint, a and b, are known."""
    torque, free = np.array(torque), np.array(free)
    specs = tuple(SimpleNamespace(key=one, joint=one[1]) for one in effects)
    return SimpleNamespace(
        key=lambda known: frozenset(effects),
        model=SimpleNamespace(x=np.zeros(1), robot=SimpleNamespace(effects=specs), left=torque),
        errors=Errors(torque, torque, free, float(np.sum(torque ** 2) * np.sum(free ** 2))))


class Known(HeldOut):
    """Held-out data on which the errors of States are known."""

    def errors(self, state):
        return state.errors


@pytest.fixture
def models(monkeypatch):
    """Return a function that says which State a model is, as given and as before."""
    def known(as_given, as_before=None):
        monkeypatch.setattr(workflow, 'as_given', lambda likelihood, state, nuisances, but=(): (
            as_given(state) if callable(as_given) else as_given))
        monkeypatch.setattr(workflow, 'as_before', lambda likelihood, state, before: as_before)
    return known


def test_an_effect_is_written_beside_known_parameters_as_given(models):
    """Re-tuning b lessens its torque and spoils its free runs: that says nothing of a's effect."""
    effect = ('shear_thinning', 'a')
    given, tuned = state_of_errors((1.0, 1.0), (1.0, 1.0)), state_of_errors((1.0, 0.3), (1.0, 3.0))
    best = state_of_errors((0.5, 0.3), (0.5, 3.0), effect)
    beside = state_of_errors((0.5, 1.0), (0.5, 1.0), effect)
    models(lambda state: given if state is tuned else beside, best)
    assert written_of(tuned, best, effect) == (beside, given)


def test_an_effect_that_held_out_data_do_not_touch_is_written(models):
    """Parameters fitted with it predict free runs worse by chance; those without it do not."""
    effect = ('end_stop', 'a')
    given, tuned = state_of_errors((1.0, 1.0), (1.5, 1.5)), state_of_errors((0.9, 0.9), (1.0, 1.0))
    best = state_of_errors((0.9, 0.9), (1.1, 1.1), effect)
    untouched = state_of_errors((0.9, 0.9), (1.0, 1.0), effect)
    models(given, untouched)
    assert written_of(tuned, best, effect) == (untouched, tuned)


@pytest.mark.parametrize(('left', 'is_written'), [(1.4, False), (0.9, True)])
def test_an_effect_beside_other_parameters_explains_what_was_fitted(
        monkeypatch, left, is_written):
    """
    A gain found beside another level of friction explains nothing beside the former level.

    Blocks left out do not show it: they judge a State whose parameters are fitted anew.
    """
    gain = ('torque_gain', 'a')
    given, tuned = state_of_errors((1.0, 1.0), (1.0, 1.0)), state_of_errors((1.0, 1.0), (1.0, 1.0))
    best = state_of_errors((0.8, 1.0), (1.0, 3.0), gain)
    beside = state_of_errors((0.8, 1.0), (1.0, 1.0), gain)
    beside.model.left = np.array([left, 1.0])
    monkeypatch.setattr(workflow, 'as_given', lambda likelihood, state, nuisances, but=(): (
        given if state is tuned else best))
    monkeypatch.setattr(workflow, 'as_before', lambda likelihood, state, before: beside)
    monkeypatch.setattr(workflow, 'subsets', lambda *given: ())
    assert written_of(tuned, best, gain)[0] is (beside if is_written else given)


@pytest.mark.parametrize(('left', 'is_taken'), [(0.76, False), (0.5, True)])
def test_what_resembles_the_cause_explains_more_than_it_leaves_of_the_better(
        models, left, is_taken):
    """Re-tuning makes the model worse: beside that, what explains 10 % would explain most."""
    given, tuned = state_of_errors((0.8, 0.8), (1.0, 1.0)), state_of_errors((2.2, 2.2), (1.0, 1.0))
    ripple = state_of_errors((left, left), (0.9, 0.9), ('torque_ripple', 'a'),
                             ('torque_ripple', 'b'))
    models(given)
    written, _ = written_of(tuned, tuned, None, ripple)
    assert written is (ripple if is_taken else given)


@pytest.mark.parametrize(('beside', 'widely', 'is_taken'), [
    (0.9, True, True), (0.5, True, False), (0.9, False, False)])
def test_what_stands_beside_a_named_effect_explains_most_of_what_that_leaves(
        models, beside, widely, is_taken):
    """And acts widely."""
    skew, ripple = ('encoder_skew', 'a'), ('torque_ripple', 'a')
    given, named, both = (state_of_errors((torque, 0.1), (1.0, 1.0), *effects)
                          for torque, *effects in ((1.0,), (beside, skew), (0.4, skew, ripple)))
    models(given)
    written, _ = written_of(given, named, skew, both, alone=named, widely=widely)
    assert written is (both if is_taken else named)


def test_as_many_other_effects_are_taken_if_they_predict_far_better(monkeypatch):
    """Motion that always loads one flank does not separate play from an offset; other does."""
    stop, play, offset = (('end_stop', 'b'), ('backlash', 'a'), ('spring_offset', 'a'))
    likely = [state_of_errors((9.0, 0.1), (1.0, 0.1), offset, stop),
              state_of_errors((0.1, 0.1), (0.1, 0.1), play, stop),
              state_of_errors((0.1, 2.0), (0.1, 1.0), play)]
    for evidence, state in zip((-1.0, -2.0, -3.0), likely, strict=True):
        state.evidence = evidence
    monkeypatch.setattr(findings.worth, 'pruned', lambda likelihood, found: (found, [1, 2]))
    likelihood = SimpleNamespace(known=0)
    found, _ = findings._others(
        likelihood, Found(likely[0], tuple(likely)), [1, 2], Known(likelihood))
    assert found.best is likely[1]
    found, _ = findings._others(
        likelihood, Found(likely[1], tuple(likely)), [1, 2], Known(likelihood))
    assert found.best is likely[1]


@pytest.mark.parametrize(('floor', 'after', 'free', 'matters'), [
    (0.5, 0.97, 1.0, True), (2.0, 0.97, 1.0, False), (2.0, 0.9, 1.0, True),
    (2.0, 0.97, 0.5, True), (np.nan, 0.97, 1.0, True)])
def test_what_the_noise_floor_hides_matters_where_something_is_clearly_better(
        monkeypatch, floor, after, free, matters):
    """Torque of 1 becomes ``after``, 5 % less or not, or free runs are, or the floor is lower."""
    held_out = Known(SimpleNamespace(coulomb=np.ones(1)))
    held_out.floor = lambda state: np.array([floor])
    monkeypatch.setattr(findings.fitting, 'plausible_limit', lambda likelihood, model: None)
    rest = SimpleNamespace(_replace=lambda **changed: state_of_errors([1.0], [1.0]))
    assert findings._lessened(held_out._likelihood, Found(state_of_errors([after], [free]), ()),
                              SimpleNamespace(less=None, rest=rest), held_out)[2] == matters


@pytest.mark.parametrize(('left', 'free_run', 'is_there'), [
    (1.02, 1.2, False), (1.1, 1.2, True), (1.02, 1.6, True)])
def test_a_function_at_the_noise_floor_is_nothing(monkeypatch, left, free_run, is_there):
    """In squares it leaves 3 % of Coulomb friction beyond the floor, or free runs twice theirs."""
    monkeypatch.setattr(workflow, 'joints_left', lambda likelihood, model, function: (
        (function.joint,) if function else ()))
    monkeypatch.setattr(workflow, 'signature_of', lambda likelihood, model, share, function: (
        SimpleNamespace(joint=function.joint, _replace=lambda joints: joints)))
    likelihood = SimpleNamespace(robot=SimpleNamespace(joints=('slide',)),
                                 level_of=lambda joint: 10.0)
    gap = SimpleNamespace(energy_ratio=1.0, after=np.array([left]), floor=np.array([1.0]),
                          free_after=np.array([free_run]), free_floor=np.array([1.0]))
    found = workflow._left_over(likelihood, None, free(100.0), gap, None)
    assert found == (('slide',) if is_there else None)


@pytest.mark.parametrize(('was_open', 'more', 'left', 'is_better'), [
    (True, 1, 0.97, True), (True, 1, 0.98, False), (True, 2, 0.97, False), (True, 2, 0.95, True),
    (False, 1, 0.9, False), (False, 0, 0.97, True), (False, -1, 1.0, True)])
def test_beside_friction_anew_each_effect_more_has_to_predict_better(
        was_open, more, left, is_better):
    """By 5 % of torque or free runs, and only where something is left without them."""
    def answer(is_open, count, error):
        gap = dict.fromkeys(('after', 'free_after'), np.array([error]))
        noise = dict.fromkeys(('floor', 'free_floor'), np.zeros(1))
        return SimpleNamespace(is_open=is_open, added=(1,), gap=SimpleNamespace(**gap, **noise),
                               robot=SimpleNamespace(effects=(None,) * count))
    found, other = answer(was_open, 2, 1.0), answer(True, 2 + more, left)
    assert friction_anew._is_better(other, found) == is_better


class Found(NamedTuple):
    """What a search ended with, of which only this is known."""

    best: object
    tried: tuple


def written_of(before, best, effect, *further, alone=None, widely=True):
    """
    Return what is written of a search's end, or of further States, and it without effects.

    ``effect`` is named and has a State ``alone``; others act ``widely`` or not.
    """
    likelihood = SimpleNamespace(known=0, sd=np.ones(1), coulomb=np.ones(2),
                                 robot=SimpleNamespace(joints=('a', 'b')))
    found = SimpleNamespace(before=before, best=best, nuisances=None, tried=(),
                            _replace=lambda best: None)
    named = {effect: SimpleNamespace(main=True, values=())} if effect else {}
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(workflow, 'torque_rms', lambda likelihood, model: model.left)
        for name, answer in {'acts_widely': widely, 'acts_like': True,
                             'with_fewer': alone}.items():
            patched.setattr(workflow.worth, name, lambda *given, answer=answer: answer)
        return workflow._Choice(likelihood, found, Known(likelihood), named).written(
            found, further)


@pytest.mark.parametrize(('size', 'said'), [(0.0123, '12.3 mN m'), (4.2, '4.2 N m'),
                                            (4630.0, '4.63 kN m'), (np.nan, '- mN m')])
def test_torques_are_reported_in_units_that_suit(size, said):
    scale = torque_scale([size, 0.001])
    assert f'{scale.text(size)} {scale.unit}' == said


@pytest.mark.parametrize(('variable', 'joint', 'expected'), [
    ('time', 'j', True), ('time times friction', 'j', True),
    ('time', 'other', False), ('torsion', 'j', False), ('', 'j', False)])
def test_an_effect_of_the_variable_that_is_left_has_another_shape(variable, joint, expected):
    """Friction that steps up is no drift: beside one, a function of time is left."""
    left = Signature(0.2, 'link', 'j', variable, 'Something is left.')
    assert left.is_of(SimpleNamespace(effect='friction_drift', joint=joint)) == expected


def test_an_effect_that_changes_nothing_that_is_fitted_is_none():
    idle = Worth(0, 0.1, 0.0, 0.0, 50.0, 50.0, Gain(0.0, 0.0, 0), None, None)
    assert not idle.is_real() and idle.weight == 0.0
    assert '0 % of which' in evidence_of(idle, ())
    assert not idle._replace(evidence=1.0, gain=Gain(50.0, 5.0, 10)).is_real()
    assert idle._replace(gain=Gain(50.0, 5.0, 10)).is_real()
    assert not idle._replace(gain=Gain(50.0, 5.0, 10)).is_real(caution=3.0)


def test_what_is_left_is_described_where_most_is_left(robot, gains):
    """The second of two recordings holds a torque on a motor that the first does not."""
    biased = effect_on('joint2', 'motor_torque_bias', 0.02)
    motions = [driven_motion(replace(robot, effects=effects), gains, seed, duration=6.0)
               for seed, effects in enumerate([(), (biased,)])]
    for order in (motions, motions[::-1]):
        likelihood = Likelihood(order, robot)
        found = signature_of(likelihood, as_believed(likelihood), 1.0)
        assert (found.equation, found.joint, found.variable) == ('motor', 'joint2', 'constant')
        other = signature_of(likelihood, as_believed(likelihood), 1.0, among=('joint1',))
        assert other.joint == 'joint1'


def test_a_torque_that_stays_while_a_joint_rests_is_no_function_of_its_angle():
    """Each rest is at another angle: any torque is a function of it, but predicts nothing."""
    rng = np.random.default_rng(5)
    angle, torque = (np.repeat(rng.uniform(-1.0, 1.0, 30), 80) for _ in range(2))
    passes = np.sin(np.linspace(0.0, 40.0, len(angle)))
    for values, residual, share, predicted in (
            (angle, torque, 0.7, 0.0), (passes, np.sin(3.0 * passes), 0.95, 0.95)):
        places = np.floor(10.0 * values).astype(int) + 10
        visits = np.cumsum(np.diff(places, prepend=places[0]) != 0)
        assert dependence(values, residual) > share
        assert predicted_share(places, visits, residual) == pytest.approx(predicted, abs=0.05)
