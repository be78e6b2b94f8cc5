# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Conditions on the gains against eigenvalues, simulation and the command line."""

from dataclasses import replace
import json
from pathlib import Path
import re

from gms_flex_control.cli.main import main
from gms_flex_control.control import gain_conditions
import numpy as np
import pytest

pytestmark = pytest.mark.fast

CONFIG = Path(__file__).resolve().parent.parent / 'config'


def with_arm(robot, **values):
    return replace(robot, arm=replace(robot.arm, **values))


def of_kind(report, kind):
    return [c for c in report.conditions if c.kind == kind]


def test_the_papers_gains_hold_on_the_default_robot(gains, robot):
    report = gain_conditions.check(gains, robot)
    assert report.met
    assert len(report.conditions) == 8
    assert gain_conditions.violations(gains, robot) == []
    assert of_kind(report, 'exact')[0].value == pytest.approx(30 * np.sqrt(2 * 0.8 * 0.2))


def test_stiffness_above_twice_kd_breaks_39_but_not_the_exact_condition(gains, robot):
    """Eq. (39) with K_D1 = 0.8 allows K < 1.6; N_2 stays positive definite far above."""
    assert gain_conditions.check(gains, with_arm(robot, stiffness=[1.59, 1.59])).met
    stiff = with_arm(robot, stiffness=[1.61, 1.5])
    sentences = gain_conditions.violations(gains, stiff)
    assert len(sentences) == 1
    for part in ('joint1: K_D1 > K/2', '0.8 is not above 0.805', 'still holds', '16.97'):
        assert part in sentences[0]
    assert gain_conditions.check(gains, stiff).alpha.min() > 0


@pytest.mark.parametrize('seed', range(8))
def test_the_exact_condition_is_the_sign_of_the_smallest_eigenvalue(gains, robot, seed):
    rng = np.random.default_rng(seed)
    gains = replace(gains, **{name: rng.uniform(0.05, 2.0, 2) for name in (
        'kd_link', 'lambda_link', 'kd_motor', 'lambda_motor')})
    limit = gains.lambda_motor * np.sqrt(2 * gains.kd_link * gains.kd_motor)
    for factor, positive in ((0.999, True), (1.001, False)):
        report = gain_conditions.check(gains, with_arm(robot, stiffness=factor * limit))
        assert list(report.alpha > 0) == [positive, positive]
        assert [c.met for c in of_kind(report, 'exact')] == [positive, positive]
        assert np.isfinite(report.residual) == positive


@pytest.mark.parametrize('seed', range(8))
def test_all_gershgorin_rows_imply_a_positive_definite_matrix(gains, robot, seed):
    """Also for Lambda_1 < 1, where the two printed rows alone do not make the discs positive."""
    rng = np.random.default_rng(seed)
    gains = replace(gains, **{name: rng.uniform(0.05, 3.0, 2) for name in (
        'kd_link', 'lambda_link', 'kd_motor', 'lambda_motor')})
    report = gain_conditions.check(gains, with_arm(robot, stiffness=rng.uniform(0.01, 3.0, 2)))
    for joint, alpha in zip(report.joints, report.alpha, strict=True):
        if all(c.met for c in of_kind(report, 'gershgorin') if c.joint == joint):
            assert alpha > 0


@pytest.mark.parametrize('mode', ['none', 'gms_paper', 'gms'])
def test_n2_is_the_quadratic_form_of_the_proof(gains, robot, mode):
    """Row by row of Eq. (37), and rho' N_2 rho = -dV/dt without disturbance."""
    gains = replace(gains, compensation=mode)
    matrix = gain_conditions.n2_matrices(gains, robot)[1]
    k1, l1, k2, l2, stiffness = 0.8, 3.0, 0.22, 40.0, 1.5
    rng = np.random.default_rng(1)
    q1, dq1, q2, dq2, *blocks = rho = rng.standard_normal(len(matrix))
    s1, s2 = dq1 + l1 * q1, dq2 + l2 * q2
    rate = (s1 * (stiffness * q2 - k1 * s1) + 2 * l1 * k1 * q1 * dq1
            - k2 * s2 ** 2 + 2 * l2 * k2 * q2 * dq2)
    rate -= sum(1.0 / 0.10697 / 1.0 * block ** 2 for block in blocks)
    assert len(blocks) == (0 if mode == 'none' else 6)
    assert rho @ matrix @ rho == pytest.approx(-rate)


