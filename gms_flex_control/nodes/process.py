# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""How each of our processes starts, is scheduled, reaches others and ends: with zero torque."""

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack, suppress
import ctypes
from functools import partial
import gc
import os
from pathlib import Path
import re
import signal
import sys
import threading
import time

from gms_flex_control.errors import ConfigError, GmsFlexError
from gms_flex_control.nodes.scheduling import interrupting_nobody, SHORT, shorten_slices
import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.experimental import EventsExecutor
from rclpy.logging import get_logger
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

_BAD_INPUT = 2
_LONG_START = 3.0  # of which it is said that it takes long [s]
_LONGEST_END = 2.0  # of a start that a signal cuts short [s]
# without QoS events: their callbacks can deadlock the EventsExecutor
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
LAUNCHED = 'GMS_FLEX_LAUNCHED'  # set in the environment of what our launch files start
_PR_SET_PDEATHSIG = 1
MOST_KEPT = 5000  # by Fast DDS of a topic, whatever is asked for: of more it takes no newer ones
GOODBYE = Duration(seconds=0.5)  # for the last zero to arrive: a subscriber may be frozen
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_BUILT_IN = 'FASTDDS_BUILTIN_TRANSPORTS'
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_LOCAL, _ANYWHERE = (Path(__file__).with_name(name) for name in ('local_sockets.xml',
                                                                 'sockets.xml'))
_IGNORE_OWN = 'fastdds.ignore_local_endpoints'


def publisher_qos(mode) -> QoSProfile:
    """Return the quality of service of what we publish; in lockstep a recorder may fall behind."""
    return QoSProfile(depth=MOST_KEPT if mode == 'lockstep' else 10,
                      reliability=ReliabilityPolicy.RELIABLE)


def subscriber_qos(mode, depth=10) -> QoSProfile:
    """
    Return the quality of service we subscribe with.

    Best effort costs the loop no acknowledgements in real time; in lockstep every message is
    waited for. Ten messages deep, so that a short stall loses none; stale ones show by
    their stamp. Who must see each of them asks for more.
    """
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE if mode == 'lockstep'
                      else ReliabilityPolicy.BEST_EFFORT)


def _handle_signals(handler):
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


class Spinner:
    """
    Runs the callbacks of the nodes of a process until SIGINT or SIGTERM.

    From the first spin on a signal raises nothing: it would hit a callback, which the executor
    reports as fatal, or the last zero, which a second signal from ros2 launch must not interrupt.
    """

    def __init__(self):
        self._executor = None
        self._failed, self.refused = None, ''  # the latter: why this process has to end
        self.stopped = False  # whether a signal has come
        _handle_signals(self._on_signal)

    def _on_signal(self, _number, _frame):
        starting = self._executor is None and not self.stopped
        self.stopped = True
        if starting:  # there may be seconds of compiling ahead
            # raised in a callback of a library, it is printed there, and the start goes on
            sys.unraisablehook = lambda _: None
            _after(_LONGEST_END, partial(os._exit, 0))
            raise KeyboardInterrupt

    def add(self, *nodes) -> None:
        """Take nodes whose callbacks are run; ``health`` of the first, if any, is notified."""
        health = getattr(nodes[0], 'health', None)
        self._failed = health and health.failed
        self._executor = EventsExecutor()
        for node in nodes:
            if namesakes := getattr(node, 'namesakes', None):  # of a ConfiguredNode
                namesakes.on_elder = self._refuse
            self._executor.add_node(node)

    def _refuse(self, sentence):
        self.refused = sentence

    def goes_on(self) -> bool:
        """Return whether the node is to go on."""
        return not (self.stopped or self.refused) and rclpy.ok()

    def spin_once(self, timeout=0.1) -> None:
        """Run a callback that is due, or wait ``timeout`` seconds for one."""
        self._run(self._executor.spin_once, timeout)

    def spin_for(self, duration=0.1) -> None:
        """
        Run all callbacks that become due within ``duration`` seconds.

        An executor that comes back to Python after each event takes several times as long for
        those that bring nothing, of which a storm makes thousands in a second.
        """
        self._run(partial(self._executor.spin_until_future_complete, Future()), duration)

    def _run(self, spin, timeout):
        try:
            spin(timeout_sec=timeout)
        except Exception as error:  # noqa: B902  an executor goes on after any of them
            if self._failed is None:
                raise
            self._failed(error, 'the executor')

    def attend(self) -> None:
        """Run callbacks for a while, and do what is to be done now and then."""
        self.spin_for()

    def spin(self) -> None:
        """Run callbacks in this thread; the spin of EventsExecutor itself runs none."""
        while self.goes_on():
            self.spin_for()


