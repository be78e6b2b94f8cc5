# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Ripples that pass faster than the whitened residuals show: found, sized, and not invented."""

from dataclasses import replace
from types import SimpleNamespace

from bench.hidden_robots import motions
from core_runs import affected, effect_on, single_axis
from discrepancy_runs import as_believed, driven, driven_motion, motion_along, retuned_of
from gms_flex_control.discrepancy import residual_views
from gms_flex_control.discrepancy.evidence import State
from gms_flex_control.discrepancy.fast_ripple import fast_ripples, with_ripples
from gms_flex_control.discrepancy.gap import HeldOut
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.result import FOUND
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.params.robot import FrictionParams, StribeckParams
from gms_flex_control.reports.discrepancy_page import write_discrepancy_report
import numpy as np
import pytest

LEVEL, INERTIA, PERIOD, NOISE = 0.5, 0.02, 1e-3, 0.1
SIDE = StribeckParams(static=[LEVEL], coulomb=[LEVEL], velocity=[0.05], viscous=[0.0])


def rotor(*waves, seed=0, duration=20.0):
    """
    Return the Likelihood of a rigid axis that swings at 3 rad/s, in closed form.

    Its torque is that of inertia, friction and noise, less the waves (amplitude, order, phase).
    """
    robot = single_axis(FrictionParams(forward=SIDE, backward=SIDE, stiffness=[[1e4]],
                                       weight=[[1.0]], attraction=[100.0]), INERTIA)
    time, rng = np.arange(round(duration / PERIOD)) * PERIOD, np.random.default_rng(seed)
    angle = 6.0 * np.sin(0.5 * time) + 0.3 * np.sin(2.3 * time)
    rate = 3.0 * np.cos(0.5 * time) + 0.69 * np.cos(2.3 * time)
    # held from sample to sample: as it is half a sample later
    torque = (INERTIA * (-1.5 * np.sin(0.5 * time) - 1.587 * np.sin(2.3 * time))
              + LEVEL * np.tanh(rate / 0.01) + NOISE * rng.standard_normal(len(time)))
    torque -= sum(amplitude * np.sin(order * (angle + 0.5 * PERIOD * rate) + phase)
                  for amplitude, order, phase in waves)
    read = angle[:, None] + 1e-6 * rng.standard_normal((len(time), 1))
    return Likelihood([motion_along(robot, time, read, torque[:, None])], robot)


def test_waves_far_above_the_low_pass_are_sized():
    """Of 72 and 144 per turn, as cogging: they pass at 34 and 68 Hz, where nothing is whitened."""
    waves = [(0.06, 72.0, 0.7), (0.03, 144.0, -1.0)]
    likelihood = rotor(*waves)
    found = fast_ripples(likelihood, as_believed(likelihood))
    assert [one.spec.name for one in found] == ['torque_ripple', 'torque_ripple_2']
    for one, wave in zip(found, waves, strict=True):
        off = np.abs(np.subtract(one.spec.values, wave)) / one.deviations
        assert np.all(off < 4.0), (one, off)
        assert one.deviations[0] < 0.05 * wave[0] and one.deviations[1] < 0.05
        assert one.torque == pytest.approx(one.spec.values[0] / np.sqrt(2.0))


def test_intervals_hold_the_truth():
    """Twenty recordings, three numbers each: two deviations hold about 95 %."""
    held = []
    for seed in range(20):
        wave = (0.04, 90.0, 0.5)
        likelihood = rotor(wave, seed=seed, duration=8.0)
        found, = fast_ripples(likelihood, as_believed(likelihood))
        held += list(np.abs(np.subtract(found.spec.values, wave)) < 2.0 * np.array(
            found.deviations))
    assert 0.85 <= np.mean(held)


@pytest.mark.parametrize(('waves', 'seed'), [
    *(((), seed) for seed in range(6)), ([(0.005, 72.0, 0.0)], 0)])
