# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The running loop as the page of `gms_flex view live` asks for it."""

from array import array
from collections import deque
import math
import threading
import time

from gms_flex_control.errors import GmsFlexError
from gms_flex_control.nodes.loop_listener import LoopListener
from gms_flex_control.nodes.remote_parameters import RemoteParameters, RemoteTriggers
from gms_flex_control.nodes.scheduling import give_way
from gms_flex_control.nodes.transport import avoid_shared_memory
from gms_flex_control.schema.build import robot_from_values
from gms_flex_control.schema.keys import robot_keys
from gms_flex_control.view.live import Feed
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions

CONTROLLER = '/cascade_controller'
_TUNABLE = ('compensation', 'gains')
# what the page may ask for -> the service that does it, below the namespace
_REQUESTS = {'start': 'trajectory/start', 'stop': 'trajectory/stop', 'enable': 'plant/enable',
             'disable': 'plant/disable', 'reset': 'plant/reset',
             'emergency_stop': 'plant/emergency_stop'}
_ASK_PERIOD = 1.0    # of looking for the controller, and asking for its robot [s]
_SPIN = 0.02         # longest wait for an answer [s]
_PASS_PERIOD = 0.06  # of passing on what has come [s]


class ViewError(GmsFlexError):
    """A node of the loop does not answer."""


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
        self._known = False      # whether the controller has told its robot
        self._there = False      # whether it answers
        self._asked = -math.inf
        self._feed, self._todo, self._told = Feed(), deque(), deque()
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=run, name=run.__name__, daemon=True)
                         for run in (self._listen, self._ask)]

    def __enter__(self):
        """Join the ROS graph and begin to listen."""
        avoid_shared_memory()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        name = f'_gms_flex_view_{time.time_ns() % 10**9}'
        # apart: of the first one messages are taken, only the second one is spun
        self._node, self._asker = (
            rclpy.create_node(f'{name}{end}', enable_rosout=False, start_parameter_services=False)
            for end in ('', '_parameters'))
        self._remote = RemoteParameters(self._asker, self._controller, self._todo.append)
        self._services = RemoteTriggers(self._asker, [
            f'{self._space}/{service}' for service in _REQUESTS.values()], self._todo.append)
        self._listener = LoopListener(self._node, self._space, self._controller, self._feed)
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

    def _listen(self):
        """Take messages in, and pass them on some at a time."""
        give_way()
        while not self._stop.wait(_PASS_PERIOD):
            while self._told:
                self._meet(self._told.popleft())
            self._listener.take_all()
            self._listener.pass_on(self._there)

    def _ask(self):
        """Call services, and look whether the controller is there."""
        for _ in self._spinning():
            while self._todo:
                self._todo.popleft()()
            now = time.monotonic()
            if now - self._asked > _ASK_PERIOD:
                self._asked = now
                was, self._there = self._there, self._remote.is_ready()
                if self._there and not (was and self._known):  # it may have another robot now
                    self._remote.ask_all(self._told.append)

    def _spinning(self):
        """Yield between the answers of services until the end."""
        executor = EventsExecutor()
        executor.add_node(self._asker)
        try:
            while rclpy.ok() and not self._stop.is_set():
                executor.spin_once(timeout_sec=_SPIN)
                yield
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

    def session(self):
        """Return what the page has to know before it draws, as a dict for JSON."""
        version, scene = self._feed.version, self._listener.scene
        title = 'running loop' + (f' in {self._space}' if self._space else '')
        return {'mode': 'live', 'title': title, 'notes': [], 'version': version,
                'controller': self._controller, 'scene': scene and scene.as_dict(),
                'columns': self._listener.columns,
                'blocks': {'count': self._listener.blocks, 'origin': 'observer'}}

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

    def call(self, name):
        """
        Ask plant or trajectory for something.

        Parameters
        ----------
        name : str
            ``start`` or ``stop`` (of the motion), ``enable``, ``disable`` or ``reset`` (of the
            torque), or ``emergency_stop``.

        Returns
        -------
        dict
            ``success`` (bool) and ``message`` (str), as the node answers.

        Raises
        ------
        ViewError
            If it does not answer in time, or there is no such request.

        """
        if name not in _REQUESTS:
            raise ViewError(f'{name[:80]} cannot be asked for here, only {", ".join(_REQUESTS)}')
        service = f'{self._space}/{_REQUESTS[name]}'
        answer = self._services.call(service)
        if answer is None:
            node = _REQUESTS[name].split('/')[0]
            raise ViewError(f'{service} does not answer: is {node}_node running?')
        return answer

    def _answered(self, result):
        if result is None:
            raise ViewError(f'{self._controller} does not answer: is controller_node running?')
        return result
