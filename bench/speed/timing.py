# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Timing that survives a shared machine: interleaved repetitions, and their median."""

from dataclasses import dataclass
from statistics import median
from time import perf_counter


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """One figure of a benchmark."""

    suite: str  # which part of the benchmark it belongs to
    name: str  # what was measured
    value: float  # the figure
    unit: str  # its unit
    target: float | None = None  # what it should reach
    at_least: bool = True  # whether larger is better
    note: str = ''  # how to read it

    @property
    def verdict(self):
        """Return 'ok' or 'missed', or '' without a target."""
        if self.target is None:
            return ''
        reached = self.value >= self.target if self.at_least else self.value <= self.target
        return 'ok' if reached else 'missed'


def interleaved(cases, repetitions):
    """
    Return median durations [s] of functions called in turn: a busy moment hits all of them.

    Each of ``cases`` is called once unmeasured first, which compiles what must be compiled.
    """
    for function in cases.values():
        function()
    times = {name: [] for name in cases}
    for _ in range(repetitions):
        for name, function in cases.items():
            begin = perf_counter()
            function()
            times[name].append(perf_counter() - begin)
    return {name: median(values) for name, values in times.items()}