def test_noise_has_none_and_a_wave_that_matters_not_is_none(waves, seed):
    likelihood = rotor(*waves, seed=seed)
    assert fast_ripples(likelihood, as_believed(likelihood)) == []


def test_a_wave_that_the_model_has_is_not_found_again():
    """Though it is twice as large as believed: another of its order would be no other ripple."""
    likelihood, wave = rotor((0.06, 72.0, 0.7)), (0.03, 72.0, 0.7)
    robot = affected(likelihood.robot, likelihood.robot.joints[0], 'torque_ripple', *wave)
    assert fast_ripples(likelihood, as_believed(likelihood, robot)) == []


def test_of_ripples_those_are_written_that_predict_better():
    """The second one is not there."""
    wave = (0.06, 72.0, 0.7)
    likelihood = rotor(wave)
    model, columns = retuned_of(likelihood)
    state = State(model, columns, columns[:0], 0.0)
    ripples = [SimpleNamespace(spec=effect_on(likelihood.robot.joints[0], name, *values))
               for name, values in (('torque_ripple', wave), ('torque_ripple_2', (0.3, 3.0, 0.0)))]
    held_out = HeldOut(likelihood)
    gap = held_out.gap(state, state)
    written, with_it = with_ripples(likelihood, held_out, ripples, (state, state), gap)
    assert [spec.values for spec in written.model.robot.effects] == [wave]
    assert np.all(with_it.after <= 1.05 * gap.after)


@pytest.mark.parametrize(('effect', 'values', 'expected'), [
    ('torque_ripple', (0.01, 150.0, 0.3), ['torque_ripple']),
    ('kinematic_error', (2e-4, 150.0, 0.3), [])])
def test_an_error_of_the_gear_is_no_ripple(effect, values, expected, robot, gains):
    """Both act on the motor alike; the link feels an error of the gear as well."""
    hidden = affected(robot, 'joint1', effect, *values)
    likelihood = Likelihood([driven_motion(hidden, gains)], robot)
    found = fast_ripples(likelihood, retuned_of(likelihood)[0])
    assert [one.spec.name for one in found] == expected


def test_the_workflow_names_it_and_writes_it(robot, gains, tmp_path):
    """Two waves per turn of the generator of a gear of 160: they pass at 28 Hz, and at 80."""
    time, true_wave = np.arange(10_000) * 2e-3, (0.015, 320.0, 0.3)
    reference = motions.draw_reference(np.random.default_rng(7), 'rich', 'soft', time)
    recording = driven(robot, robot, gains, reference, time,
                       effect_on('joint1', 'torque_ripple', *true_wave))
    result = find_discrepancy([recording], robot)
    assert result.verdict == FOUND, result.words
    assert [(one.effect, one.joint) for one in result.findings] == [('torque_ripple', 'joint1')]
    assert result.findings[0].full_rate
    for value, true in zip(result.findings[0].values, true_wave, strict=True):
        assert value.low < true < value.high
    assert [spec.name for spec in result.robot.effects] == ['torque_ripple']
    own = residual_views.AlongUnfiltered(result.behind.likelihood)
    shown = residual_views.evidence_of(own, result.behind.written, result.findings[0])
    assert (shown.equation, shown.of_joint) == ('motor', 'joint1')
    wave = shown.own.mean / (shown.own.mean @ shown.own.mean)
    assert wave @ shown.before.mean == pytest.approx(1.0, abs=0.3)
    assert abs(wave @ shown.after.mean) < 0.3
    assert np.ptp(shown.own.mean) == pytest.approx(2.0 * true_wave[0], rel=0.1)
    less = replace(result.behind.written, robot=robot)  # as where free runs were worse with it
    for one in (result, replace(result, robot=robot, behind=result.behind._replace(written=less))):
        written = write_discrepancy_report(one, tmp_path)
        assert any('torque_ripple' in path.name for path in written)
