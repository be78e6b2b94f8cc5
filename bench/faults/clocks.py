# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Stamps that jump, stand still or come from several clocks."""

from itertools import cycle, islice
import time

from bench.faults.rigs import CONTROLLER, HeldRobot
from gms_flex_control.nodes.messages import NANOSECONDS
from rosgraph_msgs.msg import Clock

FAR = 1000 * NANOSECONDS
_PATIENCE = 4      # tries of what the machine held up
_AFTERWARDS = 0.4  # watched after each fault [s]
_BEGUN = 'observer begun anew'


def try_stamps(bench, tries, tally):
    """Let the clock of the states jump, err for one sample, and alternate with another one."""
    # without friction compensation the torque is smooth, so that a spike shows
    robot = HeldRobot(bench, parameters={'compensation': 'none',
                                         'use_sim_time': True})
    clock = bench.speak(Clock, '/clock')
    for name, fault in islice(cycle(_FAULTS.items()), tries):
        tally.expect(robot.settle(), f'no motion before: {name}')
        robot.run(_AFTERWARDS)
        resets = robot.diagnostics.figure(CONTROLLER, _BEGUN)
        tally.tries += 1
        expected = _try_one(robot, clock, fault, tally)
        tally.expect(robot.settle(), f'no motion after: {name}')
        if expected:
            tally.expect(robot.until(lambda resets=resets: robot.diagnostics.figure(
                CONTROLLER, _BEGUN) > resets, 3.0), f'the observer did not begin anew: {name}')
    said = robot.controller.printed()
    tally.expect('observer begins anew' in said, 'no warning of a jump')
    tally.expect('Traceback' not in said, 'the controller had an exception')
    tally.expect(robot.controller.runs and robot.trajectory.runs, 'a node has ended')


def _try_one(robot, clock, fault, tally):
    """Try one fault, again where the machine was too busy to decide; return what it expects."""
    for _ in range(_PATIENCE):
        begin = time.monotonic()
        expected = fault(robot, clock)
        robot.run(_AFTERWARDS)
        if not robot.stalled(begin):
            tally.figure(robot.largest(begin))
            return expected
        robot.settle()
    tally.notes.append('the machine was too busy to measure one of the torques')
    return expected


def _jump(amount):
    def jump(robot, _clock):
        robot.shift += amount
        return True
    return jump


def _outlier(amount):
    def err(robot, _clock):
        robot.shift += amount
        robot.step()
        robot.shift -= amount
        return True
    return err


def _mixed(robot, _clock):
    """Alternate between two clocks."""
    before = robot.shift
    for k in range(100):
        robot.shift = before + (FAR if k % 2 else 0)
        robot.step()
    robot.shift = before
    return True


def _late(robot, _clock):
    """Repeat a state of 20 ms ago, as if it had been overtaken."""
    for _ in range(20):
        robot.shift -= 20_000_000
        robot.states.publish(robot.message())
        robot.shift += 20_000_000
        robot.step()
    return False


def _stopped(robot, clock):
    """Let /clock run for a while, stand still, and jump; nobody here goes by it."""
    for k in range(60):
        message = Clock()
        message.clock.sec = (1, 500, 2)[min(k // 20, 2)]
        if k % 20 < 5:
            clock.publish(message)
        robot.step()
    return False


_FAULTS = {
    'stamps jump by +1000 s': _jump(FAR), 'stamps jump by -1000 s': _jump(-FAR),
    'one stamp 1000 s in the future': _outlier(FAR),
    'one stamp 1000 s in the past': _outlier(-FAR), 'two clocks in turn': _mixed,
    'a state comes late': _late, '/clock stops': _stopped}
