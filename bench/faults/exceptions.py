# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Exceptions in callbacks: one traceback, zero torque, a fault that is reported, life after it."""

import time

from bench.faults import broken_node
from bench.faults.rigs import CONTROLLER, HeldRobot, largest_torque, TRAJECTORY
from bench.faults.wire import as_parameter
from rcl_interfaces.srv import GetParameters, SetParameters
from std_srvs.srv import Trigger

_NODES = 'gms_flex_control.nodes'
_CONTROLLER, _TRAJECTORY = f'{_NODES}.controller_node', f'{_NODES}.trajectory_node'
_ERROR = 2      # level on /diagnostics
_CALLS = 300    # good ones before the bad one
_LISTEN = 0.3   # to the commands after the fault [s]


def _set(name, value):
    def call(robot, node):
        request = SetParameters.Request(parameters=[as_parameter(name, value)])
        client = robot.bench.client(SetParameters, f'{node}/set_parameters')
        robot.until(client.service_is_ready)
        client.call_async(request)
    return call


def _trigger(service):
    def call(robot, node):
        client = robot.bench.client(Trigger, f'{node}/{service}')
        robot.until(client.service_is_ready)
        client.call_async(Trigger.Request())
    return call


# where the exception comes, after how many calls, and what makes the call if not the loop does
PLACES = (
    (CONTROLLER, 'controller_node', f'{_NODES}.messages:JointStateReader.read', _CALLS, None),
    (CONTROLLER, 'controller_node', f'{_NODES}.messages:read_reference', _CALLS, None),
    (CONTROLLER, 'controller_node', 'gms_flex_control.control.cascade:SteppedController.tick',
     _CALLS, None),
    (CONTROLLER, 'controller_node', f'{_CONTROLLER}:ControllerNode._watch', _CALLS, None),
    (CONTROLLER, 'controller_node', f'{_CONTROLLER}:ControllerNode._use', 0,
     _set('gains__joint1__kd_link', 0.7)),
    (CONTROLLER, 'controller_node', f'{_NODES}.parameters:NodeParameters._as_double', 0,
     _set('gains__joint1__kd_link', 0.7)),
    (CONTROLLER, 'controller_node', f'{_NODES}.health:mismatches', 1, None),
    (TRAJECTORY, 'trajectory_node', f'{_NODES}.reference_motion:LinkStates.read', _CALLS, None),
    (TRAJECTORY, 'trajectory_node', f'{_TRAJECTORY}:TrajectoryNode._publish', _CALLS, None),
    (TRAJECTORY, 'trajectory_node', f'{_TRAJECTORY}:TrajectoryNode._choose', 0,
     _set('trajectory__joint1__amplitude', 0.2)),
    (TRAJECTORY, 'trajectory_node', f'{_TRAJECTORY}:TrajectoryNode._answer', 0, _trigger('stop')))


def try_place(bench, place, tally):
    """Try one of PLACES."""
    node, executable, where, calls, cause = place
    broken = broken_node.command(executable, where, calls)
    robot = HeldRobot(bench, **{executable.removesuffix('_node'): broken})
    process = robot.controller if node == CONTROLLER else robot.trajectory
    tally.tries += 1
    if cause is not None:
        robot.settle()
        cause(robot, node)
    reported = robot.until(lambda: 'FAULT' in robot.diagnostics.sentence(node))
    tally.expect(reported and robot.diagnostics.level(node) == _ERROR,
                 f'{where}: no FAULT on /diagnostics')
    zero = robot.until(lambda: robot.commands and not any(robot.commands[-1].data))
    tally.expect(zero, f'{where}: no zero torque')
    tally.figure(largest_torque(robot.commands.since(robot.run(_LISTEN))))
    tally.expect(_answers(robot, node), f'{where}: the executor is dead')
    printed = process.printed()
    tally.expect(printed.count('Traceback (most recent call last)') == 1
                 and broken_node.SENTENCE in printed,
                 f"{where}: {printed.count('Traceback')} tracebacks")
    _trigger('reset')(robot, node)
    tally.expect(robot.until(lambda: 'FAULT' not in robot.diagnostics.sentence(node)),
                 f'{where}: the fault outlives its reset')
    if node == CONTROLLER:
        tally.expect(robot.settle(), f'{where}: no motion after the reset')
    tally.expect(process.runs, f'{where}: the node has ended')


def _answers(robot, node):
    client = robot.bench.client(GetParameters, f'{node}/get_parameters')
    robot.until(client.service_is_ready)
    future = client.call_async(GetParameters.Request(names=['mode']))
    began = time.monotonic()
    return robot.until(future.done, 5.0) and time.monotonic() - began < 5.0


def try_exceptions(bench, tries, tally):
    """Try so many of PLACES, the first of each node first."""
    order = sorted(range(len(PLACES)), key=lambda k: k % 7)
    for k in order[:tries]:
        with bench.another() as other:
            try_place(other, PLACES[k], tally)
