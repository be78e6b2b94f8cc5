# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A running loop for the page of `gms_flex view live`, at little cost to the loop beside it."""

from array import array
from collections import deque
from contextlib import suppress
from functools import partial
import math
from operator import itemgetter
import struct
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from gms_flex_control.data.recording import link_names, MOTOR_SUFFIX
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.nodes import messages, process, scheduling
from gms_flex_control.nodes.remote import answer_of, RemoteNode
from gms_flex_control.nodes.topics import all_waiting, stamp_in
from gms_flex_control.schema.build import robot_from_values
from gms_flex_control.schema.keys import robot_keys
from gms_flex_control.view.live import Feed, JointStateTable, SPACING, Status
from gms_flex_control.view.recorded import scene_of, unknown_scene
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

CONTROLLER = '/cascade_controller'
_TUNABLE = ('compensation', 'gains')
# what the page may ask for -> the service that does it, below the namespace
_REQUESTS = {'start': 'trajectory/start', 'stop': 'trajectory/stop', 'enable': 'plant/enable',
             'disable': 'plant/disable', 'reset': 'plant/reset',
             'emergency_stop': 'plant/emergency_stop'}
_ASK_PERIOD = 1.0    # of looking for the controller, and asking for its robot [s]
_SPIN = 0.02         # longest wait for an answer [s]
_PASS_PERIOD = 0.06  # of passing on what has come [s]
_SILENCE = 1.0   # of the joint states, before it is said [s]
_DEPTH = 1000    # messages that may wait


class ViewError(GmsFlexError):
    """A node of the loop does not answer."""


class LiveView:
    """The loop in a ``namespace`` with a ``controller`` node, heard and asked in threads."""

    live = True

    def __init__(self, namespace='', controller=CONTROLLER):
        self._space, self._controller = namespace.rstrip('/'), controller
        self._known = False      # whether the controller has sent its robot
        self._there = False      # whether it answers
        self._feed, self._todo, self._answers = Feed(), deque(), deque()
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=run, name=run.__name__, daemon=True)
                         for run in (self._listen, self._ask)]

    def __enter__(self):
        """Join the ROS graph and begin to listen."""
        process.avoid_shared_memory()
        with scheduling.interrupting_nobody():  # and so will the threads that begin here
            self._join()
        return self

    def _join(self):
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        name = f'_gms_flex_view_{time.time_ns() % 10**9}'
        # apart: of the first one messages are taken, only the second one is spun
        self._node, self._asker = (
            rclpy.create_node(f'{name}{end}', enable_rosout=False, start_parameter_services=False)
            for end in ('', '_parameters'))
        self._remote = RemoteNode(self._asker, self._controller, do=self._todo.append)
        self._services = {name: self._asker.create_client(Trigger, f'{self._space}/{service}')
                          for name, service in _REQUESTS.items()}
        self._listener = _Listener(self._node, self._space, self._controller, self._feed)
        for thread in self._threads:
            thread.start()

    def __exit__(self, *_):
        """Stop the threads and leave the ROS graph."""
        self._stop.set()
        for thread in self._threads:
            thread.join(timeout=5.0)
        self._node.destroy_node()
        self._asker.destroy_node()
        rclpy.try_shutdown()

    def _listen(self):
        """Take messages in, and pass them on some at a time."""
        scheduling.give_way()
        while not self._stop.wait(_PASS_PERIOD):
            while self._answers:
                self._meet(self._answers.popleft())
            self._listener.take_all()
            self._listener.pass_on(self._there)

    def _ask(self):
        """Call services, and look whether the controller is there."""
        executor, asked = EventsExecutor(), -math.inf
        executor.add_node(self._asker)
        try:
            while rclpy.ok() and not self._stop.is_set():
                executor.spin_once(timeout_sec=_SPIN)
                while self._todo:
                    self._todo.popleft()()
                if time.monotonic() - asked > _ASK_PERIOD:
                    asked = time.monotonic()
                    was, self._there = self._there, self._remote.is_ready()
                    if self._there and not (was and self._known):  # it may have another robot now
                        self._remote.ask_all(self._answers.append)
        except ExternalShutdownException:
            pass
        finally:
            executor.shutdown()

    def _meet(self, values):
        """Take the robot that the controller believes in from its parameters."""
        joints = values.get('joints') or ()
        wanted = {key.name for key in robot_keys(joints)}
        try:
            robot = robot_from_values({name: list(value) if isinstance(value, array) else value
                                       for name, value in values.items() if name in wanted})
        except GmsFlexError:
            return  # a controller of somebody else
        self._known = True
        self._listener.meet(robot)

    def session(self) -> dict:
        """Return what the page has to know before it draws, as a dict for JSON."""
        version, scene = self._feed.version, self._listener.scene
        title = 'running loop' + (f' in {self._space}' if self._space else '')
        return {'mode': 'live', 'title': title, 'notes': [], 'version': version,
                'controller': self._controller, 'scene': scene and scene.as_dict(),
                'columns': self._listener.columns,
                'blocks': {'count': self._listener.blocks, 'origin': 'observer'}}

    def since(self, number, wait) -> dict:
        """As `gms_flex_control.view.live.Feed.since`."""
        return self._feed.since(number, wait)

    def parameters(self) -> list:
        """Return the controller's live parameters; raises ViewError if it does not answer."""
        return self._answered(self._remote.describe(_TUNABLE))

    def set_parameter(self, name, value) -> dict:
        """Set one of `_TUNABLE`; return accepted, reason and value, or ViewError."""
        if name.split('.')[0] not in _TUNABLE:
            raise ViewError(f'{name[:80]} cannot be set here, only gains and compensation')
        return self._answered(self._remote.change(name, value))

    def call(self, name) -> dict:
        """Ask for one of `_REQUESTS`; return success and message, or ViewError."""
        if name not in _REQUESTS:
            raise ViewError(f'{name[:80]} cannot be asked for here, only {", ".join(_REQUESTS)}')
        answer = answer_of(self._services[name], Trigger.Request(), self._todo.append)
        if answer is None:
            node = _REQUESTS[name].split('/')[0]
            raise ViewError(f'{self._space}/{_REQUESTS[name]} does not answer: is {node}_node '
                            'running?')
        return {'success': answer.success, 'message': answer.message}

    def _answered(self, result):
        if result is None:
            raise ViewError(f'{self._controller} does not answer: is controller_node running?')
        return result


