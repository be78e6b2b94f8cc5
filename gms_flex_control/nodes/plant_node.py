# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The robot as a ROS 2 node, simulated or the bridge to a real one, and its safety services."""

from functools import partial
import threading
import time

from gms_flex_control.nodes import process, scheduling
from gms_flex_control.nodes.bridged_robot import BridgedRobot
from gms_flex_control.nodes.health import Health, trigger
from gms_flex_control.nodes.parameters import ConfiguredNode, NodeParameters
from gms_flex_control.nodes.simulated_robot import SimulatedRobot
from gms_flex_control.nodes.topics import all_waiting, DEPTH
from gms_flex_control.schema.keys import bridge_keys, plant_node_keys, robot_keys, safety_keys
import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

_PATIENCE = 1.0            # with the service that lets the reference hold [s]
# reliable, and best effort for a button that offers no more; to hear it twice does no harm
_ANY_BUTTON = [QoSProfile(depth=DEPTH, reliability=policy) for policy in (
    ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT)]
_RELEASED = b'\0'  # the one byte of a Bool, behind the header
_BREATH = 1e-3      # left to the loop where more than one message of the button waits [s]


def _simulator_keys(joints):
    return (*robot_keys(joints), *plant_node_keys(joints), *safety_keys(joints))


def _bridge_keys(joints):
    names = [key for key in robot_keys(()) if key.name in ('joints', 'motors')]
    return (*names, *safety_keys(joints), *bridge_keys(joints))


class PlantNode(ConfiguredNode):
    """Publish joint states and obey torque commands, as ros2_control's effort side does."""

    def __init__(self, direct=None, **kwargs):
        super().__init__('plant', direct, **kwargs)
        bridged = self.has_parameter('backend') and self.get_parameter('backend').value == 'bridge'
        parameters = NodeParameters(self, _bridge_keys if bridged else _simulator_keys)
        values = parameters.values
        self.health = Health(self, lambda: self._robot.figures(),
                             lambda: self._robot.fail(self.health.fault))
        self._robot = (BridgedRobot if bridged else SimulatedRobot)(
            self, values, parameters.joints)
        self._safety = Safety(self, self._robot, topic=values['emergency_stop_topic'],
                              hold_services=values['hold_services'])
        scheduling.take_priority(self, values['realtime_priority'])

    def foresee(self, controller) -> None:
        """Let efforts to a real robot leave ahead of all else; see `Foresight`."""
        if isinstance(self._robot, BridgedRobot):
            self._robot.foresee(controller)

    def run(self, spinner) -> None:
        """Simulate or bridge until a signal comes, or the duration is over."""
        self._safety.start()
        self._robot.run(spinner)

    def finish(self) -> None:
        """Leave zero torque on the wire."""
        self._robot.finish()
        self._safety.end()


class Safety:
    """
    ``~/enable``, ``~/disable``, ``~/reset``, ``~/emergency_stop`` and the topic of the button.

    They are a node of their own with an executor of its own: queued joint states and commands
    delay none of them. Without parameters it is hidden from 'ros2 param list', which would wait.

    ``robot`` is a SupervisedRobot; ``topic`` is that of the button, std_msgs/Bool, true is
    pressed; ``hold_services`` are Triggers called one after the other before torque is enabled.
    """

    def __init__(self, node, robot, *, topic, hold_services):
        self._robot, self._health = robot, node.health
        self._node = rclpy.create_node(
            f'_{node.get_name()}_safety', namespace=node.get_namespace(), context=node.context,
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False)
        self._topic = node.resolve_topic_name(topic)
        group = ReentrantCallbackGroup()  # while one handler waits the others go on
        for qos in _ANY_BUTTON:
            self._listen(qos, group)
        for name, handler in (
                ('disable', trigger('disable', robot.disable)),
                ('reset', trigger('reset', self._reset)),
                ('emergency_stop', trigger('stop', partial(
                    robot.stop, 'emergency stop by service'))),
                ('enable', self._enable)):
            self._node.create_service(Trigger, node.resolve_service_name(f'~/{name}'), handler,
                                      callback_group=group)
        self._served = node.direct.services
        self._holds = [self._node.create_client(Trigger, node.resolve_service_name(name),
                                                callback_group=group) for name in hold_services]
        self._waits_for = ''       # the one of them that has been called
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self._node)
        self._over = Future()
        self._thread = threading.Thread(target=self._spin, name='safety', daemon=True)

    def start(self) -> None:
        """Serve from now on."""
        self._thread.start()

    def end(self) -> None:
        """Serve no more."""
        self._over.set_result(None)
        if self._thread.is_alive():
            self._thread.join(timeout=1.0)
        self._executor.shutdown(timeout_sec=0.5)
        self._node.destroy_node()

    def _spin(self):
        while not self._over.done() and self._node.context.ok():
            try:
                self._executor.spin_until_future_complete(self._over)
            except ExternalShutdownException:
                return
            except Exception as error:  # noqa: B902  the emergency stop must be heard on
                self._health.failed(error, 'a safety service')

    def _listen(self, qos, group):
        def on_button(first):
            further = (data for data, _ in all_waiting(subscription, 2 * DEPTH))
            messages = [data[4:5] for data in (first, *further)]
            if any(data != _RELEASED for data in messages):
                self._robot.button(True, self._topic)
            if messages[-1] == _RELEASED:
                self._robot.button(False, self._topic)
            if len(messages) > 1:  # no button is so fast: a storm
                time.sleep(_BREATH)
        subscription = self._node.create_subscription(
            Bool, self._topic, on_button, qos, callback_group=group, raw=True,
            event_callbacks=process.NO_EVENTS)

    def _reset(self):
        self._health.recover()
        return self._robot.reset()

    async def _enable(self, _request, response):
        refusals = self._robot.refusals  # of what may come while the hold is waited for
        obstacle = self._robot.obstacle()
        if not obstacle and self._robot.at_zero:
            if self._waits_for:
                obstacle = f'another request already waits for {self._waits_for}'
            for hold in self._holds:
                obstacle = obstacle or self._no_hold(hold) or await self._held(hold)
        response.success, response.message = (
            (False, f'not enabled: {obstacle}') if obstacle else self._robot.enable(refusals))
        return response

    async def _held(self, hold):
        """Let the reference, or the controller, hold; return a sentence if not, else ''."""
        serve = self._served.get(hold.service_name)
        held = (serve(Trigger.Request(), Trigger.Response()) if serve
                else await self._answered(hold))
        if held is None:
            return f'{hold.srv_name} did not answer in {_PATIENCE} s'
        return '' if held.success else f'{hold.srv_name} refused: {held.message}'

    async def _answered(self, hold):
        """Return the answer of another process, None if none comes in time."""
        self._waits_for, answer = hold.srv_name, hold.call_async(Trigger.Request())
        patience = self._node.create_timer(_PATIENCE, answer.cancel,
                                           clock=Clock(clock_type=ClockType.STEADY_TIME))
        held = await answer
        self._waits_for = ''
        self._node.destroy_timer(patience)
        return held

    def _no_hold(self, hold):
        if hold.service_name in self._served or hold.service_is_ready():
            return ''
        return (f'nobody serves {hold.srv_name}, which lets reference or controller begin where '
                'the robot is; start its node or leave it out of hold_services')
