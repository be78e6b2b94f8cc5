# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How each node process starts, spins and ends: zero torque on the wire, exit code 0."""

from contextlib import suppress
import ctypes
import gc
import re
import signal
import sys
import threading

from gms_flex_control.errors import GmsFlexError
import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.experimental import EventsExecutor
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

BAD_INPUT = 2
_PR_SET_TIMERSLACK = 29
# without QoS events: their callbacks can deadlock the EventsExecutor
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)


def publisher_qos(mode):
    """
    Return the quality of service of what we publish: anyone can subscribe to it.

    In lockstep a recorder may fall behind by many samples before it catches up.
    """
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000 if mode == 'lockstep' else 10,
                      reliability=ReliabilityPolicy.RELIABLE)


def subscriber_qos(mode):
    """
    Return the quality of service we subscribe with.

    Best effort costs the loop no acknowledgements in real time; in lockstep every message is
    waited for. Ten messages deep, so that a short stall loses none; stale ones are told by
    their stamp.
    """
    reliability = (ReliabilityPolicy.RELIABLE if mode == 'lockstep'
                   else ReliabilityPolicy.BEST_EFFORT)
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=reliability)


def tighten_timers():
    """Let sleeps of this thread end when asked, not within the usual 50 us (Linux)."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


def _interrupt(_number, _frame):
    # a second signal, which ros2 launch sends, must not interrupt the last zero
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def run_node(make_node, args=None):
    """
    Run one node until SIGINT or SIGTERM.

    Parameters
    ----------
    make_node : callable
        Returns the node; it has ``run(executor)``, which blocks, and ``finish()``, which
        publishes what must be last.
    args : list of str, optional
        Command line; default ``sys.argv``.

    Returns
    -------
    int
        0 after a signal, 2 if parameters or arguments were refused.

    """
    sys.setswitchinterval(5e-4)  # a busy thread may delay the loop by this, not by 5 ms
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    node = None
    try:
        with suppress(KeyboardInterrupt):
            # own handlers: with rclpy's, a node cannot publish any more when SIGTERM came
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            node = make_node()
            executor = EventsExecutor()
            executor.add_node(node)
            gc.freeze()  # what start-up left is never searched again while the loop runs
            node.run(executor)
    except GmsFlexError as error:
        return _refuse(error)
    except RuntimeError as error:  # rcl: a parameter file or argument it cannot read
        if node is not None:
            raise
        sentence = re.sub(r', at /\S+:\d+', '', str(error))  # leave out places in rcl's sources
        return _refuse(f'arguments or parameter file refused: {sentence}')
    finally:
        if node is not None:
            node.finish()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _refuse(error):
    print(f'{sys.argv[0].rsplit("/", 1)[-1]}: {error}', file=sys.stderr, flush=True)
    return BAD_INPUT


def spin(executor):
    """Run callbacks in this thread, which the executor's own spin does not do."""
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.1)


class BackgroundSpin:
    """Run callbacks in a second thread while the first one keeps deadlines."""

    def __init__(self, executor):
        self._executor = executor
        self._stop = threading.Event()
        self.error = None
        self._thread = threading.Thread(target=self._spin, name='executor', daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def _spin(self):
        try:
            while rclpy.ok() and not self._stop.is_set():
                self._executor.spin_once(timeout_sec=0.1)
        except Exception as error:  # noqa: B902  the first thread raises it again
            self.error = error

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join(timeout=1.0)
