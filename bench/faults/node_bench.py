# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Real node processes on a ROS domain of their own, and a probing node that talks to them."""

from contextlib import contextmanager, ExitStack
import fcntl
import os
from pathlib import Path
import random
import socket
import subprocess
import tempfile
import time

from gms_flex_control.errors import GmsFlexError
from gms_flex_control.experiment.driven import executable, ros_arguments
from gms_flex_control.file_io import share_path
import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

PATIENCE = 60.0  # for whatever has to come, kernels that must be compiled included [s]
DISCOVERY = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
COMMANDS, STATES, REFERENCE = '/effort_controller/commands', '/joint_states', '/reference'
DIAGNOSTICS = '/diagnostics'
_HEARD = Path(__file__).with_name('local_sockets_heard.xml')  # it hears what it publishes
_WAIT = 0.02  # at most between two looks at a condition [s]
_LOOP = ('plant_node', 'controller_node', 'trajectory_node', 'loop_node')
_QUEUE = 5000  # what Fast DDS keeps at most: of more it refuses the newest, not the oldest


class WaitedInVain(GmsFlexError, AssertionError):
    """Something that had to come did not."""


def config(name):
    """Return the path of one of the package's own parameter files."""
    return share_path() / 'config' / name


def default_files():
    """Return robot and controller files of the package."""
    return config('robot.yaml'), config('controller.yaml')


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
    raise WaitedInVain('every ROS domain is in use')


class NodeProcess:
    """One process of its own; what it prints goes to the file ``log``."""

    def __init__(self, command, environment, log):
        self.log = log
        with log.open('wb') as output:
            self.process = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL,
                                            stdout=output, stderr=subprocess.STDOUT)

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


class Bench:
    """
    A private domain with node processes in it and a probing node in this process.

    Logs go to ``folder``; ``priority`` is the realtime_priority of the nodes of the loop. The
    ``executor_class`` is that of the probing node: EventsExecutor is faster, but does not say when
    a message was published, as `rigs.Log` asks.
    """

    executor_class = SingleThreadedExecutor

    def __init__(self, folder, priority=0):
        self._priority = priority
        self.folder, self._stack, self._processes = Path(folder), ExitStack(), []
        self._clients = {}

    def __enter__(self):
        self.domain, lock = take_domain()
        self._stack.callback(lock.close)
        self._stack.enter_context(_variable(DISCOVERY, 'LOCALHOST'))
        self.environment = dict(
            os.environ, ROS_DOMAIN_ID=str(self.domain), PYTHONUNBUFFERED='1',
            PYTHONPATH=os.environ.get('PYTHONPATH', ''), ROS_LOG_DIR=str(self.folder))
        self._context = None
        return self

    @property
    def node(self):
        """Return the probing node; made when it is first asked for."""
        if self._context is None:
            self._context = rclpy.Context()
            with _environment_kept():
                # a segment of shared memory that a killed process has half made stops all others
                os.environ.update(FASTRTPS_DEFAULT_PROFILES_FILE=str(_HEARD),
                                  FASTDDS_BUILTIN_TRANSPORTS='UDPv4')
                os.environ[DISCOVERY] = 'SYSTEM_DEFAULT'  # the profile finds this machine only
                rclpy.init(context=self._context, domain_id=self.domain,
                           signal_handler_options=SignalHandlerOptions.NO)
                self._node = rclpy.create_node('probe', context=self._context,
                                               enable_rosout=False,
                                               start_parameter_services=False)
            self._executor = self.executor_class(context=self._context)
            self._executor.add_node(self._node)
        return self._node

    def __exit__(self, *_):
        for process in self._processes:
            process.kill()
        if self._context is not None:
            for client in self._clients.values():
                self._node.destroy_client(client)
            self._executor.remove_node(self._node)
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.try_shutdown()
        self._stack.close()

    def another(self):
        """Return a Bench on a domain of its own, with the same environment otherwise."""
        folder = self.folder / f'{len(list(self.folder.iterdir()))}'
        folder.mkdir()
        return type(self)(folder, self._priority)

    def run(self, command, name):
        """Start any command as a process and return it."""
        self._processes.append(
            NodeProcess(command, self.environment, self.folder / f'{name}.log'))
        return self._processes[-1]

    def start(self, name, *, command=None, files=None, arguments=(), **parameters):
        """
        Start a node, ``name`` such as ``plant_node``; what follows a '.' only separates two.

        ``command`` (list of str) runs instead of the installed executable, ``arguments`` are more
        of the command line, ``files`` parameter files, by default `default_files`; ``parameters``
        are those of the node, with '__' for '.'.
        """
        given = {key.replace('__', '.'): value for key, value in parameters.items()}
        if name.split('.')[0] in _LOOP:
            given.setdefault('realtime_priority', self._priority)
        files = default_files() if files is None else files
        return self.run([*(command or executable(name.split('.')[0])),
                         *ros_arguments(files, given), *arguments], name)

    def listen(self, kind, topic, received=None):
        """
        Return a list that takes every message on ``topic``.

        Another object may take them: by ``append(message)``, or by ``take(message, info)``,
        where ``info`` holds the time of publishing.
        """
        received = [] if received is None else received
        self.node.create_subscription(
            kind, topic, getattr(received, 'take', received.append), QoSProfile(depth=_QUEUE),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))
        return received

    def speak(self, kind, topic):
        """Return a publisher."""
        return self.node.create_publisher(kind, topic, 1000)

    def spin(self, timeout=_WAIT):
        """Handle what has come, or wait for it so long [s]."""
        assert self.node is not None
        self._executor.spin_once(timeout_sec=timeout)

    def until(self, condition, bound=PATIENCE):
        """Handle messages until ``condition()`` is true; return its value, fail in the end."""
        assert self.node is not None
        end = time.monotonic() + bound
        while not (value := condition()):
            if time.monotonic() > end:
                raise WaitedInVain(f'waited in vain for {bound:g} s' + ''.join(
                    f'\n{process.log.name}:\n{process.printed()}'
                    for process in self._processes))
            self.spin()
        return value

    def more(self, received, count):
        """Wait until ``received`` has ``count`` messages more than now; return those."""
        have = len(received)
        self.until(lambda: len(received) >= have + count)
        return received[have:have + count]

    def client(self, kind, name):
        """Return the client of a service; the same one for the same name."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        return self._clients[name]

    def call(self, kind, name, request=None):
        """Call a service and return its answer."""
        client = self.client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(request or kind.Request())
        self.until(future.done)
        return future.result()


@contextmanager
def _environment_kept():
    """Undo at the end of the block what it changes of the environment."""
    before = dict(os.environ)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextmanager
def _variable(name, value):
    """Set an environment variable for the time of the block."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
