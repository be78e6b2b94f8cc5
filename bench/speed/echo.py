# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The floor that DDS and Python set to a loop: joint states out, an array back, nothing computed.

``python -m bench.speed.echo pacer RATE DURATION FILE [SERVICE]`` publishes joint states
and writes the timing of the answers to FILE. ``... echo`` answers each of them; a bridge does so,
too, once SERVICE (std_srvs/Trigger) has enabled it.
"""

import sys
import time

from bench.speed.timed_node import LoopTiming
from gms_flex_control.nodes import process, scheduling
from gms_flex_control.nodes.messages import array, NANOSECONDS, set_stamp
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

STATES, EFFORTS = 'robot/joint_states', 'robot/effort_controller/commands'
_NAMES = ['joint1', 'joint2', 'joint1_motor', 'joint2_motor']
_SETTLE = 1.0   # between the first answer, or torque, and the measurement [s]
_ASKS = 0.5     # between two requests to enable [s]


class Echo(Node):
    """Answer each joint state with an array."""

    def __init__(self):
        super().__init__('echo')
        self._answer = Float64MultiArray(data=[0.0, 0.0])
        self._publisher = self.create_publisher(Float64MultiArray, EFFORTS,
                                                process.publisher_qos('realtime'))
        self.create_subscription(JointState, STATES, self._on_states,
                                 process.subscriber_qos('realtime'),
                                 event_callbacks=process.NO_EVENTS)

    def _on_states(self, message):
        self._answer.data = message.position[:2]
        self._publisher.publish(self._answer)

    def run(self, spinner):
        """Answer until a signal comes."""
        spinner.spin()

    def finish(self):
        """Leave nothing behind."""


class Pacer(Node):
    """
    Publish joint states of a robot at rest, and measure when each is answered.

    At a ``rate`` [Hz] for ``duration`` [s], into the file ``path``, see LoopTiming; ``service``
    enables torque, '' where everything is answered.
    """

    def __init__(self, rate, duration, path, service=''):
        super().__init__('pacer')
        self._period, self._duration = round(NANOSECONDS / rate), duration
        self._message = JointState(name=_NAMES)
        for field in ('position', 'velocity', 'effort'):
            setattr(self._message, field, array('d', [0.0] * len(_NAMES)))
        self._publisher = self.create_publisher(JointState, STATES,
                                                process.publisher_qos('realtime'))
        self._client = self.create_client(Trigger, service) if service else None
        self._timing, self._measures, self._count = LoopTiming(path, self._period), False, 0
        self._begins = None  # when the measurement begins [s]
        self._asks, self._asked = 0.0, None
        self.create_subscription(Float64MultiArray, EFFORTS, self._on_efforts,
                                 process.subscriber_qos('realtime'),
                                 event_callbacks=process.NO_EVENTS)

    def _on_efforts(self, _message):
        now = time.monotonic_ns()
        if self._begins is None and self._client is None:
            self._begins = time.monotonic() + _SETTLE
        if self._measures:
            self._timing.answered(self._count - 1, now)

    def _enable(self):
        """Ask for torque now and then until it flows."""
        now = time.monotonic()
        if self._asked is not None and self._asked.done():
            if self._asked.result().success:
                self._begins, self._client = now + _SETTLE, None
            self._asked = None
        elif now > self._asks and self._asked is None and self._client.service_is_ready():
            self._asks = now + _ASKS
            self._asked = self._client.call_async(Trigger.Request())

    def run(self, spinner):
        """Publish until the measurement is over or a signal comes."""
        scheduling.tighten_timers()
        samples = round(self._duration * NANOSECONDS / self._period)
        with process.BackgroundSpin(spinner):
            deadline = time.monotonic_ns()
            while spinner.goes_on() and self._count < samples:
                deadline += self._period
                time.sleep(max(deadline - time.monotonic_ns(), 0) / NANOSECONDS)
                if self._client is not None:
                    self._enable()
                if (not self._measures and self._begins is not None
                        and time.monotonic() > self._begins):
                    self._measures = True
                    # a logger looks for its caller for longer than a bridge waits for states
                    print('measures', flush=True)
                set_stamp(self._message.header.stamp, time.time_ns())
                if self._measures:
                    self._timing.published()
                    self._count += 1
                self._publisher.publish(self._message)

    def finish(self):
        """Write what was measured."""
        self._timing.save()


def main():
    """Run what the command line names; return its exit code."""
    kind, *words = sys.argv[1:]
    del sys.argv[1:]
    if kind == 'echo':
        return process.run_node(Echo)
    rate, duration, *rest = words
    return process.run_node(lambda: Pacer(float(rate), float(duration), *rest))


if __name__ == '__main__':
    sys.exit(main())
