# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A first flexible-joint model of one axis: known axes are recovered, real data are judged."""

from pathlib import Path

from bench.real_machines.torsion import rms, study
from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.data.recording import Recording
from gms_flex_control.errors import BagError
import numpy as np
import pytest

pytestmark = pytest.mark.fast

ROOT = Path(__file__).resolve().parents[2]
KR300 = ROOT.parent / 'shared' / 'data' / 'kr300'
K, J, M = 4e5, 3.0, 20.0


def axis(delay=0.0, noise=0.0, **changed):
    """Return a recording of an axis whose link follows a known motion, all in closed form."""
    t = np.arange(2500) * 0.004
    w = 2 * np.pi * np.array([0.11, 0.37])

    def motion(time, order):
        phase = np.array([0.3, 1.1])[:, None] + 0.5 * np.pi * order
        return np.sum(np.array([[0.8], [0.2]]) * w[:, None] ** order * np.sin(
            w[:, None] * time + phase), axis=0)

    friction = np.where(motion(t, 1) > 0, 30.0, -20.0) + 8.0 * motion(t, 1)
    spring = M * motion(t, 2) + friction  # Eq. (1), link
    motor = motion(t, 0) + spring / K
    torque = spring + J * motion(t, 2)    # the motor accelerates as the link, but for the torsion
    torque = torque + noise * np.random.default_rng(0).standard_normal(len(t))
    return Recording(joints=('axis1',), source='a closed form', time=t, **{
        'q_link': motion(t - delay, 0)[:, None], 'q_motor': motor[:, None],
        'tau_motor': torque[:, None], **changed})


def test_inertia_and_friction_are_recovered_from_the_torque():
    found = study(axis(), 'axis1', K, J)
    assert found.inertia == pytest.approx(M + J, rel=0.02)
    assert found.coulomb == pytest.approx((30.0, 20.0), rel=0.05)
    assert found.viscous == pytest.approx(8.0, rel=0.1)
    measured, error = found.torque_error
    assert error < 0.03 * measured


def test_the_true_spring_explains_the_torsion_and_a_wrong_one_does_not():
    true = study(axis(), 'axis1', K, J)
    assert true.explanations[0].relative_error < 0.02
    assert true.explanations[3].stiffness == pytest.approx(K, rel=0.03)
    assert abs(true.explanations[3].delay) < 1e-5
    assert true.explanations[0].relative_error < true.explanations[1].relative_error
    assert study(axis(), 'axis1', K / 2, J).explanations[0].relative_error > 0.5


def test_a_delay_between_the_encoders_is_told_from_flexibility():
    delayed = axis(delay=0.003)
    found = study(delayed, 'axis1', K, J)
    assert found.explanations[2].delay == pytest.approx(0.003, abs=1e-4)
    assert found.explanations[2].relative_error < 0.05
    assert found.explanations[3].stiffness == pytest.approx(K, rel=0.1)
    stiff = study(delayed, 'axis1', 100 * K, J).explanations
    assert stiff[1].relative_error < stiff[0].relative_error


@pytest.mark.parametrize(('joint', 'stiffness', 'changed', 'message'), [
    ('axis9', K, {}, "no joint 'axis9'; it has axis1"),
    ('axis1', -1.0, {}, 'stiffness must be above 0'),
    ('axis1', np.nan, {}, 'stiffness must be above 0'),
    ('axis1', K, {'q_motor': np.nan}, 'the motor angle is missing'),
    ('axis1', K, {'q_motor': 0.0}, 'must move both ways'),
])
def test_what_cannot_be_studied_is_refused(joint, stiffness, changed, message):
    with pytest.raises(BagError, match=message):
        study(axis(**changed), joint, stiffness)


def test_a_torque_of_the_wrong_sign_fits_no_axis():
    with pytest.raises(BagError, match='is its sign or scale wrong'):
        study(axis(tau_motor=-axis().tau_motor), 'axis1', K, J)


@pytest.mark.skipif(not KR300.is_dir(), reason=f'the recordings of {KR300} are not here')
def test_the_first_look_at_a_real_robot_is_as_documented():
    """The numbers of docs/real_machines.md."""
    log = import_csv(KR300 / 'rec_A.csv', ROOT / 'config' / 'import_kr300.yaml')
    found = study(log.recording, 'axis1', 4.58e6)
    measured, error = found.torque_error
    assert error / measured == pytest.approx(0.222, abs=0.001)
    assert found.inertia == pytest.approx(2033, abs=1)
    assert 1e3 * np.degrees(rms(found.torsion)) == pytest.approx(40.27, abs=0.01)
    assert [e.relative_error for e in found.explanations] == pytest.approx(
        [0.816, 0.098, 0.242, 0.088], abs=0.001)
    assert 1e3 * found.explanations[1].delay == pytest.approx(3.07, abs=0.01)
    documented = (ROOT / 'docs' / 'real_machines.md').read_text(encoding='utf-8')
    for number in (f'{1e3 * np.degrees(rms(found.torsion)):.1f} mdeg',
                   f'{1e3 * found.explanations[1].delay:.2f} ms'):
        assert number in documented
