# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What data held out say of effects: whether they help, and what is but chance."""

from dataclasses import replace
from types import SimpleNamespace

from gms_flex_control.discrepancy.free_run import all_known, HORIZON
from gms_flex_control.discrepancy.gap import farther, free_rms
from gms_flex_control.discrepancy.naming import choices, helps, makes_worse, strayed
from gms_flex_control.discrepancy.path import path_of
from gms_flex_control.discrepancy.problem import BLOCK, Problem
from gms_flex_control.discrepancy.result import FOUND, Gap
from gms_flex_control.discrepancy.words import of_nearest, of_withheld
from gms_flex_control.discrepancy.workflow import discrepancy
from gms_flex_control.hidden.cases import make_case
from gms_flex_control.reports.discrepancy import write_discrepancy_report
from gms_flex_control.reports.discrepancy_values import report_values, write_robot
import numpy as np
import pytest


def gap(torque=0.5, stray=0.5, farther=0.0):
    """Return a Gap by its ratios of squares."""
    zero = np.zeros(1)
    return Gap(joints=('j',), before=zero, retuned=zero, after=zero, floor=zero, free_floor=zero,
               energy_ratio=torque, free_before=np.ones(1), free_after=np.sqrt([stray]),
               free_farther=farther)


@pytest.mark.parametrize(('told', 'expected'), [
    (gap(), True), (gap(torque=1.2), False), (gap(stray=1.01, farther=3.0), True),
    (gap(stray=1.3, farther=3.0), False), (gap(stray=1.3, farther=0.4), True),
    (gap(stray=1.8, farther=0.4), False), (gap(torque=1.05, stray=1.01), False),
    (gap(torque=0.1, stray=1.5, farther=3.0), True),
    (gap(torque=0.1, stray=1.9, farther=3.0), False),
    (gap(torque=0.1, stray=1.9, farther=0.4), True)])
def test_effects_must_help_on_data_held_out(told, expected):
    """In torque and in free runs, one of which may be a little worse by chance."""
    assert helps(told, much=False) is expected
    assert not helps(gap(torque=0.6, stray=0.6), much=True)
    assert not helps(gap(stray=1.001), much=False, strictly=True)


def test_what_makes_a_model_worse_is_named_and_not_added(tmp_path):
    """A true spring with which links break loose a moment sooner in some free runs."""
    assert not makes_worse(gap(torque=1.01, stray=1.01))
    assert makes_worse(gap(torque=1.05)) and makes_worse(gap(stray=1.05))
    assert not makes_worse(replace(gap(stray=1.05), free_floor=np.full(1, 1.03)))
    case = make_case('single', 75)
    result = discrepancy([case.recording], case.nominal, holdout=[case.held_out])
    assert result.verdict == FOUND
    assert [(one.effect, one.joint) for one in result.named] == [
        (one.name, one.joint) for one in case.truth.effects]
    assert result.named[0].rms_after[1] < 0.8 * result.named[0].rms_before[1]
    assert of_withheld(result.withheld) in result.words
    assert strayed(result.withheld) > 1.02 and 'would stray 1.04 times as far' in result.words
    assert result.robot.effects == ()
    for before, after in ((result.gap.retuned, result.gap.after),
                          (result.gap.free_before, result.gap.free_after)):
        np.testing.assert_array_equal(before, after)
    write_robot(result, tmp_path / 'robot.yaml')
    assert 'not added to the model' in ' '.join(
        (tmp_path / 'robot.yaml').read_text().replace('#', ' ').split())
    told = report_values(result)
    assert told['withheld']['free_after']['joint2'] > told['gap']['free_after']['joint2']
    page = write_discrepancy_report(result, tmp_path, holdout=[case.held_out])[0].read_text()
    assert 'What is named here is not added to the model' in page


def test_why_effects_are_withheld_is_told():
    assert '1.02 times as large with it, and free runs would stray 0.8 times' in of_withheld(
        gap(torque=1.05, stray=0.64))
    without_runs = replace(gap(torque=1.05), free_after=np.full(1, np.nan))
    assert of_withheld(without_runs).endswith('1.02 times as large with it.')


def test_an_effect_that_explains_a_trifle_is_not_the_first():
    """Though it makes a larger torque, where encoders hide what happens."""
    case = make_case('single', 45, motion='polynomial')
    result = discrepancy([case.recording], case.nominal, holdout=[case.held_out])
    first, *others = result.named
    assert result.findings[0] is first
    assert (first.effect, first.joint) == ('motor_coulomb', 'joint1')
    larger = max(others, key=lambda one: one.torque)
    assert larger.torque > 2.0 * first.torque and larger.score < 0.05 * first.score


