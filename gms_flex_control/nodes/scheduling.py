# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How soon the operating system lets a thread of the loop run: slices, timers, priorities."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import ctypes
import os
import platform
import signal
import threading

LAUNCHED = 'GMS_FLEX_LAUNCHED'  # set in the environment of what our launch files start
_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29
_SCHED_SETATTR = {'x86_64': 314, 'aarch64': 274}  # numbers of the system call
_SLICE = 100_000   # the shortest there is [ns]
_NICE = 10
WAY_OUT = 'allow rtprio in /etc/security/limits.conf'  # where no priority is permitted


class _SchedAttr(ctypes.Structure):
    """``struct sched_attr`` of sched_setattr(2), in its first version."""

    _fields_ = [('size', ctypes.c_uint32), ('policy', ctypes.c_uint32),
                ('flags', ctypes.c_uint64), ('nice', ctypes.c_int32),
                ('priority', ctypes.c_uint32), ('runtime', ctypes.c_uint64),
                ('deadline', ctypes.c_uint64), ('period', ctypes.c_uint64)]


def shorten_slices():
    """
    Ask for short slices of time, for this thread and all that it starts from now on (Linux).

    Whoever asks for little at a time is let run sooner when it wakes, at no cost to the shares:
    Linux from 6.12 on does so without any privilege, an older one takes no notice.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if (platform.system() != 'Linux' or number is None
            or os.sched_getscheduler(0) != os.SCHED_OTHER):
        return
    wanted = _SchedAttr(size=ctypes.sizeof(_SchedAttr), policy=os.SCHED_OTHER,
                        nice=os.getpriority(os.PRIO_PROCESS, 0), runtime=_SLICE)
    ctypes.CDLL(None).syscall(number, 0, ctypes.byref(wanted), 0)


def tighten_timers():
    """Let sleeps of this thread end when asked, not within the usual 50 us (Linux)."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


def give_way():
    """Let this thread run where the loop leaves time, as one of nice 10 (Linux)."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)


def end_with_launch():
    """
    Let this process get SIGTERM when the launch that started it has ended (Linux).

    A launch that fails half-way, or is killed, leaves what it has started without an end.
    """
    if LAUNCHED in os.environ:
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def is_permitted(priority):
    """
    Return whether this process may take a priority of SCHED_FIFO.

    Parameters
    ----------
    priority : int
        1 to 99.

    Returns
    -------
    bool
        As a thread of its own finds out, which ends at once.

    """
    try:
        with ThreadPoolExecutor(1) as pool:
            pool.submit(_begin_fifo, 0, priority).result()
    except (OSError, AttributeError):
        return False
    return True


def _begin_fifo(thread, priority):
    os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))


def take_priority(node, priority):
    """
    Let all threads of this process go before others; those that begin later inherit it.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose log says it where that is not possible; the node goes on without.
    priority : int
        Of SCHED_FIFO, 1 to 99; 0 leaves everything as it is.

    """
    if not priority:
        return
    try:
        for thread in os.listdir('/proc/self/task'):
            with suppress(ProcessLookupError):  # it has just ended
                _begin_fifo(int(thread), priority)
    except (OSError, AttributeError) as error:
        node.get_logger().warning(
            f'no realtime_priority {priority}: {error}; {WAY_OUT} or set it to 0')
