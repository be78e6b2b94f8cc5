# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A recorded closed loop simulated anew; that it comes closer: test_cli_discrepancy.py."""

from dataclasses import replace

from core_runs import affected, effect_on
from gms_flex_control.data.recording import Recording
from gms_flex_control.discrepancy.compared import segment_of, simulated
from gms_flex_control.errors import BagError
from gms_flex_control.simulation import loop
from gms_flex_control.trajectory.builders import sinusoid
import numpy as np
import pytest


@pytest.fixture(scope='module')
def recording(ideal_robot, gains):
    """Return three seconds of the default robot, read without error."""
    run = loop.run(ideal_robot, ideal_robot, gains, sinusoid([0.3, 0.2], 2.0), duration=3.0)
    q_link, dq_link, q_motor, dq_motor = np.moveaxis(run.measured, 1, 0)
    return Recording(joints=ideal_robot.joints, time=run.time, q_link=q_link, dq_link=dq_link,
                     q_motor=q_motor, dq_motor=dq_motor, tau_motor=run.applied,
                     command=run.command, reference=run.reference,
                     friction_hat=run.friction_hat, source='bag')


def test_the_same_robot_moves_as_it_was_recorded(recording, ideal_robot, gains):
    segment = segment_of(recording)
    assert segment.period_ns == 2_000_000 and len(segment.measured) == len(recording.time)
    again = simulated(ideal_robot, ideal_robot, gains, segment)
    assert np.abs(again - recording.q_link).max() < 1e-12


def test_the_longest_part_with_a_reference_is_taken(recording, ideal_robot, gains):
    reference = recording.reference.copy()
    reference[[100, 1400]] = np.nan
    segment = segment_of(replace(recording, reference=reference))
    assert segment.begin == pytest.approx(101 * 2e-3)
    assert np.array_equal(segment.measured, recording.q_link[101:1400])
    again = simulated(ideal_robot, ideal_robot, gains, segment)  # from a moving arm
    assert np.abs(again - segment.measured)[-500:].max() < 2e-3


def test_a_pause_ends_a_segment(recording):
    """No straight line is drawn through it."""
    later = recording.time + 5.0 * (np.arange(len(recording.time)) >= 600)
    segment = segment_of(replace(recording, time=later))
    assert segment.begin == pytest.approx(later[600]) and segment.period_ns == 2_000_000
    assert np.array_equal(segment.measured, recording.q_link[600:])


def test_a_drift_goes_on_from_where_the_segment_begins(recording, ideal_robot, gains):
    """Twelve seconds after the first sample, a spring that goes soft is soft."""
    drifting = affected(ideal_robot, 'joint1', 'stiffness_drift', -0.5, 12.0)
    soft = affected(ideal_robot, 'joint1', 'stiffness_error', -0.5)
    segment = segment_of(recording)._replace(begin=12.0)
    expected, late, early = (simulated(robot, ideal_robot, gains, segment._replace(begin=begin))
                             for robot, begin in ((soft, 0.0), (drifting, 12.0), (drifting, 0.0)))
    assert np.abs(late - expected).max() < 1e-9 < 1e-4 < np.abs(early - expected).max()


def test_uneven_samples_are_put_on_an_even_grid(recording):
    jitter = 2e-4 * np.sin(np.arange(len(recording.time)))
    uneven = recording.time + jitter - jitter[0]
    angles = {name: np.stack([np.interp(uneven, recording.time, getattr(recording, name)[:, j])
                              for j in range(2)], axis=1) for name in ('q_link', 'q_motor')}
    segment = segment_of(replace(recording, time=uneven, **angles))
    assert np.abs(segment.measured - recording.q_link)[:-1].max() < 1e-4
    assert np.abs(segment.measured - angles['q_link']).max() > 1e-4


def test_without_a_reference_the_sentence_says_what_to_record(recording):
    with pytest.raises(BagError, match='bag: has no reference.*record /reference'):
        segment_of(replace(recording, reference=np.full_like(recording.reference, np.nan)))


def test_drives_have_the_voltage_that_was_recorded(recording, ideal_robot, gains):
    """One that falls by 5 V, with a twentieth of the torque a volt."""
    sag = effect_on('joint1', 'supply_sag', 0.05, 24.0)
    weaker = replace(ideal_robot, effects=(sag,))
    volts = np.linspace(24.0, 19.0, len(recording.time))
    segments = [segment_of(replace(recording, supply=supply))
                for supply in (None, np.full(len(volts), 24.0), volts)]
    unknown, full, less = (np.abs(simulated(weaker, ideal_robot, gains, segment)
                                  - recording.q_link).max(axis=0) for segment in segments)
    assert unknown.max() < 1e-12 and full.max() < 1e-12
    assert less[0] > 1e-3
