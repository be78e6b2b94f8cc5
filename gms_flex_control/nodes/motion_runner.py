# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A motion driven by the running trajectory node, and recorded."""

from collections.abc import Callable
from pathlib import Path
import time

from gms_flex_control.data.writer import BagWriter
from gms_flex_control.design.motions import APPROACH
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.experiment.driven import TOPICS
from gms_flex_control.nodes.messages import NANOSECONDS, to_nanoseconds
from gms_flex_control.nodes.process import hidden_node, NO_EVENTS
from gms_flex_control.nodes.recorder import Recorder
from gms_flex_control.nodes.remote import RemoteNode
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

_BOUND = 10.0    # for an answer [s]
_SILENCE = 5.0   # without a joint state: the robot has stopped talking [s]


class RunError(GmsFlexError):
    """A motion could not be driven; the sentence says why, and what to look at."""


def drive_motion(parameters: dict, duration: float, bag: str | Path, *, patience: float = 20.0,
                 say: Callable[[str], object] = lambda text: None) -> None:
    """
    Set the motion of the running node ``/trajectory``, start it, record it, bring it to rest.

    ``parameters`` are ``trajectory.*``; ``duration`` [s] is from its beginning by the stamps of
    the joint states, `APPROACH` is added; ``patience`` [s] is for nodes and topics to be there.
    RunError if the nodes are missing, refuse the motion, or fall silent, after ``~/stop`` has been
    called; BagError if the bag cannot be written.
    """
    with hidden_node('next') as (node, executor), BagWriter(bag) as writer:
        runner = _Runner(node, executor, Recorder(node, writer, list(TOPICS), say), patience)
        try:
            runner.run(parameters | {'trajectory.approach_time': APPROACH}, duration)
        finally:
            runner.close()


class _Runner:
    """Commands the trajectory node while a Recorder records."""

    def __init__(self, node, executor, recorder, patience):
        self._executor, self._recorder, self._patience = executor, recorder, patience
        self._trajectory = RemoteNode(node, 'trajectory', ('start', 'stop'))
        self._stamp, self._heard, self._moving = None, time.monotonic(), False
        node.create_subscription(JointState, 'joint_states', self._on_state,
                                 qos_profile_sensor_data, event_callbacks=NO_EVENTS)

    def _on_state(self, message):
        self._stamp, self._heard = to_nanoseconds(message.header.stamp), time.monotonic()

    def run(self, parameters, duration) -> None:
        """Drive the motion and bring it to rest."""
        self._until(self._trajectory.is_ready, 'the services of /trajectory are not there: start '
                    'plant_node or the bridge, controller_node and trajectory_node first',
                    self._patience)
        self._until(lambda: not self._recorder.missing and self._stamp is not None,
                    'not all nodes publish', self._patience, self._recorder)
        answer = self._answer(self._trajectory.set_parameters(parameters)).result
        if not answer.successful:
            raise RunError(f'/trajectory refuses the motion: {answer.reason}')
        self._trigger('start')
        self._moving = True
        self._pass(duration + APPROACH)
        self._trigger('stop')
        self._moving = False
        self._pass(APPROACH)

    def _trigger(self, service):
        response = self._answer(self._trajectory.trigger(service))
        if not response.success:
            raise RunError(f'/trajectory/{service}: {response.message}')

    def _answer(self, future):
        self._until(future.done, '/trajectory does not answer', _BOUND)
        return future.result()

    def _until(self, done, otherwise, bound, recorder=None):
        """Spin until something is done; raise RunError, with what is missing, after a while."""
        end = time.monotonic() + bound
        while not done():
            self._spin()
            if time.monotonic() > end:
                missing = f' ({", ".join(recorder.missing)} missing)' if recorder else ''
                raise RunError(f'{otherwise}{missing}; same ROS_DOMAIN_ID?')

    def _pass(self, duration):
        """Spin for so long by the stamps of the joint states [s]."""
        end = self._stamp + round(duration * NANOSECONDS)
        while self._stamp < end:
            self._spin()
            if time.monotonic() - self._heard > _SILENCE:
                raise RunError(f'no joint state for {_SILENCE:g} s: the robot has stopped; look '
                               'at /diagnostics')

    def _spin(self):
        self._recorder.poll()
        self._executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        """Stop a motion that still goes on, and end the recording."""
        try:
            if self._moving:
                self._moving = False
                self._trigger('stop')
        finally:
            self._recorder.close()