def test_what_many_share_may_be_named_by_what_alone_explains_most():
    """An encoder that is read late, beside a softer spring that nearly makes the same of it."""
    shared, skew = (SimpleNamespace(loss=loss) for loss in (2.0, 0.1))
    offered = choices([shared, skew], 0.01, 1000.0, [skew])
    assert offered == (([shared, skew], False), ([shared], False), ([skew], True))
    assert choices([shared, skew], 0.9, 1000.0, [skew]) == ()


def test_one_run_that_slips_is_no_matter_of_all_of_them():
    """A hundred runs that stray by a tenth less, one of which strays ten times as far."""
    rng = np.random.default_rng(0)
    before = rng.uniform(0.5, 1.5, (100, 2))
    slipped, worse = 0.9 * before, 1.1 * before
    slipped[7] *= 10.0
    assert -20.0 < farther(before, slipped) < 1.0
    assert farther(before, worse) > 10.0
    assert farther(before, before) == 0.0


def test_without_free_runs_torque_decides():
    """Where data held out are too short for any, nothing has strayed less."""
    none = np.full(1, np.nan)
    for much, torque, expected in ((False, 1.0, False), (True, 0.9, False), (False, 0.5, True)):
        told = replace(gap(torque=torque), free_before=none, free_after=none)
        assert helps(told, much=much) is expected


def test_what_helps_motion_much_and_torque_too_little_is_told():
    near = [(0.6, 0.9, [('backlash', 'j1')]), (np.nan, 0.1, [('drag', 'j1')]),
            (0.1, 9.0, [('drag', 'j2')]),
            (0.33, 1.21, [('load_friction', 'j1'), ('torque_gain', 'j2')])]
    told = of_nearest(near)
    assert 'nearest comes load_friction of j1 and torque_gain of j2' in told
    assert '0.57 times' in told and '1.1 times' in told
    assert of_nearest(near[:3]) == of_nearest([]) == ''


def test_free_runs_do_not_cross_holes():
    """A line through half a second that nobody saw is no motion."""
    case = make_case('clean', 3, duration=20.0)
    recording = case.recording
    hole = (recording.time > 6.6) & (recording.time < 7.1)
    assert (recording.time[hole] // BLOCK % 4 == 3).all()
    with_hole = replace(recording, **{
        name: np.where(hole[:, None], np.nan, getattr(recording, name))
        for name in ('q_link', 'q_motor', 'dq_link', 'dq_motor')})
    strays = []
    for one in (recording, with_hole):
        problem = Problem([path_of(one, case.nominal)], case.nominal, 0.005)
        strays.append(free_rms(problem, problem.robot, np.zeros(len(problem.knobs))))
    assert np.all(strays[1] < 1.5 * strays[0])
    path = path_of(with_hole, case.nominal)
    nothing = replace(path, known=np.zeros_like(path.known))
    assert np.all(np.isnan(free_rms(problem, problem.robot, np.zeros(len(problem.knobs)),
                                    [nothing])))


@pytest.mark.parametrize('unread', [slice(None, 1), slice(-1, None), slice(100, 110)])
def test_a_run_is_known_if_all_its_samples_were_read(unread):
    time = 0.01 * np.arange(300)
    path = SimpleNamespace(time=time, known=np.ones(300, dtype=bool))
    path.known[unread] = False
    starts = 0.5 * np.arange(6) - 0.004
    expected = [np.all(path.known[(time >= start) & (time < start + HORIZON)])
                for start in starts]
    assert not all(expected)
    assert list(all_known(path, starts)) == expected


@pytest.mark.parametrize('duration', [2.2, 4.3, 6.2, 8.0, 9.1])
def test_some_of_every_recording_is_held_out_half_of_it_at_most(duration):
    case = make_case('clean', 3, duration=duration)
    problem = Problem([path_of(case.recording, case.nominal)], case.nominal, 0.005)
    moments, whitening = problem.moments_held_out[0], problem.whitenings[0]
    assert 0.1 <= moments.sum() / whitening.settled.sum() <= 0.6
    assert problem.fitted.sum() > 0.9 * problem.held_out.sum()


def test_blocks_are_held_out_in_which_a_stop_is_met():
    """The usual ones, every fourth block of 2 s, would say nothing of it."""
    case = make_case('single', 32, effect='end_stop', duration=20.0)
    stop, = case.truth.effects
    recording = case.recording
    assert stop.values[0] < 0.0
    beyond = recording.time[recording.q_link[:, recording.joints.index(stop.joint)]
                            < stop.values[0]]
    assert len(beyond) and not np.any((beyond // BLOCK).astype(int) % 4 == 3)
    result = discrepancy([recording], case.nominal)
    problem = result.behind.problem
    held_out = problem.whitenings[0].time[problem.moments_held_out[0]]
    assert np.isin(np.rint(held_out / 0.02), np.rint(beyond / 0.02)).any()
    assert [one.effect for one in result.findings] == ['end_stop']
    joint = recording.joints.index(stop.joint)
    assert result.gap.after[joint] < 0.5 * result.gap.retuned[joint]
