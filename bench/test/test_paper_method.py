# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The paper's method finds friction it was not reported, step by step and as a whole."""


from bench.__main__ import main
from bench.paper_method.method import fit_map, fit_paper, steady_torque
from gms_flex_control.data.writer import write_recording
from gms_flex_control.identification.coordinates import presliding_curve
from gms_flex_control.schema.files import save_robot
from identified_axis import axis
from identified_axis import experiment as axis_experiment
import numpy as np
from paper_experiment import experiment, hidden, unnamed
import pytest

SEED = 11
STEADY = ('static', 'coulomb', 'velocity', 'viscous')


@pytest.fixture(scope='module', params=['joint1', 'joint2'])
def ideal(request, robot, gains):
    j = robot.joints.index(request.param)
    recording, _, segments, half = experiment(robot, gains, request.param, SEED, ideal=True)
    return robot, j, recording.period, segments, half[j], hidden(robot, SEED).friction


def fit(data, segments=None):
    robot, j, period, own, half, _ = data
    return fit_paper(own if segments is None else segments, robot.arm, j, period, half)


def steady_of(friction, j):
    return np.array([[getattr(way, name)[j] for name in STEADY]
                     for way in (friction.forward, friction.backward)])


@pytest.mark.parametrize(('named', 'off'), [(True, 0.08), (False, 0.2)],
                         ids=['phases recorded', 'phases found'])
def test_hidden_friction_is_found_from_ideal_encoders(ideal, named, off):
    """F_s, F_c, sigma_2 within 1 %, v_s 2 %, C 5 %, presliding within 8 or 20 % of F_s."""
    _, j, _, segments, _, truth = ideal
    found = fit(ideal, segments if named else unnamed(segments))
    steady, true = found.theta[:8].reshape(2, 4), steady_of(truth, j)
    np.testing.assert_allclose(steady[:, [0, 1, 3]], true[:, [0, 1, 3]], rtol=0.01)
    np.testing.assert_allclose(steady[:, 2], true[:, 2], rtol=0.02)
    assert found.theta[8] == pytest.approx(truth.attraction[j], rel=0.05)
    static = true[:, 0].mean()
    displacement = np.geomspace(1e-5, 0.02, 60)
    curve = np.minimum(np.outer(displacement, truth.stiffness[j]), static / 6).sum(axis=1)
    np.testing.assert_allclose(presliding_curve(found.theta, displacement), curve,
                               atol=off * static)


def test_encoders_of_20000_counts_leave_the_steady_part_within_reach(robot, gains):
    """F_s within 10 %, Eq. (6) within 3 %; most presliding is within a few counts, and is not."""
    recording, _, segments, half = experiment(robot, gains, 'joint2', SEED, ideal=False)
    found = fit_paper(segments, robot.arm, 1, recording.period, half[1])
    for own, true in zip(found.theta[:8].reshape(2, 4),
                         steady_of(hidden(robot, SEED).friction, 1), strict=True):
        assert own[0] == pytest.approx(true[0], rel=0.1)
        speed = np.geomspace(0.03, 2.0, 30)
        np.testing.assert_allclose(steady_torque(speed, *own), steady_torque(speed, *true),
                                   rtol=0.03)


def test_map_fit_inverts_equation_6_with_break_away_at_zero_velocity():
    speed = np.array([0.0, 0.0, *np.geomspace(3e-3, 1.0, 10)])
    torque = 0.09 + 0.02 * np.exp(-(speed / 0.01) ** 2) + 0.05 * speed
    values, _ = fit_map(speed, torque)
    np.testing.assert_allclose(values, [0.11, 0.09, 0.01, 0.05], rtol=1e-4)


def test_intervals_of_the_map_hold_the_truth_as_often_as_they_say():
    """95 % intervals over 200 noise seeds: at least 90 and at most 99 % each."""
    rng, truth = np.random.default_rng(3), np.array([0.11, 0.09, 0.01, 0.05])
    speed = np.repeat(np.geomspace(3e-3, 1.0, 10), 3)
    clean = 0.09 + 0.02 * np.exp(-(speed / 0.01) ** 2) + 0.05 * speed
    inside = []
    for _ in range(200):
        _, intervals = fit_map(speed, clean + 5e-4 * rng.standard_normal(len(speed)))
        inside.append([i.low <= value <= i.high
                       for i, value in zip(intervals, truth, strict=True)])
    coverage = np.mean(inside, axis=0)
    assert np.all((coverage >= 0.9) & (coverage <= 0.99)), coverage


def test_the_verb_prints_both_methods_side_by_side(tmp_path, capsys):
    """Coulomb friction of both within 5 % of the truth; steady friction and C of each way."""
    recording, phases = axis_experiment(rigid=True)
    save_robot(axis(rigid=True), tmp_path / 'robot.yaml')
    write_recording(tmp_path / 'bag', recording, ('',), phases=phases)
    assert main(['paper-method', str(tmp_path / 'bag'), '--robot',
                 str(tmp_path / 'robot.yaml')]) == 0
    rows = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines()[2:]}
    assert len(rows) == 9
    for side, true in (('forward', 0.09087), ('backward', 0.08363)):
        _, paper, low, _, high, default, *_ = rows[f'joint1.{side}.coulomb']
        assert [float(paper), float(default)] == pytest.approx([true] * 2, rel=0.05)
        assert float(low) < float(paper) < float(high)
