# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The bench of hidden effects: answers are judged by what was hidden, runs go on where killed."""

import json

from bench.__main__ import main
from bench.hidden_robots import figures, judgement, peers, score
from bench.hidden_robots.cases import make_case
from bench.hidden_robots.jobs import fingerprint, Job
from bench.journal import Journal
import numpy as np
import pytest


def effect(name, joint='joint1', **parameters):
    return {'effect': name, 'joint': joint, 'parameters': parameters or {'ratio': 0.1}}


def finding(name, joint='joint1', main=True, alike=(), **parameters):
    return effect(name, joint, **parameters) | {
        'main': main, 'runner_up': '', 'indistinguishable_from': list(alike)}


def outcome(kind='single', hidden=(), findings=(), verdict='effects_found', seed=0, clutter=(),
            plant='soft', population='home', gap=None, beliefs=None):
    """Return an outcome as `try_job` makes it."""
    ordered = sorted(findings, key=lambda one: not one['main'])
    return {
        'key': Job(kind, seed, population).key, 'verdict': verdict, 'findings': list(findings),
        'gap': gap, 'seconds': 2.0, 'megabytes': 300.0,
        'answers': {'workflow': [[one['effect'], one['joint']] for one in ordered]},
        'truth': {'kind': kind, 'seed': seed, 'plant': plant,
                  'population': population, 'effects': list(hidden), 'clutter': list(clutter),
                  'outsider': None, 'belief_errors': beliefs or {}}}


@pytest.mark.parametrize(('findings', 'verdict', 'expected'), [
    ([finding('backlash')], 'effects_found', 'right'),
    ([finding('backlash', 'joint2')], 'effects_found', 'wrong'),
    ([finding('spring_cubic'), finding('backlash')], 'effects_found', 'wrong'),
    ([finding('spring_cubic', main=False), finding('backlash')], 'effects_found', 'right'),
    ([finding('spring_cubic', alike=[['backlash', 'joint1']])], 'effects_found',
     'indistinguishable'),
    ([], 'unexplained', 'unexplained'), ([], 'complete', 'nothing'), ([], 'bad_data', 'fault')])
def test_the_first_name_is_judged_by_effect_and_joint(findings, verdict, expected):
    """A large finding counts before a small one, wherever it stands in the list."""
    one = outcome(hidden=[effect('backlash')], findings=findings, verdict=verdict)
    assert judgement.judged(one) == expected


def test_the_parameter_error_is_of_the_size_per_unit():
    hidden = [effect('friction_drift', ratio=0.4, duration=60.0)]
    found = [finding('friction_drift', ratio=0.21, duration=30.0)]
    assert judgement.parameter_error(outcome(hidden=hidden, findings=found)) == pytest.approx(
        0.05)
    hidden, found = [effect('end_stop', angle=-0.5, stiffness=3.0)], [
        finding('end_stop', angle=-0.49, stiffness=9.0)]
    assert judgement.parameter_error(outcome(hidden=hidden, findings=found)) == pytest.approx(
        0.02)


def test_gaps_count_above_the_floor():
    gap = {'retuned': [5.0, 1.0], 'after': [3.0, 0.9], 'floor': [0.0, 1.0],
           'free_before': [4.0, 3.0], 'free_after': [0.0, 1.0]}
    assert judgement.energy_ratio(outcome(gap=gap)) == pytest.approx(9.0 / 25.0)
    assert judgement.free_ratio(outcome(gap=gap)) == pytest.approx(0.2)
    for truth, above in (([0.6, 0.0], 0.8 / np.sqrt(25.0 - 0.36)), ([2.0, 0.0], 0.0),
                         ([6.0, 0.0], None)):
        assert judgement.free_ratio_above_truth(outcome(gap=gap | {'free_true': truth})) == (
            above if above is None else pytest.approx(above))
    assert judgement.free_ratio_above_truth(outcome(gap=gap)) is None
    assert judgement.energy_ratio(outcome(gap=gap | {'after': [None, 1.0]})) is None
    assert judgement.free_ratio(outcome()) is None


