# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What a thread asks of the operating system: when it runs, and for how long at a time."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import ctypes
import os
import platform
import threading
import time

WAY_OUT = 'allow rtprio in /etc/security/limits.conf'  # where no priority is permitted
_PR_SET_TIMERSLACK = 29
_SCHED_SETATTR = {'x86_64': 314, 'aarch64': 274}  # numbers of the system call
# slices of time: the shortest there is, and one that lets those with the shortest go first [ns]
SHORT, LATER = 100_000, 1_000_000
_NICE = 10


class _SchedAttr(ctypes.Structure):
    """``struct sched_attr`` of sched_setattr(2), in its first version."""

    _fields_ = [('size', ctypes.c_uint32), ('policy', ctypes.c_uint32),
                ('flags', ctypes.c_uint64), ('nice', ctypes.c_int32),
                ('priority', ctypes.c_uint32), ('runtime', ctypes.c_uint64),
                ('deadline', ctypes.c_uint64), ('period', ctypes.c_uint64)]


def shorten_slices(time_slice=SHORT) -> None:
    """
    Ask for short slices of time, for this thread and all that it starts from now on (Linux).

    Whoever asks for less at a time is let run sooner when it wakes, at no cost to the shares:
    Linux from 6.12 on does so without any privilege, an older one takes no notice.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if (platform.system() != 'Linux' or number is None
            or os.sched_getscheduler(0) != os.SCHED_OTHER):
        return
    wanted = _SchedAttr(size=ctypes.sizeof(_SchedAttr), policy=os.SCHED_OTHER,
                        nice=os.getpriority(os.PRIO_PROCESS, 0), runtime=time_slice)
    ctypes.CDLL(None).syscall(number, 0, ctypes.byref(wanted), 0)


@contextmanager
def interrupting_nobody() -> Iterator:
    """
    Let this thread, and those it starts, wait for a processor that is free meanwhile (Linux).

    One that is woken by each message of a loop would otherwise interrupt the loop at each of them.
    Its share of a busy machine stays as it is.
    """
    usual = platform.system() == 'Linux' and os.sched_getscheduler(0) == os.SCHED_OTHER
    if usual:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    try:
        yield
    finally:
        if usual:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def tighten_timers() -> None:
    """Let sleeps of this thread end when asked, not within the usual 50 us (Linux)."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


def sleep_until(deadline) -> None:
    """Sleep until ``deadline`` [ns] by time.monotonic_ns."""
    left = deadline - time.monotonic_ns()
    if left > 0:
        time.sleep(left * 1e-9)


def give_way() -> None:
    """Let this thread run where the loop leaves time, as one of nice 10 (Linux)."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)


def take_priority(node, priority) -> None:
    """Let all threads of this process go before others, by SCHED_FIFO 1 to 99, where permitted."""
    if not priority:
        return
    try:
        for thread in os.listdir('/proc/self/task'):
            with suppress(ProcessLookupError):  # it has just ended
                os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError) as error:
        node.get_logger().warning(
            f'no realtime_priority {priority}: {error}; {WAY_OUT} or set it to 0')
