# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""One row of the fault table: what is tried, what is required, what was found."""

from collections.abc import Callable
from dataclasses import dataclass, field

HELD, FAILED = 'held', 'FAILED'


@dataclass
class Tally:
    """
    What the tries of one fault found.

    Parameters
    ----------
    tries : int
        So many have begun.
    worst : float or None
        Largest figure; None if nothing was measured.
    problems : list of str
        What was not as required, in sentences.
    notes : list of str
        What else a reader should know.

    """

    tries: int = 0
    worst: float | None = None
    problems: list = field(default_factory=list)
    notes: list = field(default_factory=list)

    def figure(self, value):
        """Take one measured figure."""
        self.worst = value if self.worst is None else max(self.worst, value)

    def expect(self, condition, sentence):
        """Note ``sentence`` as a problem unless ``condition`` holds."""
        if not condition:
            self.problems.append(sentence)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """
    One fault and how it is tried.

    Parameters
    ----------
    name : str
        For the command line.
    fault, required : str
        The row of the table.
    figure : str
        What is measured.
    limit : float
        Largest figure allowed.
    unit : str
        Of figure and limit.
    tries : tuple of int
        How often, shortened and in full.
    run : callable
        Gets a Bench, the number of tries and a Tally to fill.

    """

    name: str
    fault: str
    required: str
    figure: str
    limit: float
    unit: str
    tries: tuple
    run: Callable


@dataclass(frozen=True, kw_only=True)
class Row:
    """
    One row of the table, filled in.

    Parameters
    ----------
    name, fault, required, figure, unit : str
        As in Fault.
    limit : float
        As in Fault.
    tries : int
        How often it was tried.
    worst : float or None
        Largest figure.
    verdict : {'held', 'FAILED'}
        Whether everything was as required.
    problems, notes : tuple of str
        What was not, and what else there is to know.
    seconds : float
        How long it took.
    priority : int
        realtime_priority of the nodes.

    """

    name: str
    fault: str
    required: str
    figure: str
    unit: str
    limit: float
    tries: int
    worst: float | None
    verdict: str
    problems: tuple
    notes: tuple
    seconds: float
    priority: int


def judged(fault, tally, seconds, priority=0):
    """Return the Row of a Fault from the Tally of its tries."""
    problems = list(tally.problems)
    if tally.worst is not None and not tally.worst <= fault.limit:
        problems.append(f'{fault.figure} {tally.worst:.4g} {fault.unit}, the limit is '
                        f'{fault.limit:g} {fault.unit}')
    if not tally.tries:
        problems.append('it was not tried')
    return Row(name=fault.name, fault=fault.fault, required=fault.required, figure=fault.figure,
               unit=fault.unit, limit=fault.limit, tries=tally.tries, worst=tally.worst,
               verdict=FAILED if problems else HELD, problems=tuple(problems),
               notes=tuple(tally.notes), seconds=seconds, priority=priority)
