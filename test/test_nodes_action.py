# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""FollowJointTrajectory as MoveIt asks for it, where control_msgs is installed."""

import pytest

action = pytest.importorskip(
    'control_msgs.action', reason='control_msgs is not installed, there is no wheel of it: '
    'the action itself runs on a ROS installation only')
from action_msgs.msg import GoalStatus  # noqa: E402,I100  after the skip
from bridge_lab import ask, client_of, enable  # noqa: E402
from control_msgs.msg import JointTolerance  # noqa: E402
from node_harness import Lab, MOTION  # noqa: E402
import numpy as np  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from test_nodes_trajectory import point, SECOND, START, Stepper  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

KIND = action.FollowJointTrajectory
RESULT = KIND.Result
NAMES = ['joint1', 'joint2']


@pytest.fixture(scope='module')
def arm(tmp_path_factory):
    """Run a trajectory node whose robot rests at START, and a client of its action."""
    with Stepper(tmp_path_factory.mktemp('action')) as lab:
        lab.begin('trajectory_node', trajectory__approach_time=0.2)
        lab.actions = ActionClient(lab.node, KIND, '/trajectory/follow_joint_trajectory')
        lab.until(lab.actions.server_is_ready)
        lab.steps(5, START)
        yield lab
        assert lab.started.runs
        lab.actions.destroy()


def send(arm, *points, names=NAMES, path=0.0, at_end=0.0, allowance=0.0, stamp=0):
    """Send a goal; return its handle once the node knows it."""
    goal = KIND.Goal(trajectory=JointTrajectory(joint_names=names, points=points))
    goal.trajectory.header.stamp.nanosec = stamp
    goal.path_tolerance = [JointTolerance(name='joint1', position=path)]
    goal.goal_tolerance = [JointTolerance(name='joint1', position=at_end)]
    goal.goal_time_tolerance.nanosec = round(1e9 * allowance)
    arm.feedback = []
    future = arm.actions.send_goal_async(goal, lambda sent: arm.feedback.append(sent.feedback))
    arm.until(future.done)
    handle = future.result()
    assert handle.accepted
    handle.result = handle.get_result_async()
    return handle


def result(arm, handle):
    """Return status, code and sentence of a goal that is over."""
    arm.until(handle.result.done)
    found = handle.result.result()
    return found.status, found.result.error_code, found.result.error_string


def follows(arm, count):
    """Wait until the node follows its ``count``-th goal."""
    arm.until(lambda: arm.started.printed().count(' points of a joint trajectory') >= count)
    return count


def count(arm):
    return arm.started.printed().count(' points of a joint trajectory')


