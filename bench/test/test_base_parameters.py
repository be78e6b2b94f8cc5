# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The benches of whole arms: scores, recordings and pictures."""

from bench.growth import recorded
from bench.hidden_arms.base_parameters import flexible_score, score_of
import numpy as np
import pytest


def test_only_parameters_that_claim_to_be_known_are_judged():
    """Four parameters, one of them vague, one beyond its interval."""
    truth = np.array([1.0, 2.0, -4.0, 0.5])
    values, error = np.array([1.01, 2.0, -4.4, 5.0]), np.array([0.01, 0.01, 0.1, 1.0])
    score = score_of(values, error, truth)
    assert score.known == 3
    assert score.worst == pytest.approx(0.4 / 4.4) and score.usual == pytest.approx(0.01 / 1.01)
    assert score.held == pytest.approx(2.0 / 3.0)


def test_presliding_of_flexible_joints_is_not_taken_for_inertia():
    """Of 15 parameters that count as known all are within 3 %, and in their intervals."""
    pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")
    score = flexible_score(1, 16.0)
    assert score.known >= 15 and score.worst < 0.03 and score.held > 0.9


def test_joints_of_a_recording_to_grow_by_move_unlike_each_other():
    robot, recording = recorded(6, 0.2)
    assert robot.arm.kind == 'urdf' and recording.period == pytest.approx(2e-3)
    assert recording.time[-1] == pytest.approx(12.0, abs=0.01)
    travel = np.ptp(recording.q_link, axis=0)
    assert np.all(travel > 0.5)
    assert abs(np.corrcoef(recording.q_link.T)[0, -1]) < 0.5
    assert np.all(np.std(recording.q_link - recording.reference[:, 0], axis=0) < 0.05)
