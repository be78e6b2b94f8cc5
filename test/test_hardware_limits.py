# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Limits against closed forms: ramps, ranges, speeds; what is beyond a margin is named."""

from types import SimpleNamespace

from gms_flex_control.errors import ParameterError
from gms_flex_control.hardware.limits import jump, limited, Limits, UNLIMITED, violation
import numpy as np
import pytest

pytestmark = pytest.mark.fast

NAMES = ('elbow', 'wrist')
STILL = np.zeros(2)


def limits(**changed):
    """Return limits of two joints."""
    values = {'torque': [2.0, 1.0], 'torque_rate': [5.0, 10.0], 'velocity': [1.0, 2.0],
              'velocity_margin': [0.5, 0.5], 'lower': [-1.0, -2.0], 'upper': [1.0, 2.0],
              'position_margin': [0.1, 0.1], 'torsion': [0.5, 0.5]}
    return Limits(**(values | changed))


def measured(q=(0.0, 0.0), dq=(0.0, 0.0), q_motor=None, dq_motor=None):
    """Return what a robot measures; the motor side as the link if not given."""
    return SimpleNamespace(q_link=np.array(q), dq_link=np.array(dq),
                           q_motor=np.array(q if q_motor is None else q_motor),
                           dq_motor=np.array(dq if dq_motor is None else dq_motor))


def ramp(command, before, steps, dt=0.002, q=STILL, dq=STILL):
    """Return the torques that a constant command becomes, (steps, 2)."""
    torques, torque = [], np.array(before, dtype=float)
    for _ in range(steps):
        torque = limited(np.array(command, dtype=float), torque, dt, q, dq, limits())
        torques.append(torque)
    return np.array(torques)


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_step_becomes_a_ramp_up_to_the_limit(sign):
    torques = ramp([9.0 * sign, 0.4 * sign], [0.0, 0.0], 300)
    k = np.arange(1, 301)
    np.testing.assert_allclose(torques[:, 0], sign * np.minimum(5.0 * 0.002 * k, 2.0))
    np.testing.assert_allclose(torques[:, 1], sign * np.minimum(10.0 * 0.002 * k, 0.4))


def test_torque_falls_at_once_and_rises_from_zero_on_the_other_side():
    np.testing.assert_array_equal(ramp([0.0, 0.3], [2.0, 1.0], 1), [[0.0, 0.3]])
    np.testing.assert_allclose(ramp([-2.0, -1.0], [2.0, 1.0], 3),
                               [[-0.01, -0.02], [-0.02, -0.04], [-0.03, -0.06]])


def test_no_command_and_no_time_allow_more_than_before():
    rng = np.random.default_rng(0)
    for _ in range(1000):
        before = rng.uniform(-1.0, 1.0, 2) * [2.0, 1.0]
        torque = limited(rng.normal(0.0, 10.0, 2), before, rng.uniform(-1.0, 0.0),
                         rng.normal(0.0, 2.0, 2), rng.normal(0.0, 2.0, 2), limits())
        assert (np.abs(torque) <= np.abs(before)).all() and (torque * before >= 0.0).all()


@pytest.mark.parametrize('q, dq, allowed', [
    ((1.0, 0.0), (0.0, 0.0), {-1}), ((-1.0, 0.0), (0.0, 0.0), {1}),
    ((5.0, 0.0), (-0.5, 0.0), {-1}), ((0.999, 0.0), (0.999, 0.0), {-1, 1}),
    ((0.0, 0.0), (1.0, 0.0), {-1}), ((0.0, 0.0), (-1.2, 0.0), {1}),
    ((1.1, 0.0), (-1.1, 0.0), set())])
def test_at_a_limit_only_inward_and_braking_torque_is_left(q, dq, allowed):
    """Out of the range and fast inwards: no torque at all."""
    for sign in (1.0, -1.0):
        torque = limited(np.array([sign, sign]), np.array([sign, sign]), 0.002, np.array(q),
                         np.array(dq), limits())
        assert torque[0] == (sign if sign in allowed else 0.0)
        assert torque[1] == sign  # the other joint is not touched


@pytest.mark.parametrize('state, words', [
    (measured(q=(1.11, 0.0)), 'elbow is at 1.11 rad, beyond its range of -1 to 1 by more than'),
    (measured(q=(0.0, -2.2)), 'wrist is at -2.2 rad'),
    (measured(dq=(0.0, 2.6)), 'the link side of wrist moves at 2.6 rad/s, above its limit of 2'),
    (measured(dq_motor=(-1.6, 0.0)), 'the motor side of elbow moves at -1.6'),
    (measured(q_motor=(0.6, 0.0)), 'motor and link of elbow are 0.6 rad apart'),
    (measured(q_motor=(0.0, -0.6)), 'a sign, a gear ratio or an encoder may be wrong'),
    (measured(q=(1.1, 2.1), dq=(-1.5, 2.5), q_motor=(1.5, 1.7)), '')])
def test_what_is_beyond_a_margin_is_said(state, words):
    said = violation(NAMES, state, limits())
    assert words in said and bool(words) == bool(said)


def test_an_angle_that_no_joint_could_reach_in_the_time_is_a_jump():
    """The fastest allowed is 1.5 and 2.5 rad/s; what is shorter than 10 ms counts as 10 ms."""
    before = STILL, STILL
    assert not jump(NAMES, measured([0.0149, 0.0249]), before, 0.002, limits())
    assert not jump(NAMES, measured([0.149, 0.249]), before, 0.1, limits())
    assert jump(NAMES, measured([0.3, 0.0]), before, 0.002, limits()).startswith(
        'elbow jumped from 0 to 0.3 rad within 2 ms')
    assert 'wrist' in jump(NAMES, measured([0.0, -0.26]), before, 0.1, limits())
    assert jump(NAMES, measured(q_motor=[0.0, 50.0]), before, 0.002, limits()).startswith(
        'the motor of wrist jumped from 0 to 50 rad')


@pytest.mark.parametrize('changed, words', [
    ({'torque': [1.0, -1.0]}, 'torque must be at least 0'),
    ({'lower': [1.0, 0.0], 'upper': [-1.0, 1.0]}, 'were they swapped'),
    ({'upper': [np.nan, 1.0]}, 'upper must be finite'),
    ({'torsion': [1.0]}, 'torsion must have shape')])
def test_limits_that_make_no_sense_are_refused(changed, words):
    with pytest.raises(ParameterError, match=words):
        limits(**changed)


def test_a_limit_that_nobody_gave_is_missing():
    assert limits().missing(NAMES) == ''
    assert limits(velocity=[1.0, UNLIMITED]).missing(NAMES) == 'limits.wrist.velocity'
    assert limits(lower=[-UNLIMITED, 0.0]).missing(NAMES) == 'limits.elbow.lower'