def test_a_goal_is_followed_reported_and_reached(arm):
    begun = count(arm)
    handle = send(arm, point(0.5, [0.5, -0.1]), path=0.1, at_end=0.01)
    follows(arm, begun + 1)
    rows = arm.steps(SECOND)
    assert result(arm, handle) == (GoalStatus.STATUS_SUCCEEDED, RESULT.SUCCESSFUL,
                                   'the last point is reached')
    np.testing.assert_allclose(rows[-1, 0], [0.5, -0.1], atol=1e-9)
    assert len(arm.feedback) >= 5 and list(arm.feedback[0].joint_names) == NAMES
    for sent in arm.feedback:
        assert list(sent.error.positions) == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_canceled_goal_comes_to_rest(arm):
    begun = count(arm)
    handle = send(arm, point(5.0, [0.0, 0.0]))
    follows(arm, begun + 1)
    arm.steps(SECOND // 4)
    cancel = handle.cancel_goal_async()
    arm.until(cancel.done)
    rows = arm.steps(SECOND)
    assert result(arm, handle)[0] == GoalStatus.STATUS_CANCELED
    assert np.all(rows[-1, 1:] == 0.0) and rows[-1, 0, 0] != 0.0


@pytest.mark.parametrize(('names', 'positions', 'code', 'sentence'), [
    (['joint1', 'elbow'], [0.1, 0.1], RESULT.INVALID_JOINTS, "lack 'joint2' (have joint1, elbow)"),
    (['joint1', 'joint1'], [0.1, 0.1], RESULT.INVALID_JOINTS, "name 'joint1' more than once"),
    (NAMES, [0.1, float('nan')], RESULT.INVALID_GOAL, 'hold nan'),
    (NAMES, [0.1], RESULT.INVALID_GOAL, 'are 1 for 2 joints')])
def test_a_goal_that_makes_no_sense_is_aborted_and_nothing_moves(
        arm, names, positions, code, sentence):
    handle = send(arm, point(1.0, positions), names=names)
    status, found, text = result(arm, handle)
    assert (status, found) == (GoalStatus.STATUS_ABORTED, code) and sentence in text
    rows = arm.steps(20)
    assert np.all(rows[:, 1:] == 0.0)


def test_a_new_goal_takes_the_place_of_the_old_one(arm):
    begun = count(arm)
    old = send(arm, point(5.0, [0.3, 0.3]))
    follows(arm, begun + 1)
    arm.steps(SECOND // 4)
    new = send(arm, point(0.5, [0.1, 0.2]))
    follows(arm, begun + 2)
    assert result(arm, old) == (GoalStatus.STATUS_ABORTED, RESULT.INVALID_GOAL,
                                'a new goal replaces it')
    rows = arm.steps(SECOND)
    assert result(arm, new)[0] == GoalStatus.STATUS_SUCCEEDED
    np.testing.assert_allclose(rows[-1, 0], [0.1, 0.2], atol=1e-9)


def test_a_service_that_begins_another_motion_ends_the_goal(arm):
    begun = count(arm)
    handle = send(arm, point(5.0, [0.3, 0.3]))
    follows(arm, begun + 1)
    arm.steps(SECOND // 4)
    assert arm.trigger('stop').success
    arm.steps(SECOND)
    assert result(arm, handle) == (GoalStatus.STATUS_ABORTED, RESULT.INVALID_GOAL,
                                   'another motion has begun')


@pytest.fixture(params=[('plant_node', 'controller_node', 'trajectory_node'), ('loop_node',)],
                ids=['three processes', 'one process'])
def robot(request, tmp_path):
    """Run the whole loop at rest, and a client of its action."""
    with Lab(tmp_path) as lab:
        lab.clients = {}
        nodes = [lab.start(name, files=MOTION, rate=200.0, silence_timeout=1.0)
                 for name in request.param]
        lab.started = nodes[-1]
        for name in ('disable', 'enable', 'emergency_stop', 'reset'):
            client_of(lab, f'/plant/{name}')
        lab.actions = ActionClient(lab.node, KIND, '/trajectory/follow_joint_trajectory')
        lab.until(lab.actions.server_is_ready)
        lab.until(lambda: 'ACTIVE' in nodes[0].printed())
        yield lab
        lab.actions.destroy()


def test_without_torque_goals_are_refused_and_the_one_that_is_followed_ends(robot):
    assert ask(robot, 'disable').success
    status, code, text = result(robot, send(robot, point(0.5, [0.1, 0.1])))
    assert (status, code) == (GoalStatus.STATUS_ABORTED, RESULT.INVALID_GOAL)
    assert text == 'no torque flows (ZERO: disabled): call /plant/enable first'
    enable(robot)
    reached = send(robot, point(0.5, [0.1, 0.1]), path=0.5, at_end=0.1)
    assert result(robot, reached)[:2] == (GoalStatus.STATUS_SUCCEEDED, RESULT.SUCCESSFUL)
    begun = count(robot)
    handle = send(robot, point(5.0, [0.3, 0.3]))
    follows(robot, begun + 1)
    assert ask(robot, 'emergency_stop').success
    assert result(robot, handle) == (
        GoalStatus.STATUS_ABORTED, RESULT.INVALID_GOAL,
        'no torque flows (FAULT: emergency stop by service): call /plant/reset and /plant/enable '
        'first')
