# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Illegal parameters, at random, while the arm moves."""

import math
import random
import time

from gms_flex_control.nodes.faults.rigs import CONTROLLER, Loop, PLANT, TRAJECTORY
from gms_flex_control.nodes.faults.wire import as_parameter, JOINTS, stamp_of
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically

_BAD = (math.nan, math.inf, -math.inf, -1.0, 1e300, 'x', '', True, [math.nan], [1.0] * 3, [],
        None, -7)
_NAMES = {
    CONTROLLER: [*(f'gains.{joint}.{gain}' for joint in (*JOINTS, 'joint3') for gain in (
        'kd_link', 'lambda_motor', 'torque_limit', 'sign_slope', 'filter_bandwidth')),
        'compensation', 'mode', 'arm.joint1.mass', 'no.such'],
    TRAJECTORY: ['trajectory.type', 'trajectory.approach_time', 'trajectory.joint1.period',
                 'trajectory.repeats', 'mode', 'joints'],
    PLANT: ['rate', 'command_timeout', 'arm.joint1.mass', 'no.such']}
_SEED = 20
_WATCHED = ('gains.joint1.kd_link', 'gains.joint2.torque_limit', 'gains.joint1.sign_slope')


def try_parameters(bench, tries, tally):
    """Set bad values, one, several or a group at once; read back that the old ones stay."""
    loop, rng = Loop(bench), random.Random(_SEED)
    before = _values(bench)
    begin = time.monotonic()
    for _ in range(tries):
        node = rng.choices((CONTROLLER, TRAJECTORY, PLANT), (6, 2, 1))[0]
        group = {rng.choice(_NAMES[node]): rng.choice(_BAD) for _ in range(rng.randint(1, 4))}
        tally.tries += 1
        for result in _set(bench, node, group, rng.random() < 0.5, tally):
            tally.expect(not result.successful, f'{node} took one of {group}')
            tally.expect(result.successful or result.reason, f'{node} gave no reason: {group}')
    tally.expect(_values(bench) == before, 'a value has changed')
    states = [stamp_of(state) for _, state in loop.states.since(begin)][:-5]
    answered = {stamp_of(command) for command in loop.commands.messages}
    missed = sum(stamp not in answered for stamp in states)
    # best effort in real time: a machine that is busy otherwise loses some without any of this
    tally.expect(missed <= 0.01 * len(states), f'{missed} of {len(states)} states unanswered')
    for process in (loop.controller, loop.trajectory, loop.plant):
        tally.expect(process.runs and 'Traceback' not in process.printed(),
                     f'{process.log.stem} had an exception')


def _set(bench, node, group, together, tally):
    """Return the results of one request, its time noted."""
    kind = SetParametersAtomically if together else SetParameters
    client = bench.client(kind, f'{node}/set_parameters' + '_atomically' * together)
    bench.until(client.service_is_ready)
    request = kind.Request(parameters=[as_parameter(*pair) for pair in group.items()])
    begin = time.monotonic()
    future = client.call_async(request)
    bench.until(future.done)
    tally.figure((time.monotonic() - begin) * 1e3)
    return [future.result().result] if together else future.result().results


def _values(bench):
    request = GetParameters.Request(names=list(_WATCHED))
    answer = bench.call(GetParameters, f'{CONTROLLER}/get_parameters', request)
    return [value.double_value for value in answer.values]
