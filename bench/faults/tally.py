# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""One row of the fault table: what is tried, what is required, what was found."""

from collections.abc import Callable
from dataclasses import dataclass, field

HELD, FAILED = 'held', 'FAILED'


@dataclass
class Tally:
    """What the tries of one fault found."""

    tries: int = 0  # so many have begun
    worst: float | None = None  # largest figure; None if nothing was measured
    problems: list = field(default_factory=list)  # what was not as required, in sentences
    notes: list = field(default_factory=list)  # what else a reader should know

    def figure(self, value):
        """Take one measured figure."""
        self.worst = value if self.worst is None else max(self.worst, value)

    def expect(self, condition, sentence):
        """Note ``sentence`` as a problem unless ``condition`` holds."""
        if not condition:
            self.problems.append(sentence)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault and how it is tried."""

    name: str  # for the command line
    fault: str  # the row of the table
    required: str
    figure: str  # what is measured
    limit: float  # largest figure allowed
    unit: str  # of figure and limit
    tries: tuple  # how often, shortened and in full
    run: Callable  # gets a Bench, the number of tries and a Tally to fill


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row of the table, filled in; the first fields as in Fault."""

    name: str
    fault: str
    required: str
    figure: str
    unit: str
    limit: float
    tries: int  # how often it was tried
    worst: float | None  # largest figure
    verdict: str  # 'held' where everything was as required, else 'FAILED'
    problems: tuple  # what was not
    notes: tuple  # what else there is to know
    seconds: float  # how long it took
    priority: int  # realtime_priority of the nodes


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
