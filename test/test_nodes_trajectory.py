# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The trajectory node's services: smooth from wherever the robot is, whatever changes."""

from bench.faults import broken_node
from node_harness import joint_state, Lab, MOTION, stamp_of, Trigger
import numpy as np
import pytest
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

PERIOD = 2_000_000  # [ns]
SECOND = 500        # samples in it
START = (0.4, -0.2)
# fifth derivative of a move of 1 rad in 1 s by the polynomial of degree 9, and half as much again
FIFTH = 1.5 * 15120.0


class Stepper(Lab):
    """A trajectory node in lockstep; the robot is taken to follow it exactly."""

    def begin(self, name, **parameters):
        """Start the node and find its topics."""
        self.started = self.start(name, files=MOTION, mode='lockstep', **parameters)
        self.states = self.say('states')
        self.messages = self.hear('references')
        self.until(lambda: self.states.get_subscription_count())
        self.stamp, self.rows = -PERIOD, {}
        return self

    def trigger(self, service):
        """Call one of the services."""
        return self.call(Trigger, f'/trajectory/{service}')

    def steps(self, count, position=None):
        """Publish states one by one; return the references for them, shape (count, 5, 2)."""
        rows = []
        for _ in range(count):
            self.stamp += PERIOD
            known = self.rows.get(self.stamp)
            angles = position if position is not None else known[0]
            self.states.publish(joint_state(self.stamp, [*angles, *angles]))
            self.until(lambda: self.take() and self.stamp + PERIOD in self.rows
                       or self.stamp == 0 and 0 in self.rows)
            rows.append(self.rows[self.stamp])
        return np.array(rows)

    def take(self):
        """Sort what has come by its stamp."""
        for message in self.messages:
            self.rows[stamp_of(message)] = np.reshape(message.data, (-1, 2))
        self.messages.clear()
        return True


@pytest.fixture(scope='module')
def moving(tmp_path_factory):
    """Run a trajectory node whose robot rests at START."""
    with Stepper(tmp_path_factory.mktemp('trajectory')) as lab:
        yield lab.begin('trajectory_node', trajectory__approach_time=1)
        assert lab.started.runs


def assert_smooth(rows):
    """
    Every row is the integral of the next one, and the last one is without jumps.

    With L the bound of the derivative after that, the trapezoidal rule is off by no more than
    dt^2 L / 4 in a sample, and a jump shows as more.
    """
    dt = PERIOD / 1e9
    bounds = [*np.max(np.abs(rows), axis=(0, 2)), FIFTH]
    for k in range(4):
        off = np.diff(rows[:, k], axis=0) - 0.5 * dt * (rows[1:, k + 1] + rows[:-1, k + 1])
        assert np.max(np.abs(off)) < 1.2 * 0.25 * dt ** 2 * bounds[k + 2] + 1e-12, k
    assert np.max(np.abs(np.diff(rows[:, 4], axis=0))) < dt * FIFTH


def test_services_before_the_first_joint_state_say_so(moving):
    for service in ('start', 'stop', 'reset'):
        response = moving.trigger(service)
        assert not response.success and response.message == 'no joint state has come yet'


def test_it_holds_the_robot_where_it_is_until_it_is_to_start(moving):
    rows = moving.steps(5, START)
    assert np.all(rows[:, 0] == START) and np.all(rows[:, 1:] == 0.0)


