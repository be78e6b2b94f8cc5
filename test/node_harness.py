# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Real node processes on a ROS domain of their own, and a node in the test that talks to them."""

from contextlib import ExitStack
import fcntl
import os
from pathlib import Path
import random
import signal
import socket
import subprocess
import tempfile
import time

from gms_flex_control.experiment.processes import executable, ros_arguments
import pytest

rclpy = pytest.importorskip('rclpy')
EventsExecutor = pytest.importorskip('rclpy.experimental').EventsExecutor
event_handler = pytest.importorskip('rclpy.event_handler')
qos = pytest.importorskip('rclpy.qos')
JointState = pytest.importorskip('sensor_msgs.msg').JointState
std_msgs = pytest.importorskip('std_msgs.msg')
interfaces = pytest.importorskip('rcl_interfaces.msg')
services = pytest.importorskip('rcl_interfaces.srv')
Trigger = pytest.importorskip('std_srvs.srv').Trigger
Float64MultiArray = std_msgs.Float64MultiArray

CONFIG = Path(__file__).parents[1] / 'config'
FILES = (CONFIG / 'robot.yaml', CONFIG / 'controller.yaml')
PATIENCE = 60.0  # for whatever has to come, kernels that must be compiled included [s]
JOINTS = ['joint1', 'joint2']
NAMES = [*JOINTS, 'joint1_motor', 'joint2_motor']
COMMANDS, STATES, REFERENCE = '/effort_controller/commands', '/joint_states', '/reference'
DISCOVERY = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
PARAMETER = interfaces.ParameterType


def take_domain():
    """Return a ROS domain id that no process here uses, and the lock that keeps it."""
    ids = list(range(1, 101))  # above 101 the ports of DDS are those Linux hands out
    random.SystemRandom().shuffle(ids)
    folder = Path(tempfile.gettempdir()) / f'gms_flex_test_domains_{os.getuid()}'
    folder.mkdir(exist_ok=True)
    for domain in ids:
        lock = open(folder / f'{domain}.lock', 'w')
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(('', 7400 + 250 * domain + 10))  # of the first participant there
            return domain, lock
        except OSError:
            lock.close()
    raise RuntimeError('every ROS domain is in use')


def write_parameters(path, text):
    """Write YAML ``text`` as the parameters of all nodes; return the path."""
    indented = ''.join(f'    {line}\n' for line in text.splitlines())
    path.write_text(f'/**:\n  ros__parameters:\n{indented}')
    return path


class NodeProcess:
    """One node as a process of its own; what it prints goes to a file."""

    def __init__(self, name, environment, folder, *, files=FILES, arguments=(), **parameters):
        self.log = folder / f'{name}.log'
        given = {key.replace('__', '.'): value for key, value in parameters.items()}
        with self.log.open('wb') as output:
            self.process = subprocess.Popen(
                [*executable(name.split('.')[0]), *ros_arguments(files, given), *arguments],
                env=environment, stdin=subprocess.DEVNULL, stdout=output,
                stderr=subprocess.STDOUT)

    def printed(self):
        """Return what it has printed so far (str)."""
        return self.log.read_text(errors='replace')

    def signal(self, *numbers):
        """Send signals and return the exit code."""
        for number in numbers:
            self.process.send_signal(number)
        return self.wait()

    def wait(self, bound=PATIENCE):
        """Return the exit code."""
        return self.process.wait(timeout=bound)

    @property
    def runs(self):
        """Return whether the process is alive."""
        return self.process.poll() is None

    def kill(self):
        """End it in any case."""
        if self.runs:
            self.process.kill()
            self.process.wait()