def run_node(make_node, time_slice=SHORT) -> int:
    """
    Run one node, or several as one, until SIGINT or SIGTERM.

    ``make_node`` returns the node; it has ``run(spinner)``, which returns when
    ``spinner.goes_on()`` is false, and ``finish()``, which publishes what must be last. Several
    have ``nodes``. ``time_slice`` is that of `shorten_slices`. Return the exit code: 0 after a
    signal, 2 if parameters or arguments were refused.
    """
    sys.setswitchinterval(5e-4)  # a busy thread may delay the loop by this, not by 5 ms
    shorten_slices(time_slice)
    avoid_shared_memory()
    spinner, node = Spinner(), None
    end_with_launch()
    try:
        # own handlers: with rclpy's, a node cannot publish any more when SIGTERM came
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        with _patience_asked_for():
            node = make_node()
        spinner.add(*getattr(node, 'nodes', [node]))
        gc.freeze()  # what start-up left is never searched again while the loop runs
        node.run(spinner)
        if spinner.refused:
            return _refuse(spinner.refused)
    except KeyboardInterrupt:
        pass
    except GmsFlexError as error:
        return _refuse(error)
    except RuntimeError as error:
        if node is None and spinner.stopped:
            return 0
        if node is not None:
            raise
        # rcl: a parameter file or argument it cannot read
        sentence = re.sub(r', at /\S+:\d+', '', str(error))  # leave out places in rcl's sources
        way_out = "; a namespace begins with '/'" if '__ns:=' in sentence else ''
        return _refuse(f'arguments or parameter file refused: {sentence}{way_out}')
    finally:
        if node is not None:
            node.finish()
            node.destroy_node()
        rclpy.try_shutdown()
        _handle_signals(signal.SIG_IGN)  # Python resets its own handlers before it ends
    return 0


def _after(seconds, action):
    timer = threading.Timer(seconds, action)
    timer.daemon = True
    timer.start()
    return timer


@contextmanager
def _patience_asked_for():
    """Say what takes so long, should the block do."""
    timer = _after(_LONG_START, partial(
        get_logger(os.path.basename(sys.argv[0])).info,
        'still starting: the first start on a machine compiles the equations, which may take half '
        'a minute; later ones do not'))
    try:
        yield
    finally:
        timer.cancel()


def _refuse(error):
    print(f'{sys.argv[0].rsplit("/", 1)[-1]}: {error}', file=sys.stderr, flush=True)
    return _BAD_INPUT


@contextmanager
def hidden_node(purpose) -> Iterator:
    """Yield a node that lists leave out and its executor; it interrupts nobody."""
    with interrupting_nobody(), ExitStack() as ending:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        ending.callback(rclpy.try_shutdown)
        node = rclpy.create_node(f'_gms_flex_{purpose}_{time.time_ns() % 10**9}',
                                 enable_rosout=False, start_parameter_services=False)
        ending.callback(node.destroy_node)
        executor = EventsExecutor()
        ending.callback(executor.shutdown)
        executor.add_node(node)
        yield node, executor


class BackgroundSpin:
    """Run callbacks in a second thread while the first one keeps deadlines."""

    def __init__(self, spinner):
        self._spinner = spinner
        self._stop = threading.Event()
        self.error = None
        self._thread = threading.Thread(target=self._spin, name='executor', daemon=True)

    def __enter__(self):
        """Begin to spin."""
        self._thread.start()
        return self

    def _spin(self):
        try:
            while rclpy.ok() and not self._stop.is_set():
                self._spinner.attend()
        except Exception as error:  # noqa: B902  the first thread raises it again
            self.error = error

    def __exit__(self, *_):
        """Stop spinning, and wait a second at most for the callback that runs."""
        self._stop.set()
        self._thread.join(timeout=1.0)


def end_with_launch() -> None:
    """Let this process get SIGTERM when the launch that started it has ended or died (Linux)."""
    if LAUNCHED in os.environ:
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


# transport ----------------------------------------------------------------------------------


def avoid_shared_memory() -> None:
    """
    Let the nodes of this process reach others by UDP only; call it before rclpy.init.

    With shared memory Fast DDS stops every writer of a host for one second and more, again and
    again, while any one process of the domain is frozen: too long for a torque to go on. On one
    host UDP is as fast for messages of this size.

    For the range LOCALHOST rmw_fastrtps adds shared memory whatever Fast DDS is set to; there the
    same discovery is described in a profile instead. Other middleware, and profiles or transports
    that the environment names, stay as they are.
    """
    environment = os.environ
    if not _is_fast_dds() or any(name in environment for name in _PROFILES):
        return
    environment[_PROFILES[0]] = str(_ANYWHERE)
    if _BUILT_IN in environment:
        return
    environment[_BUILT_IN] = 'UDPv4'
    only_local = environment.get('ROS_LOCALHOST_ONLY') == '1'
    if (environment.get(RANGE) == 'LOCALHOST' or only_local) and not environment.get(
            'ROS_STATIC_PEERS'):
        environment.pop('ROS_LOCALHOST_ONLY', None)
        environment[RANGE] = 'SYSTEM_DEFAULT'
        environment[_PROFILES[0]] = str(_LOCAL)


def refuse_own_messages() -> None:
    """Raise ConfigError if nodes of this process would hear each other through DDS as well."""
    if not _is_fast_dds():
        raise ConfigError('loop_node needs RMW_IMPLEMENTATION=rmw_fastrtps_cpp, got '
                          f'{rclpy.get_rmw_implementation_identifier()}; start plant_node, '
                          'controller_node and trajectory_node instead')
    profiles = next(os.environ[name] for name in _PROFILES if name in os.environ)
    if _IGNORE_OWN not in Path(profiles).read_text(encoding='utf-8'):
        raise ConfigError(f'loop_node needs the property {_IGNORE_OWN} (true) of the participant '
                          f'in {profiles}; add it, or start plant_node, controller_node and '
                          'trajectory_node instead')


def _is_fast_dds():
    return rclpy.get_rmw_implementation_identifier().startswith('rmw_fastrtps')
