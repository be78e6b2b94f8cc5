# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""References: their derivatives, their joins, levels, and what cannot be built."""

from gms_flex_control.errors import ConfigError, TrajectoryError
from gms_flex_control.params.arm import Frames
from gms_flex_control.schema.build import trajectory_from_values
from gms_flex_control.schema.keys import trajectory_keys
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.polynomials import require_within, Trajectory
import numpy as np
import pytest

pytestmark = pytest.mark.fast

MOTIONS = {
    'hold': builders.hold([0.3, -0.2]),
    'via points': builders.via_points([[0.0, 0.0], [1.0, -0.5], [0.2, 0.7]], 1.5, 0.4),
    'polynomial': builders.polynomial([1.0, 0.6], 2.0, 0.5),
    'sinusoid': builders.sinusoid([1.0, -0.5], [2.0, 3.0], phase=[0.4, 0.0]),
    'constant velocity': builders.velocity_levels([0.5, -0.25], 1.6),
    'velocities in turn': builders.velocity_levels([[0.3, 0.0], [-0.1, 0.2]], [2.0, 1.0],
                                                   settle_time=0.5),
    'torques': builders.torque_levels([[0.2, 0.0], [-0.1, 0.0]], 0.1),
    'sliding': builders.sliding([0.5, -0.25], 0.6, 1.3, 3.0),
    'approach': builders.approach(
        np.random.default_rng(0).standard_normal((5, 2)),
        builders.sinusoid([1.0, 1.0], 2.0), 0.2, duration=1.0),
}


@pytest.mark.parametrize('name', MOTIONS)
def test_each_derivative_is_the_rate_of_the_one_before(name):
    """Central differences of order 2, away from the joins of segments."""
    trajectory, step = MOTIONS[name], 1e-5
    t = np.random.default_rng(1).uniform(0.0, 5.0, 300)
    joins = np.abs(t[:, None] - trajectory.start).min(axis=1) < 2 * step
    t = t[~joins & (t > trajectory.start[0])]
    slope = (trajectory.sample(t + step) - trajectory.sample(t - step)) / (2 * step)
    exact = trajectory.sample(t)
    for k in range(4):
        scale = max(np.abs(exact[:, k + 1]).max(), 1.0)
        np.testing.assert_allclose(slope[:, k], exact[:, k + 1], rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize('name', MOTIONS)
def test_all_five_rows_go_on_without_a_jump_across_joins(name):
    trajectory = MOTIONS[name]
    for join in trajectory.start[1:]:
        before, after = trajectory.sample(join - 1e-9), trajectory.sample(join + 1e-9)
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-5)


def test_a_sinusoid_ramped_in_is_the_sinusoid_and_starts_at_rest():
    trajectory = builders.sinusoid([1.0, 0.5], [6.0, 4.0], phase=[0.0, 0.3], ramp_time=3.0)
    np.testing.assert_allclose(trajectory.sample(0.0), 0.0, atol=1e-12)
    t = np.linspace(3.0, 20.0, 50)
    omega = 2 * np.pi / np.array([6.0, 4.0])
    for k in range(5):
        exact = [1.0, 0.5] * omega ** k * np.sin(omega * t[:, None] + [0.0, 0.3] + k * np.pi / 2)
        np.testing.assert_allclose(trajectory.sample(t)[:, k], exact, rtol=0, atol=1e-10)
    assert trajectory.end == np.inf


def test_via_points_rest_at_each_point_and_move_in_between():
    """Two moves of 1.5 s and three rests of 0.4 s, the first included: 4.2 s."""
    trajectory = MOTIONS['via points']
    assert trajectory.end == pytest.approx(4.2)
    for t, point in ((0.0, [0, 0]), (0.4, [0, 0]), (1.9, [1, -0.5]), (2.3, [1, -0.5]),
                     (3.8, [0.2, 0.7]), (99.0, [0.2, 0.7])):
        sample = trajectory.sample(t)
        np.testing.assert_allclose(sample[0], point, atol=1e-12)
        np.testing.assert_allclose(sample[1:], 0.0, atol=1e-9)
    resting = trajectory.sample(np.linspace(1.9, 2.29, 20))
    np.testing.assert_array_equal(resting[:, 1:], np.zeros((20, 4, 2)))  # the observer asks for 0
    halfway = trajectory.sample(0.4 + 0.75)
    np.testing.assert_allclose(halfway[0], [0.5, -0.25], atol=1e-12)


