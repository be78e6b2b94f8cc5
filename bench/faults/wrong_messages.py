# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Numbers, lengths, names and parameters that no robot and no controller sends."""

from itertools import chain, cycle, islice
import math
import random
import time

from bench.faults.node_bench import COMMANDS, REFERENCE
from bench.faults.rigs import (
    CONTROLLER,
    HeldRobot,
    largest_torque,
    Loop,
    PERIOD,
    PLANT,
    TRAJECTORY,
    zero_after,
)
from bench.faults.wire import array_message, as_parameter, joint_state, JOINTS, NAMES, stamp_of
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from std_msgs.msg import Float64MultiArray

BAD = (math.nan, math.inf, -math.inf, 1e308, -1e308)
LENGTHS = (0, 1, 3, 10**6)
LIMIT = 2.0     # of the controller in config/controller.yaml [N m]
_LASTING = 0.2  # [s]
_LATEST = 0.2   # that an answer reaches the bench, which others may hold up [s]
_BAD_VALUES = (math.nan, math.inf, -math.inf, -1.0, 1e300, 'x', '', True, [math.nan],
               [1.0] * 3, [], None, -7)
_PARAMETERS = {
    CONTROLLER: [*(f'gains.{joint}.{gain}' for joint in (*JOINTS, 'joint3') for gain in (
        'kd_link', 'lambda_motor', 'torque_limit', 'sign_slope', 'filter_bandwidth')),
        'compensation', 'mode', 'arm.joint1.mass', 'no.such'],
    TRAJECTORY: ['trajectory.type', 'trajectory.approach_time', 'trajectory.joint1.period',
                 'trajectory.repeats', 'mode', 'joints'],
    PLANT: ['rate', 'command_timeout', 'arm.joint1.mass', 'no.such']}
_SEED = 20
_WATCHED = ('gains.joint1.kd_link', 'gains.joint2.torque_limit', 'gains.joint1.sign_slope')


def wrong_states(stamp, good):
    """Yield (what, JointState) with one wrong number or length each, in all fields."""
    position, velocity = list(good.position), list(good.velocity)
    for bad in BAD:
        for k in range(len(position)):
            spoilt = [*position[:k], bad, *position[k + 1:]]
            yield f'position[{k}] {bad}', joint_state(stamp, spoilt, velocity=velocity)
            spoilt = [*velocity[:k], bad, *velocity[k + 1:]]
            yield f'velocity[{k}] {bad}', joint_state(stamp, position, velocity=spoilt)
    for n in LENGTHS:
        yield f'{n} positions', joint_state(stamp, [0.1] * n, velocity=velocity)
        yield f'{n} velocities', joint_state(stamp, position, velocity=[0.1] * n)
        names = [f'joint{k}' for k in range(n)]
        yield f'{n} names', joint_state(stamp, [0.1] * n, names=names)


def wrong_references(stamp):
    """Yield (what, reference) with one wrong number or length each."""
    for bad in BAD:
        for k in range(10):
            yield f'data[{k}] {bad}', array_message(
                [0.1 if j != k else bad for j in range(10)], f'stamp:{stamp}')
    for n in LENGTHS:
        yield f'{n} numbers', array_message([0.1] * n, f'stamp:{stamp}')


def wrong_commands(stamp):
    """Yield (what, command) with one wrong number or length each."""
    for bad in BAD:
        for k in range(2):
            yield f'data[{k}] {bad}', array_message(
                [0.1 if j != k else bad for j in range(2)], f'stamp:{stamp}')
    for n in LENGTHS:
        yield f'{n} torques', array_message([0.1] * n, f'stamp:{stamp}')


def try_numbers(bench, tries, tally):
    """Send wrong states, then wrong references, among right ones; then wrong states alone."""
    robot = HeldRobot(bench)
    references = bench.speak(Float64MultiArray, REFERENCE)
    robot.settle()
    before = robot.diagnostics.figure(CONTROLLER, 'states refused')
    begin, sent = time.monotonic(), 0
    states = list(wrong_states(0, robot.message()))
    for what, message in islice(cycle(_spread(states)), tries):
        robot.step()
        stamp = robot.stamp + robot.shift + PERIOD // 2
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        robot.states.publish(message)
        sent, tally.tries = sent + 1, tally.tries + 1
        _digest(robot, message)
        answered = any(stamp_of(command) == stamp for command in robot.commands[-5:])
        tally.expect(not answered, f'a state with {what} was answered')
    refused = robot.until(
        lambda: robot.diagnostics.figure(CONTROLLER, 'states refused') - before >= 0.9 * sent)
    tally.expect(refused, f'of {sent} wrong states the controller counts '
                 f"{robot.diagnostics.figure(CONTROLLER, 'states refused') - before:.0f}")
    _try_references(robot, references, tries, tally)
    tally.figure(robot.largest(begin))
    _last(robot, tally)
    tally.expect(robot.controller.runs and robot.trajectory.runs, 'a node has ended')
    tally.expect('Traceback' not in robot.controller.printed(), 'the controller had an exception')


