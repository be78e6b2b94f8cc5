# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What a thread asks of the operating system, read back from it."""

from concurrent.futures import ThreadPoolExecutor
import ctypes
import os
import platform

from gms_flex_control.nodes import scheduling
import pytest

SCHED_GETATTR = {'x86_64': 315, 'aarch64': 275}


def slice_of_this_thread():
    """Return the slice that Linux reports [ns], 0 where it knows of none."""
    size = 48
    words = (ctypes.c_uint64 * (size // 8))()
    number = SCHED_GETATTR[platform.machine()]
    assert ctypes.CDLL(None).syscall(number, 0, words, size, 0) == 0
    return words[3]  # size and policy, flags, nice and priority, runtime


@pytest.mark.skipif(platform.system() != 'Linux' or platform.machine() not in SCHED_GETATTR,
                    reason='slices are those of Linux')
def test_a_slice_is_short_in_this_thread_and_in_those_it_starts_and_nowhere_else():
    before = slice_of_this_thread()
    if not before:
        pytest.skip('this Linux is older than 6.12: it reports no slices')

    def shortened():
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        scheduling.shorten_slices()
        assert os.getpriority(os.PRIO_PROCESS, 0) == nice
        with ThreadPoolExecutor(1) as started:
            return slice_of_this_thread(), started.submit(slice_of_this_thread).result()
    with ThreadPoolExecutor(1) as other:
        assert other.submit(shortened).result() == (100_000, 100_000)
    assert slice_of_this_thread() == before


@pytest.mark.skipif(platform.system() != 'Linux', reason='policies are those of Linux')
def test_who_interrupts_nobody_keeps_its_share_and_leaves_other_threads_alone():
    def policy():
        return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
    usual = policy()

    def changed():
        with scheduling.interrupting_nobody(), ThreadPoolExecutor(1) as started:
            found = policy(), started.submit(policy).result()
        return *found, policy()
    with ThreadPoolExecutor(1) as other:
        *within, after = other.submit(changed).result()
    assert within == [(os.SCHED_BATCH, usual[1])] * 2 and after == usual
    assert policy() == usual
