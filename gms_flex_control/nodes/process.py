# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How each node process starts, spins and ends: zero torque on the wire, exit code 0."""

from contextlib import contextmanager
from functools import partial
import gc
import os
import re
import signal
import sys
import threading

from gms_flex_control.errors import GmsFlexError
from gms_flex_control.nodes.scheduling import end_with_launch, shorten_slices
from gms_flex_control.nodes.transport import avoid_shared_memory
import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.experimental import EventsExecutor
from rclpy.logging import get_logger
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

BAD_INPUT = 2
_LONG_START = 3.0  # of which it is said that it takes long [s]
_LONGEST_END = 2.0  # of a start that a signal cuts short [s]
# without QoS events: their callbacks can deadlock the EventsExecutor
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)


def publisher_qos(mode):
    """
    Return the quality of service of what we publish: anyone can subscribe to it.

    In lockstep a recorder may fall behind by many samples before it catches up.
    """
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000 if mode == 'lockstep' else 10,
                      reliability=ReliabilityPolicy.RELIABLE)


def subscriber_qos(mode, depth=10):
    """
    Return the quality of service we subscribe with.

    Best effort costs the loop no acknowledgements in real time; in lockstep every message is
    waited for. Ten messages deep, so that a short stall loses none; stale ones are told by
    their stamp. Who must see each of them asks for more.
    """
    reliability = (ReliabilityPolicy.RELIABLE if mode == 'lockstep'
                   else ReliabilityPolicy.BEST_EFFORT)
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability)


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
        self._failed = None
        self._stopped = False
        _handle_signals(self._on_signal)

    def _on_signal(self, _number, _frame):
        starting = self._executor is None and not self._stopped
        self._stopped = True
        if starting:  # there may be seconds of compiling ahead
            # raised in a callback of a library, it is printed there, and the start goes on
            sys.unraisablehook = lambda _: None
            _after(_LONGEST_END, partial(os._exit, 0))
            raise KeyboardInterrupt

    @property
    def stopped(self):
        """Return whether a signal has come."""
        return self._stopped

    def add(self, *nodes):
        """Take the nodes whose callbacks are run; ``health`` of the first, if any, is told."""
        health = getattr(nodes[0], 'health', None)
        self._failed = health and health.failed
        self._executor = EventsExecutor()
        for node in nodes:
            self._executor.add_node(node)

    def goes_on(self):
        """Return whether the node is to go on."""
        return not self._stopped and rclpy.ok()

    def spin_once(self, timeout=0.1):
        """Run a callback that is due, or wait ``timeout`` seconds for one."""
        self._run(self._executor.spin_once, timeout)

    def spin_for(self, duration=0.1):
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

    def attend(self):
        """Run callbacks for a while, and do what is to be done now and then."""
        self.spin_for()

    def spin(self):
        """Run callbacks in this thread; the spin of EventsExecutor itself runs none."""
        while self.goes_on():
            self.spin_for()


def run_node(make_node, args=None, *, hears_itself=False):
    """
    Run one node, or several as one, until SIGINT or SIGTERM.

    Parameters
    ----------
    make_node : callable
        Returns the node; it has ``run(spinner)``, which returns when ``spinner.goes_on()`` is
        false, and ``finish()``, which publishes what must be last. Several have ``nodes``.
    args : list of str, optional
        Command line; default ``sys.argv``.
    hears_itself : bool
        Whether it subscribes to what it publishes itself.

    Returns
    -------
    int
        0 after a signal, 2 if parameters or arguments were refused.

    """
    sys.setswitchinterval(5e-4)  # a busy thread may delay the loop by this, not by 5 ms
    shorten_slices()
    avoid_shared_memory(hears_itself)
    spinner, node = Spinner(), None
    end_with_launch()
    try:
        # own handlers: with rclpy's, a node cannot publish any more when SIGTERM came
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        with _patience_asked_for():
            node = make_node()
        spinner.add(*getattr(node, 'nodes', [node]))
        gc.freeze()  # what start-up left is never searched again while the loop runs
        node.run(spinner)
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
        return _refuse(f'arguments or parameter file refused: {sentence}')
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
    return BAD_INPUT


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
