# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Too many messages, endpoints that do not fit each other, and the emergency stop through both."""

from itertools import cycle, islice
import sys
import time

from bench.faults import storm
from bench.faults.lost_nodes import torque_of
from bench.faults.node_bench import COMMANDS, STATES
from bench.faults.rigs import CONTROLLER, Diagnostics, largest_torque, Log, Loop
import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger

_STORM = 2.0     # how long one lasts [s]
_LIMIT = 2.0     # of the torque [N m]
_STOPPED = 0.3   # watched after an emergency stop [s]
_AGAIN = 0.01    # between two presses of the button [s]


def try_storms(bench, tries, tally):
    """Publish one kind of message as fast as a process can, topic after topic."""
    for topic in islice(cycle(storm.KINDS), tries):
        tally.tries += 1
        with bench.another() as other:
            _try_storm(other, topic, tally)


def _try_storm(bench, topic, tally):
    loop = Loop(bench, deaf_to=topic)
    answers = bench.listen(JointState, f'{CONTROLLER}/state', Log())
    process = _begin(bench, topic)
    begin = loop.run(_STORM)
    times = [when for when, _ in answers.since(begin)]
    process.wait()
    p99 = float(np.percentile(np.diff(times), 99)) * 1e3 if len(times) > 20 else np.inf
    tally.figure(p99)
    tally.notes.append(f'{topic}: {process.printed().split()[1]} messages a second, {p99:.3g} ms')
    torques = [torque_of(state).max() for _, state in loop.states.since(begin)]
    torques.append(largest_torque(loop.commands.since(begin)))
    tally.expect(max(torques) <= 1.001 * _LIMIT, f'{topic}: torque {max(torques):.3g} N m')
    bench.until(loop.moves)
    for node in (loop.controller, loop.trajectory, loop.plant):
        tally.expect(node.runs and 'Traceback' not in node.printed(),
                     f'{node.log.stem} had an exception')


def _begin(bench, topic, duration=_STORM + 0.2):
    process = bench.run([sys.executable, '-m', storm.__name__, topic, str(duration)],
                        f'storm{topic.replace("/", "_")}')
    bench.until(lambda: 'begins' in process.printed())
    return process


def try_emergency_stop(bench, tries, tally):
    """Stop by topic and by service, without and during a storm; it has to stay."""
    loop = Loop(bench, deaf_to=COMMANDS)
    button = bench.speak(Bool, '/emergency_stop')
    stop = bench.client(Trigger, '/plant/emergency_stop')
    bench.until(lambda: button.get_subscription_count() and stop.service_is_ready())
    for k in range(tries):
        tally.tries += 1
        process = _begin(bench, COMMANDS, 1.0) if k % 4 > 1 else None
        begin = time.monotonic()
        while time.monotonic() < begin + _STOPPED:  # as a button does: a storm may drown one
            if k % 2:
                stop.call_async(Trigger.Request())
            else:
                button.publish(Bool(data=True))
            loop.run(_AGAIN)
        moved = [when for when, state in loop.states.since(begin) if torque_of(state).any()]
        tally.figure((max(moved, default=begin) - begin) * 1e3)
        if k == 0:  # it outlives the controller
            loop.controller.kill()
            loop.start_controller('controller_node.new')
            bench.until(lambda: loop.controller.printed().count('INFO') > 0)
            loop.run(_STOPPED)
            tally.expect(not loop.moves(), 'a new controller moves the stopped arm')
        button.publish(Bool(data=False))
        loop.run(0.05)
        tally.expect(not loop.moves(), 'the released button alone gives torque')
        if process:
            process.wait()
        loop.release()
        loop.run(0.2)


def try_mismatch(bench, tries, tally):
    """Publish states too weakly for a controller in lockstep, and ask too much of its commands."""
    controller, diagnostics = bench.start('controller_node', mode='lockstep'), Diagnostics(bench)
    weak = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    much = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
    for k in range(tries):
        known = controller.printed().count('QoS mismatch')
        begin = time.monotonic()
        tally.tries += 1
        if k % 2:
            end = bench.node.create_subscription(Float64MultiArray, COMMANDS, print, much,
                                                 event_callbacks=quiet)
            topic, destroy = COMMANDS, bench.node.destroy_subscription
        else:
            end = bench.node.create_publisher(JointState, STATES, weak)
            topic, destroy = STATES, bench.node.destroy_publisher
        bench.until(lambda known=known: controller.printed().count('QoS mismatch') > known)
        if k:  # the first time the process had to start
            tally.figure(time.monotonic() - begin)
        said = controller.printed().splitlines()[-1]
        tally.expect(topic in said and '/probe' in said, f'a mismatch is reported as {said!r}')
        bench.until(lambda topic=topic: topic in diagnostics.sentence(CONTROLLER), 5.0)
        destroy(end)
        forgotten = time.monotonic() + 1.5
        bench.until(lambda forgotten=forgotten: time.monotonic() > forgotten)
    tally.expect(controller.runs, 'the controller has ended')
