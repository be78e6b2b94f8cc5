# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Velocity and torque levels: held, reached smoothly, moved to where they are to begin."""

from gms_flex_control.errors import ConfigError, TrajectoryError
from gms_flex_control.schema.keys import trajectory_keys
from gms_flex_control.schema.node_values import trajectory_from_values
from gms_flex_control.trajectory import builders
import numpy as np
import pytest

pytestmark = pytest.mark.fast


def assert_consistent(trajectory, bound):
    """Each row is the derivative of the row before."""
    time = np.linspace(-0.1, trajectory.end + 0.1, 20001)
    rows = trajectory.sample(time)
    for k in range(3):
        slope = np.gradient(rows[:, k], time, axis=0)
        assert np.abs(slope - rows[:, k + 1])[2:-2].max() < bound * (
            1.0 + np.abs(rows[:, k + 1]).max())


def test_velocities_are_held_in_turn_between_two_rests():
    trajectory = builders.velocity_levels([[0.3, 0.0], [-0.1, 0.2]], [2.0, 1.0], settle_time=0.5)
    assert trajectory.end == pytest.approx(4.5)
    at = trajectory.sample(np.array([0.0, 0.5, 1.5, 2.5, 3.0, 4.0, 4.5, 9.0]))
    assert at[:, 1] == pytest.approx(np.array(
        [[0, 0], [0.3, 0], [0.3, 0], [0.3, 0], [-0.1, 0.2], [-0.1, 0.2], [0, 0], [0, 0]]))
    # a change of velocity covers the mean of both
    assert at[-1, 0] == pytest.approx([0.075 + 0.6 + 0.05 - 0.1 - 0.025, 0.05 + 0.2 + 0.05])
    assert_consistent(trajectory, 1e-3)


def test_torques_reach_their_levels_at_the_mean_rate_and_stop_there():
    trajectory = builders.torque_levels([[0.2, 0.0], [-0.1, 0.0]], 0.1)
    assert trajectory.quantity == 'effort' and trajectory.end == pytest.approx(2.0 + 3.0 + 1.0)
    at = trajectory.sample(np.array([0.0, 2.0, 5.0, 6.0, 9.0]))
    assert at[:, 0, 0] == pytest.approx([0.0, 0.2, -0.1, 0.0, 0.0], abs=1e-12)
    assert np.abs(at[:, 1:3]).max() < 1e-9
    assert_consistent(trajectory, 1e-3)


def test_a_smooth_torque_leaves_the_motor_on_its_spring_quiet():
    """Against a straight ramp of the same rate, on an undamped oscillator of 16 rad/s."""
    omega, dt = 16.0, 1e-4

    def ringing(trajectory):
        force = trajectory.sample(dt * np.arange(round((trajectory.end + 1.0) / dt)))[:, 0, 0]
        x = v = 0.0
        tail = []
        for k, f in enumerate(force):
            v += dt * omega ** 2 * (f - x)
            x += dt * v
            if k * dt > trajectory.end:
                tail.append(x)
        return max(map(abs, tail))

    assert ringing(builders.torque_levels([[0.1]], 0.05)) < 1e-4
    assert ringing(builders.torque_ramp([0.1], 0.05)) > 1e-3


def test_zero_levels_are_a_lasting_zero_torque():
    trajectory = builders.torque_levels(np.zeros((1, 2)), 1.0)
    assert trajectory.end == 0.0 and np.all(trajectory.sample(np.array([0.0, 5.0])) == 0.0)


@pytest.mark.parametrize('make', [
    lambda: builders.velocity_levels([[0.1]], [1.0, 2.0]),
    lambda: builders.velocity_levels([[0.1]], [0.0]),
    lambda: builders.velocity_levels([[0.1]], [1.0], settle_time=0.0),
    lambda: builders.torque_levels([[0.1]], 0.0)])
def test_what_makes_no_reference_is_refused(make):
    with pytest.raises(TrajectoryError):
        make()


def test_parameters_move_motions_and_hold_torques_against_gravity():
    values = {key.name: key.default for key in trajectory_keys(('a', 'b'))}
    for kind in ('constant_velocity', 'velocity_levels', 'sliding'):
        motion = values | {'trajectory.type': kind, 'trajectory.b.velocities': (0.2,)}
        here = trajectory_from_values(motion, ('a', 'b')).sample(np.array([0.0, 2.0]))
        there = trajectory_from_values(motion | {'trajectory.b.offset': -0.7}, ('a', 'b')).sample(
            np.array([0.0, 2.0]))
        assert there[:, 0] - here[:, 0] == pytest.approx(np.array([[0.0, -0.7]] * 2))
        assert np.array_equal(here[:, 1:], there[:, 1:])
    for kind in ('torque_ramp', 'torque_levels'):
        torque = trajectory_from_values(
            values | {'trajectory.type': kind, 'trajectory.a.torque': 0.1,
                      'trajectory.a.levels': (0.1,), 'trajectory.b.bias': 2.0}, ('a', 'b'))
        assert torque.sample(0.0)[0] == pytest.approx([0.0, 2.0])
    with pytest.raises(ConfigError, match='same number of levels'):
        trajectory_from_values(values | {'trajectory.type': 'torque_levels',
                                         'trajectory.a.levels': (0.1, 0.2)}, ('a', 'b'))