def test_the_figures_are_shares_of_their_kind():
    """Counted by hand: every kind with one good and one bad answer, or more."""
    b, c, r = effect('backlash'), effect('spring_cubic'), effect('torque_ripple')
    outcomes = [
        outcome(hidden=[b], findings=[finding('backlash')]),
        outcome(hidden=[b], findings=[finding('end_stop')], plant='stiff'),
        outcome(hidden=[b], findings=[finding('backlash')], plant='stiff'),
        outcome(hidden=[b], verdict='unexplained'),
        outcome(hidden=[b], findings=[finding('backlash')],
                population='paper_sinusoid'),
        outcome('clean', verdict='complete'),
        outcome('clean', findings=[finding('backlash', main=False)]),
        outcome('outside', verdict='unexplained'),
        outcome('outside', findings=[finding('backlash')], verdict='unexplained'),
        outcome('double', hidden=[b, c], findings=[finding('backlash'), finding('spring_cubic')]),
        outcome('double', hidden=[b, c], findings=[finding('spring_cubic')]),
        outcome('double', hidden=[b, c], findings=[finding('end_stop')]),
        outcome('deleted', hidden=[b], findings=[finding('spring_cubic')]),
        outcome('deleted', hidden=[b], findings=[finding('gravity_tilt', 'arm')]),
        outcome('clutter', hidden=[b], clutter=[c], findings=[
            finding('spring_cubic'), finding('torque_ripple'), finding('backlash')]),
        outcome('clutter', hidden=[b], clutter=[r], findings=[finding('backlash')])]
    values = {one.name: one.value for one in figures.figures_of(outcomes)}
    expected = {
        'right name, first place': 0.5, 'wrong name': 0.25, 'stiff plant: right name': 0.5,
        "the paper's motions: right name": 1.0, 'clean called clean': 0.5,
        'outside called unexplained': 0.5, 'double: both found': 1 / 3,
        'double: at least one': 2 / 3, 'deleted: an unrelated name first': 0.5,
        'clutter: main effect first': 0.5, 'clutter: main effect in the first three': 1.0,
        'clutter: names that are not there': 0.25, 'median parameter error': 0.0}
    for name, value in expected.items():
        assert values[name] == pytest.approx(value), name
    report = score.report(outcomes)
    assert 'backlash  3 of 5  end_stop 1, unexplained 1' in report.replace('   ', '  ')
    assert 'MISSED' in report
    json.dumps(score.values_of(outcomes), allow_nan=False)


def believed(**errors):
    """Return errors of belief as truth.json has them: those of joint 1, none of joint 2."""
    kinds = ('stiffness', 'motor_inertia', 'link_inertia', 'coupling', 'level', 'static',
             'asymmetry', 'viscous', 'velocity', 'blocks', 'attraction')
    none = dict.fromkeys(kinds, 0.0)
    return {'joint1': none | errors, 'joint2': none}


@pytest.mark.parametrize(('name', 'joint', 'ratio', 'errors', 'expected'), [
    ('stiffness_error', 'joint1', 0.1, {'stiffness': 0.12}, 'belief'),
    ('stiffness_error', 'joint1', -0.1, {'stiffness': 0.12}, 'wrong'),
    ('stiffness_error', 'joint1', 0.1, {'stiffness': 0.03}, 'wrong'),
    ('stiffness_error', 'joint2', 0.1, {'stiffness': 0.12}, 'wrong'),
    ('tip_payload', 'arm', 0.1, {'coupling': 0.12}, 'belief'),
    ('stribeck_error', 'joint1', -0.2, {'velocity': -0.2}, 'belief'),
    ('torque_ripple', 'joint1', 0.1, {'stiffness': 0.12}, 'wrong')])
def test_a_name_for_what_is_truly_believed_wrongly_is_not_wrong(name, joint, ratio, errors,
                                                                expected):
    """If it is more than 4 % off, on that joint, and in the direction named."""
    one = outcome(hidden=[effect('backlash')], findings=[finding(name, joint, ratio=ratio)],
                  beliefs=believed(**errors))
    assert judgement.judged(one) == expected


def test_peers_are_asked_on_the_rows_of_a_hidden_robot():
    """A dead zone that stands out, with its name in the library and without."""
    case = make_case('single', 13, duration=12.0)
    hidden, = (spec.key for spec in case.truth.effects)
    assert peers.ask(case)[peers.FORWARD][0] == hidden
    without = peers.ask(case, without=hidden[:1])[peers.FORWARD]
    assert without and hidden not in without


def test_score_prints_what_the_journal_holds(tmp_path, capsys):
    """All tried already: nothing is run, the report is written, a miss is exit code 1."""
    journal = Journal(tmp_path, fingerprint())
    for seed in range(2):
        journal.add(outcome(hidden=[effect('backlash')], seed=seed, findings=[
            finding('backlash' if seed else 'end_stop')]))
    args = ['score', '--kind', 'single', '--seeds', '0:2', '--out', str(tmp_path)]
    assert main(args) == 1
    out, beside = capsys.readouterr()
    assert beside.startswith('2 hidden robots, 2 of them in')
    assert 'hidden robots, ' not in out and '50.0 %' in out
    assert main([*args, '--json']) == 1
    reported = json.loads(capsys.readouterr().out)
    assert reported['cases'] == 2 and reported['missed'][0]['key'] == 'single/rich/drawn/60/0'
    assert json.loads((tmp_path / 'report.json').read_text()) == reported
