# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Timing that survives a shared machine: interleaved repetitions, and their median."""

from dataclasses import dataclass
from statistics import median
from time import perf_counter


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """
    One figure of a benchmark.

    Parameters
    ----------
    suite : str
        Which part of the benchmark it belongs to.
    name : str
        What was measured.
    value : float
        The figure.
    unit : str
        Its unit.
    target : float, optional
        What it should reach.
    at_least : bool
        Whether larger is better.
    note : str
        How to read it.

    """

    suite: str
    name: str
    value: float
    unit: str
    target: float | None = None
    at_least: bool = True
    note: str = ''

    @property
    def verdict(self):
        """Return 'ok' or 'missed', or '' without a target."""
        if self.target is None:
            return ''
        reached = self.value >= self.target if self.at_least else self.value <= self.target
        return 'ok' if reached else 'missed'


def interleaved(cases, repetitions):
    """
    Time several functions in turn, so that a busy moment hits all of them.

    Parameters
    ----------
    cases : mapping of str to callable
        Each is called once unmeasured first, which compiles what must be compiled.
    repetitions : int
        Rounds.

    Returns
    -------
    dict of str to float
        Median duration of one call [s].

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