class _BytesError(Exception):
    """Bytes make no message."""


def _read(function, data, kind):
    """Return what a function reads of a message's bytes; raise _BytesError where it cannot."""
    try:
        return function(data, kind)
    except (RuntimeError, struct.error) as error:
        raise _BytesError from error


class _Listener:
    """
    Rows of the loop's messages for a Feed, and how its robot is.

    Messages wait in DDS until they are taken, many at a time; those between two rows are never
    made objects of Python, and no executor wakes up for each of them.
    """

    def __init__(self, node, space, controller, feed):
        self._node, self._space, self._controller, self._feed = node, space, controller, feed
        self.scene, self.blocks = None, 0  # how to draw the robot, None while nothing is known
        self._rows = self._names = self._heard = None
        self._links, self._motors = (), ()
        self._robot, self._complaint = Status(), ''
        arrays = {f'{space}/effort_controller/commands': 'command', f'{space}/reference':
                  'reference', f'{controller}/blocks': 'block', f'{controller}/sticking': 'stick'}
        self._heard_topics = [
            self._subscribe(JointState, f'{space}/joint_states', self._on_joint_states),
            self._subscribe(JointState, f'{controller}/state', self._on_state),
            self._subscribe(DiagnosticArray, '/diagnostics', self._on_diagnostics),
            *(self._subscribe(Float64MultiArray, topic, partial(self._on_array, signal))
              for topic, signal in arrays.items())]

    def _subscribe(self, kind, topic, handler):
        """Return a subscription whose messages wait until they are taken, and who handles them."""
        return self._node.create_subscription(
            kind, topic, handler, process.subscriber_qos('realtime', _DEPTH), raw=True,
            event_callbacks=process.NO_EVENTS), handler

    def take_all(self) -> None:
        """Take all messages that wait, in the order in which they came."""
        waiting = sorted(((known['received_timestamp'], handler, data)
                          for subscription, handler in self._heard_topics
                          for data, known in all_waiting(subscription, _DEPTH)),
                         key=itemgetter(0))
        for _, handler, data in waiting:
            with suppress(_BytesError):
                handler(data)

    def pass_on(self, there) -> None:
        """Give the feed what is complete; ``there`` is whether the controller answers."""
        now = time.monotonic()
        if self._rows is not None and self._rows.restarted:
            self._rows.restarted = False
            self._feed.begin_anew()
        rows = () if self._rows is None else self._rows.take(now)
        self._feed.add(rows, {
            'state': self._missing(now, there), 'robot': self._robot.as_dict(now),
            'controller': self._complaint if there else ''})

    def _missing(self, now, there):
        """Return what is missing in a sentence, '' if nothing is."""
        if self._heard is None:
            return f'no joint states on {self._space}/joint_states yet: is plant_node running?'
        if now - self._heard > _SILENCE:
            return f'no joint states for {int(now - self._heard)} s'
        return '' if there else f'{self._controller} is not there'

    def meet(self, robot) -> None:
        """Show the robot (RobotParams) that the controller believes in."""
        self._links, self._motors, self._names = robot.joints, robot.motors, None
        scene, blocks = scene_of(robot), robot.friction.stiffness.shape[1]
        if (scene, blocks) != (self.scene, self.blocks):
            self._begin(scene, blocks)

    @property
    def columns(self) -> list[str]:
        """Return the names of the columns of a row."""
        return self._rows.names if self._rows else []

    def _begin(self, scene, blocks):
        self.scene, self.blocks = scene, blocks
        self._rows, self._names = JointStateTable(scene.n_joints, blocks, SPACING), None
        self._feed.begin_anew()

    def _on_joint_states(self, data):
        self._heard = time.monotonic()
        if self._rows is not None and not self._rows.wants(_read(stamp_in, data, JointState)):
            return
        message = _read(deserialize_message, data, JointState)
        names = list(message.name)
        if self._rows is None:
            links = link_names(names)
            self._links = tuple(links)
            self._motors = tuple(name + MOTOR_SUFFIX if name + MOTOR_SUFFIX in names else ''
                                 for name in links)
            self._begin(unknown_scene(links, self._motors), 0)
        if names != self._names:
            self._names = names
            self._order = [[names.index(name) if name in names else None for name in side]
                           for side in (self._links, self._motors)]
        link, motor = ([message.position[k] if k is not None and k < len(message.position)
                        else math.nan for k in side] for side in self._order)
        self._rows.put_state(messages.to_nanoseconds(message.header.stamp), self._heard,
                             link, motor)

    def _on_array(self, signal, data):
        if self._rows is None or not self._rows.wants_more(signal, _read(
                stamp_in, data, Float64MultiArray)):
            return
        message = _read(deserialize_message, data, Float64MultiArray)
        dims = message.layout.dim
        if signal != 'reference' or not dims or dims[0].label != messages.EFFORT:
            self._rows.put(signal, messages.read_marks(message)[0], message.data)

    def _on_state(self, data):
        stamp = _read(stamp_in, data, JointState)
        if self._rows is None or not self._rows.wants_more('error', stamp):
            return
        message = _read(deserialize_message, data, JointState)
        if tuple(message.name) == tuple(self._links):
            self._rows.put('error', stamp, message.position)
            self._rows.put('friction', stamp, message.effort)

    def _on_diagnostics(self, data):
        message = _read(deserialize_message, data, DiagnosticArray)
        for status in message.status:
            if status.hardware_id == f'{self._space}/plant':
                self._robot.report({item.key: item.value for item in status.values},
                                   messages.to_nanoseconds(message.header.stamp) * 1e-9,
                                   time.monotonic())
            elif status.hardware_id == self._controller:
                self._complaint = '' if status.level == DiagnosticStatus.OK else status.message