def _digest(robot, message):
    """Go on for a sample; after a message that takes a node long to read, until it is back."""
    robot.step()
    if max(len(message.position), len(message.velocity)) > 100:
        last = robot.stamp + robot.shift
        robot.until(lambda: (stamp_of(robot.commands[-1]) or 0) > last)


def _spread(cases):
    """Return the cases in an order in which the first few already are of all kinds."""
    return chain.from_iterable(cases[k::7] for k in range(7))


def _try_references(robot, publisher, tries, tally):
    robot.settle()
    for _, message in islice(cycle(_spread(list(wrong_references(robot.stamp)))), tries):
        message.layout.dim[0].label = f'stamp:{robot.stamp + robot.shift + PERIOD}'
        publisher.publish(message)
        tally.tries += 1
        robot.step()
        if len(message.data) > 100:
            robot.run(0.1)
    refused = robot.until(
        lambda: robot.diagnostics.figure(CONTROLLER, 'references refused') >= 0.9 * tries)
    tally.expect(refused, 'the controller does not count the wrong references')
    tally.expect(robot.until(robot.settle), 'the motion did not go on')


def _last(robot, tally):
    """Send nothing but NaN; zero torque has to come."""
    robot.quiet, begin = True, time.monotonic()
    while time.monotonic() < begin + _LASTING:
        robot.step()
        robot.states.publish(joint_state(robot.stamp, [math.nan] * 4))
    zero = zero_after(robot.commands, begin)
    tally.expect(zero is not None and not robot.largest(zero),
                 'lasting NaN did not end in zero torque')
    robot.quiet = False
    tally.expect(robot.settle(), 'the motion did not go on after lasting NaN')


def try_commands(bench, tries, tally):
    """Send wrong commands to the plant of a running loop."""
    loop = Loop(bench)
    publisher = bench.speak(Float64MultiArray, COMMANDS)
    bench.until(publisher.get_subscription_count)
    begin = time.monotonic()
    for _, message in islice(cycle(_spread(list(wrong_commands(0)))), tries):
        message.layout.dim[0].label = f'stamp:{stamp_of(loop.states[-1])}'
        publisher.publish(message)
        tally.tries += 1
        bench.more(loop.states, 1)
    applied = [abs(torque) for _, state in loop.states.since(begin) for torque in state.effort[2:]]
    tally.figure(max(applied) if all(map(math.isfinite, applied)) else math.inf)
    tally.expect(loop.plant.runs and 'command refused' in loop.plant.printed(),
                 'the plant said nothing of wrong commands')
    positions = [value for _, state in loop.states.since(begin) for value in state.position]
    tally.expect(all(map(math.isfinite, positions)), 'a position is not finite')


def try_names(bench, tries, tally):
    """Reorder, add, repeat, rename and leave out joint names."""
    robot = HeldRobot(bench)
    robot.settle()
    begin = time.monotonic()
    for k in range(tries):
        for names, accepted in _namings(k):
            robot.step()
            good = dict(zip(NAMES, zip(robot.message().position, robot.message().velocity,
                                       strict=True), strict=True))
            stamp = robot.stamp + robot.shift + PERIOD // 2
            pairs = [good.get(name, (math.nan, math.nan)) for name in names]
            robot.states.publish(joint_state(stamp, [q for q, _ in pairs], names=names,
                                             velocity=[dq for _, dq in pairs]))
            tally.tries += 1
            robot.step()
            sent = len(robot.commands) - 6

            def is_answered(stamp=stamp, sent=sent):
                return any(stamp_of(one) == stamp for one in robot.commands[sent:])
            answered = robot.until(is_answered, _LATEST) if accepted else is_answered()
            tally.expect(answered == accepted,
                         f"names {', '.join(names)} were {'refused' if accepted else 'taken'}")
    tally.figure(largest_torque(robot.commands.since(begin)))
    tally.expect(robot.controller.runs and robot.trajectory.runs, 'a node has ended')


def _namings(k):
    """Return (names, whether they are to be accepted)."""
    turned = [*NAMES[k % 4:], *NAMES[:k % 4]]
    return ((turned[::-1], True), ([*turned, 'gripper'], True), (['gripper', *turned], True),
            ([*turned, turned[0]], False), (turned[1:], False), (['joint9', *turned[1:]], False),
            ([], False))


def try_parameters(bench, tries, tally):
    """Set bad values, one, several or a group at once; read back that the old ones stay."""
    loop, rng = Loop(bench), random.Random(_SEED)
    before = _values(bench)
    begin = time.monotonic()
    for _ in range(tries):
        node = rng.choices((CONTROLLER, TRAJECTORY, PLANT), (6, 2, 1))[0]
        group = {rng.choice(_PARAMETERS[node]): rng.choice(_BAD_VALUES)
                 for _ in range(rng.randint(1, 4))}
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