def test_the_polynomial_goes_there_and_back_as_often_as_asked():
    trajectory = builders.polynomial([1.0, 0.6], 2.0, 0.5, repeats=3)
    assert trajectory.end == pytest.approx(0.5 + 6 * 2.5)
    np.testing.assert_allclose(trajectory.sample([2.6, 5.1, 7.6, 20.0])[:, 0],
                               [[1.0, 0.6], [0.0, 0.0], [1.0, 0.6], [0.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize('given, degree', [(1, 1), (2, 3), (3, 5)])
def test_the_way_through_samples_of_a_polynomial_is_that_polynomial(given, degree):
    """Positions of a line, with velocities of a cubic, with accelerations of a quintic."""
    truth = np.polynomial.Polynomial(np.random.default_rng(degree).normal(size=degree + 1))
    times = np.array([0.0, 0.3, 0.5, 1.1, 1.4, 2.0])
    rows = [truth.deriv(k)(times) if k else truth(times) for k in range(5)]
    states = np.stack(rows, axis=1)[:, :, None]
    states[1:-1, given:] = np.nan  # the ends are given whole
    moments = np.linspace(0.0, 2.0, 77)[:-1]
    found = builders.through(times, states).sample(moments)[:, :, 0]
    for k in range(5):
        np.testing.assert_allclose(found[:, k], truth.deriv(k)(moments) if k else truth(moments),
                                   atol=1e-6)


def test_open_derivatives_leave_no_jump_and_the_end_at_rest():
    states = np.full((4, 5, 2), np.nan)
    states[:, 0] = [[0.0, 1.0], [0.5, 1.0], [0.4, -2.0], [1.0, 0.0]]
    way = builders.through([1.0, 1.2, 2.0, 3.0], states)
    for time in (1.2, 2.0, 3.0):
        np.testing.assert_allclose(way.sample(time - 1e-9), way.sample(time), atol=1e-3)
    assert np.all(way.sample(4.0) == [[1.0, 0.0], *np.zeros((4, 2))])


def test_a_stroke_of_constant_velocity_covers_its_travel():
    """0.8 rad at 0.5 rad/s for the faster joint, half a second to each rest."""
    trajectory = MOTIONS['constant velocity']
    cruise = trajectory.sample(np.linspace(0.5, 0.5 + 1.6, 11))
    np.testing.assert_allclose(cruise[:, 1], np.broadcast_to([0.5, -0.25], (11, 2)), atol=1e-12)
    np.testing.assert_allclose(cruise[-1, 0] - cruise[0, 0], [0.8, -0.4], atol=1e-12)
    assert trajectory.end == pytest.approx(2.6)
    np.testing.assert_allclose(trajectory.sample(2.6)[1:], 0.0, atol=1e-9)


def test_sliding_never_reverses():
    trajectory = MOTIONS['sliding']
    rates = trajectory.sample(np.linspace(0.0, trajectory.end, 2000))[:, 1]
    assert np.all(rates[:, 0] > -1e-9)
    assert np.all(rates[:, 1] < 1e-9)
    assert trajectory.end == pytest.approx(5.0)
    body = trajectory.sample(1.0 + np.linspace(0.0, 3.0, 50))[:, 1]
    exact = 0.5 * (1 + 0.6 * np.sin(2 * np.pi * np.linspace(0.0, 3.0, 50) / 1.3))
    np.testing.assert_allclose(body, exact[:, None] * [1.0, -0.5], atol=1e-9)


@pytest.mark.parametrize('seed', range(3))
def test_an_approach_leaves_any_state_and_enters_smoothly(seed):
    """All five rows are those of the state now and of the beginning 1.5 s later."""
    state = 2.0 * np.random.default_rng(seed).standard_normal((5, 2))
    goal = builders.sinusoid([1.0, 0.5], 3.0, phase=0.7)
    trajectory = builders.approach(state, goal, 10.0, duration=1.5)
    np.testing.assert_allclose(trajectory.sample(10.0), state, atol=1e-12)
    np.testing.assert_allclose(trajectory.sample(11.5), goal.sample(0.0), atol=1e-9)
    np.testing.assert_allclose(trajectory.sample(14.0), goal.sample(2.5), atol=1e-12)
    changed = builders.approach(trajectory.sample(14.0), builders.hold([0.0, 0.0]), 14.0)
    np.testing.assert_allclose(changed.sample(14.0), trajectory.sample(14.0), atol=1e-12)
    np.testing.assert_allclose(changed.sample(16.0), 0.0, atol=1e-9)
    assert changed.end == pytest.approx(16.0)


def test_no_time_is_lost_where_the_robot_is_already():
    moved = builders.approach(builders.at_rest([0.0, 0.0]), builders.polynomial([1, 1], 2.0, 0.5),
                              7.0)
    assert moved.end == pytest.approx(7.0 + 5.5)
    effort = builders.approach(np.ones((5, 1)), builders.torque_levels([[0.1]], 0.1), 7.0)
    np.testing.assert_allclose(effort.sample(7.5)[0], [0.05])


@pytest.mark.parametrize(('build', 'sentence'), [
    (lambda: builders.through([0.0, 0.0], np.zeros((2, 5, 1))), 'must rise from point to point'),
    (lambda: builders.via_points([[0.0], [1.0]], 0.0, 1.0), 'move_time must be above 0, got 0.0'),
    (lambda: builders.via_points([[0.0], [1.0]], 1.0, -1.0),
     'hold_time must be at least 0, got -1.0'),
    (lambda: builders.sinusoid([1.0], -6.0), 'period must be above 0, got -6.0'),
    (lambda: builders.sinusoid([1.0], np.nan), 'period must be above 0, got nan'),
    (lambda: builders.sinusoid([1.0], 6.0, ramp_time=0.0), 'ramp_time must be above 0, got 0.0'),
    (lambda: builders.sliding([0.1], 1.0, 1.0, 1.0), 'below 1, got 1.0: the motion would reverse'),
    (lambda: builders.torque_levels([[0.1]], 0.0), 'rate must be above 0, got 0.0'),
    (lambda: builders.approach(np.ones((5, 1)), builders.hold([0.0]), 0.0, duration=-1.0),
     'duration must be above 0, got -1.0'),
    (lambda: builders.hold([np.nan]), 'poly of a trajectory must be finite with shape'),
    (lambda: builders.velocity_levels([[0.1]], [1.0, 2.0]), 'need as many durations, got 2'),
    (lambda: builders.velocity_levels([[0.1]], [0.0]), 'durations and settle_time must be'),
    (lambda: builders.velocity_levels([[0.1]], [1.0], settle_time=0.0),
     'durations and settle_time must be'),
    (lambda: Trajectory(**vars(MOTIONS['hold']) | {'scale': [0.0]}),
     'segments must follow each other'),
    (lambda: Trajectory(**vars(MOTIONS['via points']) | {'start': [0, 2, 1, 3, 4]}),
     'segments must follow each other'),
])
def test_what_cannot_be_built_is_refused_with_the_value(build, sentence):
    with pytest.raises(TrajectoryError, match=sentence):
        build()


def wandering(seed):
    """Return a motion from 0 through nine random points, back to rest at 0."""
    states = np.full((11, 5, 2), np.nan)
    states[:, 0] = np.random.default_rng(seed).standard_normal((11, 2))
    states[[0, -1]] = 0.0
    return builders.through(np.linspace(0.0, 20.0, 11), states)


@pytest.mark.parametrize('motion', [*map(wandering, range(4)), MOTIONS['sinusoid']])
@pytest.mark.parametrize('joint', [0, 1])
def test_a_limit_just_inside_the_extreme_of_a_motion_refuses_it_and_just_outside_not(
        motion, joint):
    """The extremes are those of 200,001 samples; the check itself samples next to nothing."""
    rows = motion.sample(np.linspace(0.0, 20.0, 200001))[:, :2]
    extremes = {'upper': rows[:, 0].max(axis=0), 'lower': rows[:, 0].min(axis=0),
                'velocity': np.abs(rows[:, 1]).max(axis=0)}

    def require(key=None):
        limits = {name: value * 1.001 for name, value in extremes.items()}
        if key is not None:
            limits[key][joint] *= 0.998
        require_within(motion, ['a', 'b'], Frames(
            rotation=np.zeros((2, 3, 3)), position=np.zeros((2, 3)), prismatic=[False] * 2,
            effort=np.ones(2), **limits), np.zeros(2))

    require()
    for key in extremes:
        with pytest.raises(TrajectoryError, match=f"{'ab'[joint]} .* beyond its limit"):
            require(key)


def test_velocities_are_held_in_turn_between_two_rests():
    trajectory = MOTIONS['velocities in turn']
    assert trajectory.end == pytest.approx(4.5)
    at = trajectory.sample(np.array([0.0, 0.5, 1.5, 2.5, 3.0, 4.0, 4.5, 9.0]))
    assert at[:, 1] == pytest.approx(np.array(
        [[0, 0], [0.3, 0], [0.3, 0], [0.3, 0], [-0.1, 0.2], [-0.1, 0.2], [0, 0], [0, 0]]))
    # a change of velocity covers the mean of both
    assert at[-1, 0] == pytest.approx([0.075 + 0.6 + 0.05 - 0.1 - 0.025, 0.05 + 0.2 + 0.05])


def test_torques_reach_their_levels_at_the_mean_rate_and_stop_there():
    trajectory = MOTIONS['torques']
    assert trajectory.quantity == 'effort' and trajectory.end == pytest.approx(2.0 + 3.0 + 1.0)
    at = trajectory.sample(np.array([0.0, 2.0, 5.0, 6.0, 9.0]))
    assert at[:, 0, 0] == pytest.approx([0.0, 0.2, -0.1, 0.0, 0.0], abs=1e-12)
    assert np.abs(at[:, 1:3]).max() < 1e-9


def test_parameters_move_motions_and_hold_torques_against_gravity():
    values = {key.name: key.default for key in trajectory_keys(('a', 'b'))}
    for kind in ('velocity_levels', 'sliding'):
        motion = values | {'trajectory.type': kind, 'trajectory.b.velocities': (0.2,)}
        here = trajectory_from_values(motion, ('a', 'b')).sample(np.array([0.0, 2.0]))
        there = trajectory_from_values(motion | {'trajectory.b.offset': -0.7}, ('a', 'b')).sample(
            np.array([0.0, 2.0]))
        assert there[:, 0] - here[:, 0] == pytest.approx(np.array([[0.0, -0.7]] * 2))
        assert np.array_equal(here[:, 1:], there[:, 1:])
    torque = trajectory_from_values(
        values | {'trajectory.type': 'torque_levels', 'trajectory.a.levels': (0.1,),
                  'trajectory.b.bias': 2.0}, ('a', 'b'))
    assert torque.sample(0.0)[0] == pytest.approx([0.0, 2.0])
    with pytest.raises(ConfigError, match='same number of levels'):
        trajectory_from_values(values | {'trajectory.type': 'torque_levels',
                                         'trajectory.a.levels': (0.1, 0.2)}, ('a', 'b'))
