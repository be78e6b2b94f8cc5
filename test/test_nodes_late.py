# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A late loop says so, its stamps stay near the clock; who comes later finds it at once."""

import signal
import sys
import time
from types import SimpleNamespace

from gms_flex_control.nodes import pacing
from gms_flex_control.nodes.topics import Direct
from node_harness import array_message, DISCOVERY, MOTION, rclpy, stamp_of
import numpy as np
import pytest

Time = pytest.importorskip('rclpy.time').Time
DiagnosticArray = pytest.importorskip('diagnostic_msgs.msg').DiagnosticArray
PERIOD = 20_000_000  # [ns]


def test_a_plant_whose_controller_answers_every_second_state_warns(lab):
    """Less often than that, if the machine is busy."""
    commands = lab.say('commands')
    states = lab.hear('states')
    plant = lab.start('plant_node', rate=50.0, silence_timeout=0.3)
    answered = 0

    def warned():
        nonlocal answered
        if len(states) >= answered + 2:
            answered = len(states)
            stamp = states[-1].header.stamp
            commands.publish(array_message(
                [0.0, 0.0], 'joint', f'stamp:{stamp.sec * 10**9 + stamp.nanosec}'))
        return '% of the states of the last second had no fresh command' in plant.printed()

    lab.until(warned)


class JumpingArm:
    """An arm that is answered at once, and the clock of its node, which jumps ahead once."""

    period, active = PERIOD, False

    def __init__(self):
        self.ticks, self.deadlines = 0, []

    def begin(self, stamp):
        """Be in the first state."""
        self.stamp, self.command = stamp, (0.0, stamp, 0)

    def end_sample(self):
        """Be in the next state."""
        self.ticks += 1
        self.begin(self.stamp + self.period)

    def publish(self, deadline=None):
        """Note when the state leaves."""
        self.deadlines += [deadline] * (deadline is not None)

    def is_last(self):
        """Return whether the run is over."""
        return self.ticks == 6

    def now(self):
        """Return the time of the node."""
        return Time(nanoseconds=time.time_ns() + 10**9 * (self.ticks > 2))

    def simulate(self, _torque=None):
        """Do nothing."""

    watch = simulate


def test_a_state_is_due_a_period_after_the_last_one_where_the_clock_jumps_ahead(monkeypatch):
    """A jump is seen just before a deadline, which is not late then, nor early."""
    monkeypatch.setattr(pacing, '_READY', PERIOD // 2)  # for a busy machine
    arm, interval = JumpingArm(), sys.getswitchinterval()
    node = SimpleNamespace(get_clock=lambda: arm, direct=Direct(),
                           health=SimpleNamespace(warn=lambda *_: None))
    pace = pacing.Paced(arm, arm, node, {'command_timeout': 0.1})
    try:
        pace.run(SimpleNamespace(goes_on=lambda: True))
    finally:
        sys.setswitchinterval(interval)
    assert pace.left_out > 40
    assert min(np.diff(arm.deadlines)) >= PERIOD


def test_stamps_are_near_the_clock_again_after_a_stop(lab):
    """Whole periods are left out, and it is said how many; afterwards the pace is as before."""
    states = lab.hear('states')
    plant = lab.start('plant_node', rate=50.0)
    lab.until(lambda: len(states) > 5)
    plant.process.send_signal(signal.SIGSTOP)
    time.sleep(1.0)
    plant.process.send_signal(signal.SIGCONT)
    lab.until(lambda: 'ms late' in plant.printed())
    begin = len(states)
    lags = [time.time_ns() - stamp_of(state) for state in lab.more(states, 20)]
    assert min(lags) < 0.2e9
    stamps = [stamp_of(state) for state in lab.more(states, 50)]
    assert np.all(np.diff(stamps) > 0) and stamps[-1] < time.time_ns() + PERIOD
    assert not any((stamp_of(state) - stamp_of(states[0])) % PERIOD for state in states)
    left_out = (stamp_of(states[begin]) - stamp_of(states[0])) // PERIOD - begin
    assert left_out > 30 and ' samples are left out' in plant.printed()


def test_diagnostics_have_the_time_of_the_system_while_there_is_no_clock(lab):
    reports = lab.listen(DiagnosticArray, '/diagnostics')
    lab.start('trajectory_node', use_sim_time=True)
    lab.until(lambda: reports)
    assert abs(time.time() - reports[0].header.stamp.sec) < 3600.0


def test_a_process_that_comes_later_finds_the_nodes_at_once(lab, monkeypatch):
    """By default Fast DDS announces a node every 3 s: who misses an answer waits so long."""
    lab.environment[DISCOVERY] = 'SUBNET'
    monkeypatch.setenv(DISCOVERY, 'SUBNET')
    states = lab.hear('states')
    for name in ('controller_node', 'trajectory_node', 'plant_node'):
        lab.start(name, files=MOTION)
    lab.until(lambda: states)
    searched = [seconds_until_found({'cascade_controller', 'trajectory', 'plant'}, lab.domain)
                for _ in range(4)]
    assert max(searched) < 2.0, searched


def seconds_until_found(names, domain):
    """Return how long a new participant takes to see nodes (set of str)."""
    context, begun = rclpy.Context(), time.monotonic()
    rclpy.init(context=context, domain_id=domain,
               signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node = rclpy.create_node('late', context=context)
    try:
        while not names <= set(node.get_node_names()) and time.monotonic() < begun + 10.0:
            time.sleep(0.01)
        return time.monotonic() - begun
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