def test_n1_is_the_energy_of_the_proof(gains, robot):
    """Positive definite for any inertia, unlike the print; extremes bound V of random errors."""
    heavy = replace(robot, motors=('joint1_motor', ''),
                    arm=replace(robot.arm, mass=[50.0, 20.0], stiffness=[1.0, np.inf]))
    report = gain_conditions.check(gains, heavy)
    low, high = report.energy_range
    assert 0 < low < high
    mass = gain_conditions.mass_matrices(heavy.arm)
    rng = np.random.default_rng(2)
    for k in rng.integers(0, len(mass), 50):
        q1, dq1 = rng.standard_normal((2, 2))
        s1 = dq1 + gains.lambda_link * q1
        twice = s1 @ mass[k] @ s1 + q1 @ (2 * gains.lambda_link * gains.kd_link * q1)
        assert low * (q1 @ q1 + dq1 @ dq1) <= twice <= high * (q1 @ q1 + dq1 @ dq1)


def test_mass_extremes_are_those_of_the_closed_form(robot, gains):
    """M11 = a + b cos(q2), M12 = c + b/2 cos(q2), M22 = c: extremes over a fine sweep."""
    c2 = np.cos(np.linspace(0, np.pi, 2001))
    m11, m12, m22 = 0.31175 + 0.105 * c2, 0.03 + 0.0525 * c2, np.full_like(c2, 0.03)
    both = np.linalg.eigvalsh(np.moveaxis(np.array([[m11, m12], [m12, m22]]), -1, 0))
    report = gain_conditions.check(gains, robot)
    assert report.mass_range == pytest.approx((both.min(), both.max()), rel=1e-4)


def test_a_rigid_joint_has_no_motor_rows(gains, robot):
    rigid = replace(robot, motors=('', 'joint2_motor'),
                    arm=replace(robot.arm, stiffness=[np.inf, 1.5]))
    report = gain_conditions.check(gains, rigid)
    assert {c.joint for c in report.conditions} == {'joint2'}
    assert gain_conditions.n2_matrices(gains, rigid)[0].shape == (8, 8)


@pytest.mark.parametrize(('mode', 'expected'), [
    ('none', np.sqrt(10 * (0.10787 ** 2 + 0.10697 ** 2))),
    ('gms_paper', np.sqrt(10 * (0.10787 ** 2 + 0.10697 ** 2) + (1.5 ** 2 + 1.0 ** 2) / 6)),
    ('gms', 2 * np.sqrt(10 * (0.10787 ** 2 + 0.10697 ** 2)))])
def test_the_disturbance_bound_follows_from_break_away_levels(gains, robot, mode, expected):
    gains = replace(gains, compensation=mode)
    assert gain_conditions.disturbance_bound(gains, robot) == pytest.approx(expected)


def tool(*arguments):
    return main(['check-gains', *map(str, arguments)])


def test_the_command_prints_condition_value_limit_and_verdict(capsys, tmp_path):
    assert tool() == 0
    out = capsys.readouterr().out
    for part in ('condition', 'limit', 'verdict', 'K_D1 > K/2', 'ok', 'residual set (43)'):
        assert part in out
    stiff = tmp_path / 'stiff.yaml'
    stiff.write_text('/**:\n  ros__parameters:\n    arm:\n      joint1:\n'
                     '        stiffness: 40.0\n', encoding='utf-8')
    # the bound, and the two factors of which it is made
    pushed, spread = (float(re.search(f'{name}.*= ([0-9.]+)', out).group(1))
                      for name in ('D_bar / alpha', 'lmax / lmin'))
    bound = float(re.search(r'ends below ([0-9.]+)\.\n  Not a prediction', out).group(1))
    assert pushed * spread == pytest.approx(bound, rel=0.02)
    assert tool('--robot', CONFIG / 'robot.yaml', stiff) == 1
    out = capsys.readouterr().out
    assert 'VIOLATED' in out and 'none, because N_2 is not positive definite' in out
    assert tool('--robot', CONFIG / 'robot.yaml', stiff, '--json') == 1
    result = json.loads(capsys.readouterr().out)
    assert result['residual_bound'] is None and not result['met']
    assert {'joint', 'kind', 'condition', 'value', 'limit', 'met'} == set(result['conditions'][0])
