# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Numbers, lengths and names that no robot and no controller sends."""

from itertools import chain, cycle, islice
import math
import time

from gms_flex_control.nodes.faults.bench import COMMANDS, REFERENCE
from gms_flex_control.nodes.faults.rigs import (
    CONTROLLER,
    HeldRobot,
    largest_torque,
    Loop,
    PERIOD,
    zero_after,
)
from gms_flex_control.nodes.faults.wire import array_message, joint_state, NAMES, stamp_of
from std_msgs.msg import Float64MultiArray

BAD = (math.nan, math.inf, -math.inf, 1e308, -1e308)
LENGTHS = (0, 1, 3, 10**6)
LIMIT = 2.0     # of the controller in config/controller.yaml [N m]
_LASTING = 0.2  # [s]
_LATEST = 0.2   # that an answer reaches the bench, which others may hold up [s]


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
