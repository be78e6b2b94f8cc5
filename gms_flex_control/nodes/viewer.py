# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The running loop as the page of `gms_flex view live` asks for it."""

from array import array
from collections import deque
import math
import threading
import time

from gms_flex_control.bags.names import link_names, MOTOR_SUFFIX
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.nodes import messages, process
from gms_flex_control.nodes.remote_parameters import RemoteParameters
from gms_flex_control.nodes.transport import avoid_shared_memory
from gms_flex_control.schema.build import robot_from_values
from gms_flex_control.schema.keys import robot_keys
from gms_flex_control.view.live import Feed, Rows
from gms_flex_control.view.scene import scene_of, unknown_scene
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

CONTROLLER = '/cascade_controller'
_TUNABLE = ('compensation', 'gains')
_ASK_PERIOD = 1.0    # of looking for the controller, and asking for its robot [s]
_SPIN = 0.02         # longest wait for a message [s]
_PASS_PERIOD = 0.03  # of passing on what has come [s]
_SILENCE = 1.0       # of the joint states, before it is said [s]
_DEPTH = 200


class ViewError(GmsFlexError):
    """The controller does not answer."""


class LiveView:
    """
    Nodes in threads of their own, and what they have heard.

    Parameters
    ----------
    namespace : str
        Of the loop's topics, '' for none.
    controller : str
        Full name of the controller node.

    """

    live = True

    def __init__(self, namespace='', controller=CONTROLLER):
        self._space, self._controller = namespace.rstrip('/'), controller
        self._scene = self._rows = self._names = None
        self._links, self._motors, self._blocks = (), (), 0
        self._known = False      # whether the controller has told its robot
        self._there = False      # whether it answers
        self._asked, self._heard = -math.inf, None
        self._feed, self._todo, self._told = Feed(), deque(), deque()
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=run, name=run.__name__, daemon=True)
                         for run in (self._listen, self._ask)]

    def __enter__(self):
        """Join the ROS graph and begin to listen."""
        avoid_shared_memory()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        name = f'_gms_flex_view_{time.time_ns() % 10**9}'
        # apart, so that an answer does not wait behind thousands of joint states
        self._node, self._asker = (
            rclpy.create_node(f'{name}{end}', enable_rosout=False, start_parameter_services=False)
            for end in ('', '_parameters'))
        self._remote = RemoteParameters(self._asker, self._controller, self._todo.append)
        self._subscribe()
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_):
        """Stop the threads and leave the ROS graph."""
        self._stop.set()
        for thread in self._threads:
            thread.join(timeout=5.0)
        self._node.destroy_node()
        self._asker.destroy_node()
        rclpy.try_shutdown()

    def _subscribe(self):
        arrays = {f'{self._space}/effort_controller/commands': self._on_command,
                  f'{self._space}/reference': self._on_reference,
                  f'{self._controller}/blocks': self._on_blocks,
                  f'{self._controller}/sticking': self._on_sticking}
        kinds = [(JointState, f'{self._space}/joint_states', self._on_joint_states),
                 (JointState, f'{self._controller}/state', self._on_state),
                 *((Float64MultiArray, topic, callback) for topic, callback in arrays.items())]
        for kind, topic, callback in kinds:
            self._node.create_subscription(
                kind, topic, callback, process.subscriber_qos('realtime', _DEPTH),
                event_callbacks=process.NO_EVENTS)

    def _listen(self):
        """Take messages in, and pass them on some at a time."""
        due = 0.0
        for _ in self._spinning(self._node):
            now = time.monotonic()
            if now >= due:
                due = now + _PASS_PERIOD
                self._pass_on(now)

    def _ask(self):
        """Call services, and look whether the controller is there."""
        for _ in self._spinning(self._asker):
            while self._todo:
                self._todo.popleft()()
            now = time.monotonic()
            if now - self._asked > _ASK_PERIOD:
                self._asked = now
                was, self._there = self._there, self._remote.is_ready()
                if self._there and not (was and self._known):  # it may have another robot now
                    self._remote.ask_all(self._told.append)

    def _spinning(self, node):
        """Yield between the callbacks of a node until the end."""
        executor = EventsExecutor()
        executor.add_node(node)
        try:
            while rclpy.ok() and not self._stop.is_set():
                executor.spin_once(timeout_sec=_SPIN)
                yield
        except ExternalShutdownException:
            pass
        finally:
            executor.shutdown()

    def _pass_on(self, now):
        while self._told:
            self._meet(self._told.popleft())
        if self._rows is None:
            self._feed.add((), self._state(now))
            return
        if self._rows.restarted:
            self._rows.restarted = False
            self._feed.begin_anew()
        self._feed.add(self._rows.take(now), self._state(now))

    def _state(self, now):
        if self._heard is None:
            return f'no joint states on {self._space}/joint_states yet: is plant_node running?'
        if now - self._heard > _SILENCE:
            return f'no joint states for {int(now - self._heard)} s'
        return '' if self._there else f'{self._controller} is not there'

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
        self._links, self._motors, self._names = robot.joints, robot.motors, None
        scene, blocks = scene_of(robot), robot.friction.stiffness.shape[1]
        if (scene, blocks) != (self._scene, self._blocks):
            self._begin(scene, blocks)

    def _begin(self, scene, blocks):
        self._scene, self._blocks = scene, blocks
        self._rows = Rows(scene.n_joints, blocks)
        self._names = None
        self._feed.begin_anew()

    def _on_joint_states(self, message):
        self._heard = time.monotonic()
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

    def _put(self, signal, message):
        if self._rows is not None:
            self._rows.put(signal, messages.read_stamp(message), message.data)

    def _on_command(self, message):
        self._put('command', message)

    def _on_reference(self, message):
        dims = message.layout.dim
        if not dims or dims[0].label != messages.EFFORT:
            self._put('reference', message)

    def _on_state(self, message):
        if self._rows is not None and tuple(message.name) == tuple(self._links):
            stamp = messages.to_nanoseconds(message.header.stamp)
            self._rows.put('error', stamp, message.position)
            self._rows.put('friction', stamp, message.effort)

    def _on_blocks(self, message):
        self._put('block', message)

    def _on_sticking(self, message):
        self._put('stick', message)

    def session(self):
        """Return what the page has to know before it draws, as a dict for JSON."""
        version, scene = self._feed.version, self._scene
        title = 'running loop' + (f' in {self._space}' if self._space else '')
        return {'mode': 'live', 'title': title, 'notes': [], 'version': version,
                'controller': self._controller, 'scene': scene and scene.as_dict(),
                'columns': self._rows.names if scene else [],
                'blocks': {'count': self._blocks, 'origin': 'observer'}}

    def since(self, number, wait):
        """As `gms_flex_control.view.live.Feed.since`."""
        return self._feed.since(number, wait)

    def parameters(self):
        """
        Return the controller's parameters that may change while it runs.

        Raises
        ------
        ViewError
            If it does not answer in time.

        """
        return self._answered(self._remote.describe(_TUNABLE))

    def set_parameter(self, name, value):
        """
        Set one parameter of the controller.

        Parameters
        ----------
        name : str
            Below ``gains``, or ``compensation``.
        value : float or str
            The new value.

        Returns
        -------
        dict
            ``accepted`` (bool), ``reason`` (str) and ``value``, which holds from now on.

        Raises
        ------
        ViewError
            If it does not answer in time, or is no parameter of these.

        """
        if name.split('.')[0] not in _TUNABLE:
            raise ViewError(f'{name[:80]} cannot be set here, only gains and compensation')
        return self._answered(self._remote.change(name, value))

    def _answered(self, result):
        if result is None:
            raise ViewError(f'{self._controller} does not answer: is controller_node running?')
        return result