class Lab:
    """
    A private domain with node processes in it and a probing node in this process.

    Parameters
    ----------
    folder : Path
        For logs.

    """

    def __init__(self, folder):
        self.folder, self._stack, self._processes = folder, ExitStack(), []

    def __enter__(self):
        self.domain, lock = take_domain()
        self._stack.callback(lock.close)
        patch = self._stack.enter_context(pytest.MonkeyPatch.context())
        patch.setenv(DISCOVERY, 'LOCALHOST')
        paths = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get('PYTHONPATH')])]
        self.environment = dict(
            os.environ, ROS_DOMAIN_ID=str(self.domain), PYTHONUNBUFFERED='1',
            PYTHONPATH=os.pathsep.join(paths), ROS_LOG_DIR=str(self.folder))
        self._context = None
        return self

    @property
    def node(self):
        """Return the probing node; made when it is first asked for."""
        if self._context is None:
            self._context = rclpy.Context()
            rclpy.init(context=self._context, domain_id=self.domain,
                       signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
            self._node = rclpy.create_node('probe', context=self._context, enable_rosout=False,
                                           start_parameter_services=False)
            self._executor = EventsExecutor(context=self._context)
            self._executor.add_node(self._node)
        return self._node

    def __exit__(self, *_):
        for process in self._processes:
            process.kill()
        if self._context is not None:
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.try_shutdown()
        self._stack.close()

    def start(self, name, **options):
        """Start a node such as ``plant_node``; see NodeProcess."""
        self._processes.append(NodeProcess(name, self.environment, self.folder, **options))
        return self._processes[-1]

    def listen(self, kind, topic):
        """Return a list that every message on ``topic`` is appended to."""
        received = []
        self.node.create_subscription(
            kind, topic, received.append, qos.QoSProfile(depth=10000),
            event_callbacks=event_handler.SubscriptionEventCallbacks(
                use_default_callbacks=False))
        return received

    def speak(self, kind, topic):
        """Return a publisher."""
        return self.node.create_publisher(kind, topic, 1000)

    def until(self, condition, bound=PATIENCE):
        """Handle messages until ``condition()`` is true; return its value, fail in the end."""
        assert self.node is not None
        end = time.monotonic() + bound
        while not (value := condition()):
            assert time.monotonic() < end, 'waited in vain' + ''.join(
                f'\n{process.log.name}:\n{process.printed()}' for process in self._processes)
            self._executor.spin_once(timeout_sec=0.02)
        return value

    def more(self, received, count):
        """Wait until ``received`` has ``count`` messages more than now; return those."""
        have = len(received)
        self.until(lambda: len(received) >= have + count)
        return received[have:have + count]

    def call(self, kind, name, request=None):
        """Call a service and return its answer."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(request or kind.Request())
        self.until(future.done)
        self.node.destroy_client(client)
        return future.result()

    def set_parameters(self, node, *, together=False, **parameters):
        """
        Set parameters as ``ros2 param set`` does, '__' in a name for '.'.

        Returns
        -------
        SetParametersResult or list of it
            One per parameter; a single one if there is one or they are set ``together``.

        """
        messages = [interfaces.Parameter(name=name.replace('__', '.'), value=as_value(value))
                    for name, value in parameters.items()]
        if together:
            kind = services.SetParametersAtomically
            return self.call(kind, f'{node}/set_parameters_atomically',
                             kind.Request(parameters=messages)).result
        kind = services.SetParameters
        results = self.call(kind, f'{node}/set_parameters', kind.Request(parameters=messages))
        return results.results[0] if len(messages) == 1 else results.results

    def get(self, node, name):
        """Return the value of one parameter; None if there is no such."""
        kind = services.GetParameters
        values = self.call(kind, f'{node}/get_parameters', kind.Request(names=[name])).values
        if not values:
            return None
        value = values[0]
        return {PARAMETER.PARAMETER_DOUBLE: value.double_value,
                PARAMETER.PARAMETER_STRING: value.string_value,
                PARAMETER.PARAMETER_INTEGER: value.integer_value}.get(value.type)


def as_value(value):
    """Return a Python value as the ParameterValue of its own type."""
    fields = {bool: ('BOOL', 'bool_value'), int: ('INTEGER', 'integer_value'),
              float: ('DOUBLE', 'double_value'), str: ('STRING', 'string_value'),
              list: ('DOUBLE_ARRAY', 'double_array_value'), type(None): ('NOT_SET', None)}
    name, field = fields[type(value)]
    message = interfaces.ParameterValue(type=getattr(PARAMETER, f'PARAMETER_{name}'))
    if field:
        setattr(message, field, value)
    return message


def stamp_of(message):
    """Return the stamp of a JointState, or that in the labels of an array [ns]."""
    if hasattr(message, 'header'):
        return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    labels = [dim.label for dim in message.layout.dim if dim.label.startswith('stamp:')]
    return int(labels[0].removeprefix('stamp:')) if labels else None


def joint_state(stamp, position=(0.0,) * 4, *, names=NAMES, velocity=None):
    """Return a JointState of ``stamp`` [ns]; at rest unless a velocity is given."""
    message = JointState(name=list(names), position=list(position),
                         velocity=[0.0] * len(position) if velocity is None else list(velocity))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message


def array_message(data, *labels):
    """Return a Float64MultiArray of ``data`` with a dimension of size 1 for each label."""
    message = Float64MultiArray(data=[float(value) for value in data])
    message.layout.dim = [std_msgs.MultiArrayDimension(label=label, size=1, stride=1)
                          for label in labels]
    return message


def traceback_free(*processes):
    """Return whether no process printed a traceback."""
    return not any('Traceback' in process.printed() for process in processes)


INT, TERM = signal.SIGINT, signal.SIGTERM