def test_start_change_and_stop_are_smooth(moving):
    """One unbroken record over a start, new amplitudes, other types and a stop."""
    rows = [moving.steps(20)]
    response = moving.trigger('start')
    assert response.success and response.message == 'sinusoid begins'
    rows.append(moving.steps(2 * SECOND))
    assert np.ptp(rows[-1][:, 0, 0]) > 0.3
    assert moving.set_parameters('/trajectory', trajectory__joint1__amplitude=0.3).successful
    rows.append(moving.steps(SECOND // 2))  # in the middle of the way
    assert moving.set_parameters('/trajectory', trajectory__type='polynomial',
                                 trajectory__move_time=1, trajectory__hold_time=0.1,
                                 together=True).successful
    rows.append(moving.steps(3 * SECOND // 2))
    assert moving.set_parameters('/trajectory', trajectory__type='sinusoid').successful
    rows.append(moving.steps(5 * SECOND // 2))
    assert np.max(np.abs(rows[-1][-1, 1])) > 0.05
    response = moving.trigger('stop')
    assert response.success and response.message == 'comes to rest'
    rows.append(moving.steps(SECOND + 20))
    assert np.all(rows[-1][-5:, 1:] == 0.0) and np.ptp(rows[-1][-5:, 0], axis=0).max() == 0.0
    assert_smooth(np.concatenate(rows))


def point(time, positions, **more):
    """Return a point of a JointTrajectory at a time [s]."""
    found = JointTrajectoryPoint(positions=positions, **more)
    found.time_from_start.sec = int(time)
    found.time_from_start.nanosec = round(1e9 * (time - int(time)))
    return found


def test_a_joint_trajectory_is_followed_smoothly_through_its_points(moving):
    """Names in any order; from where the reference is, to rest at the last point."""
    moving.points = moving.speak(JointTrajectory, '/trajectory/joint_trajectory')
    moving.until(moving.points.get_subscription_count)
    begin = moving.steps(20)
    where = begin[-1, 0]
    moving.points.publish(JointTrajectory(joint_names=['joint2', 'joint1'], points=[
        point(0.0, list(where[::-1])), point(1.0, [0.1, 0.2]),
        point(1.5, [0.2, 0.3], velocities=[0.1, 0.1]), point(3.0, [0.0, -0.1])]))
    moving.until(lambda: 'follows 3 points' in moving.started.printed())
    rows = np.concatenate([begin, moving.steps(3 * SECOND + 20)])
    assert_smooth(rows)
    first = int(np.flatnonzero(np.any(rows[:, 1] != 0.0, axis=1))[0]) - 1  # still at rest
    for time, there in ((1.0, (0.2, 0.1)), (1.5, (0.3, 0.2)), (3.0, (-0.1, 0.0))):
        np.testing.assert_allclose(rows[first + round(SECOND * time), 0], there, atol=1e-9)
    np.testing.assert_allclose(rows[first + round(SECOND * 1.5), 1], 0.1, atol=1e-9)
    assert np.all(rows[-1, 0] == [-0.1, 0.0]) and np.all(rows[-1, 1:] == 0.0)


def test_reset_rests_where_the_robot_is(moving):
    assert moving.set_parameters('/trajectory', trajectory__type='sinusoid').successful
    assert moving.trigger('start').success
    moving.steps(SECOND // 2)
    moving.steps(1, (0.1, 0.2))  # pushed away
    response = moving.trigger('reset')
    assert response.success and 'comes to rest' in response.message
    moving.steps(1, (0.1, 0.2))
    rows = moving.steps(5)
    assert np.all(rows[:, 0] == [0.1, 0.2]) and np.all(rows[:, 1:] == 0.0)


def test_a_fault_ends_by_reset_where_the_robot_is_by_then(tmp_path):
    """The arm has sagged, or was moved by hand; the first state it ever gets is the fault."""
    broken = broken_node.command(
        'trajectory_node', 'gms_flex_control.nodes.trajectory_node:TrajectoryNode._publish', 0)
    with Stepper(tmp_path) as lab:
        lab.tracebacks = 1
        lab.begin('trajectory_node', command=broken)

        def state(position):
            lab.stamp += PERIOD
            lab.states.publish(joint_state(lab.stamp, [*position, *position]))
        state(START)
        lab.until(lambda: broken_node.SENTENCE in lab.started.printed())
        for act in (lambda: None, lambda: lab.trigger('reset')):
            act()
            lab.messages.clear()
            state((0.3, 0.1))
            lab.until(lambda: lab.messages)
        rows = lab.steps(5, (0.3, 0.1))
        assert np.all(rows[:, 0] == [0.3, 0.1]) and np.all(rows[:, 1:] == 0.0)


def test_a_changed_type_does_not_start_a_robot_at_rest(moving):
    assert moving.set_parameters('/trajectory', trajectory__type='polynomial').successful
    rows = moving.steps(20)
    assert np.all(rows[:, 1:] == 0.0)
    assert np.all(rows[:, 0] == rows[0, 0])


def test_a_torque_is_sent_as_effort_and_stop_ends_it(moving):
    assert moving.set_parameters('/trajectory', trajectory__type='torque_levels',
                                 trajectory__rate=1.0, trajectory__joint1__levels=[1.0],
                                 trajectory__joint2__levels=[1.0], together=True).successful
    assert moving.trigger('start').success
    place = (0.1, 0.2)
    moving.steps(1, place)
    rows = moving.steps(20, place)
    assert rows.shape == (20, 1, 2) and np.all(np.diff(rows[:, 0, 0]) > 0)
    assert moving.trigger('stop').success
    moving.steps(1, place)
    rows = moving.steps(5, place)
    assert rows.shape == (5, 5, 2) and np.all(rows[:, 0] == place)


def test_a_torque_ends_where_the_joint_has_moved_far_enough(moving):
    assert moving.set_parameters('/trajectory', trajectory__type='torque_levels',
                                 trajectory__joint1__levels=[1.0],
                                 trajectory__joint2__levels=[0.0], trajectory__rate=1.0,
                                 trajectory__joint1__travel=0.05, together=True).successful
    moving.steps(1, (0.1, 0.2))
    assert moving.trigger('reset').success
    moving.steps(SECOND + 20, (0.1, 0.2))
    assert moving.trigger('start').success
    moving.steps(1, (0.1, 0.2))
    assert moving.steps(20, (0.14, 0.4)).shape == (20, 1, 2)
    moving.steps(1, (0.051, 0.4))
    assert moving.steps(1, (0.049, 0.4)).shape == (1, 1, 2)  # sent a sample ahead
    rows = moving.steps(20, (0.049, 0.4))
    assert rows.shape == (20, 5, 2) and np.all(rows[:, 0] == (0.049, 0.4))
    assert moving.set_parameters('/trajectory', trajectory__joint1__travel=0).successful


def test_release_asks_for_zero_torque_at_once_and_until_another_request(moving):
    assert moving.set_parameters('/trajectory', trajectory__type='sinusoid').successful
    assert moving.trigger('start').success
    moving.steps(SECOND // 4)
    response = moving.trigger('release')
    assert response.success and response.message == 'zero torque'
    moving.steps(1)  # its reference was sent a sample ahead
    rows = moving.steps(50)
    assert rows.shape == (50, 1, 2) and not rows.any()
    moving.steps(1, (0.1, 0.2))
    assert moving.trigger('reset').success
    moving.steps(1, (0.1, 0.2))
    assert moving.steps(5, (0.1, 0.2)).shape == (5, 5, 2)


def test_stamps_set_back_begin_anew_at_rest(moving):
    """As when the simulated robot is started again; what ran does not go on by itself."""
    assert moving.set_parameters('/trajectory', trajectory__type='sinusoid').successful
    assert moving.trigger('start').success
    moving.steps(1, (0.1, 0.2))
    moving.steps(10, (0.1, 0.2))
    moving.stamp, moving.rows = -PERIOD, {}
    moving.messages.clear()
    rows = moving.steps(5, (-0.3, 0.3))
    assert np.all(rows[:, 0] == (-0.3, 0.3)) and np.all(rows[:, 1:] == 0.0)
    assert moving.set_parameters('/trajectory', trajectory__joint1__amplitude=0.5).successful
    assert np.all(moving.steps(20)[:, 1:] == 0.0)
