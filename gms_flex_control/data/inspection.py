# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What is in a bag and whether its checksums hold; make a sound bag of a damaged one."""

from dataclasses import dataclass

from gms_flex_control.data.bag import Bag
from gms_flex_control.data.cdr import JOINT_STATE, unpack_joint_state
from gms_flex_control.errors import BagError
import numpy as np

_GAP = 2.5  # times the median interval


@dataclass(frozen=True, kw_only=True)
class TopicSummary:
    """One topic of a bag."""

    name: str
    type_name: str
    count: int          # messages
    rate: float | None  # one over the median interval of receive times [Hz]; None below 2
    gaps: int           # intervals longer than _GAP times the median
    longest_gap: float | None  # [s]
    joints: tuple       # names in the first message of a JointState topic


@dataclass(frozen=True, kw_only=True)
class BagSummary:
    """A bag as a whole."""

    path: str
    topics: tuple   # TopicSummary, sorted by name
    count: int      # messages in all
    start: float | None     # first receive time [s]; None for an empty bag
    duration: float | None  # to the last receive time [s]
    damage: tuple   # what cannot be read (str)
    notes: tuple    # what else a reader should know (str)
    complete: bool  # the bag was closed properly and nothing failed

    def text(self) -> str:
        """Return a table for people."""
        lines = [f'bag        {self.path}', f'messages   {self.count}']
        if self.count:
            lines.append(f'duration   {self.duration:.3f} s from {self.start:.3f} s')
        lines.append('state      ' + (
            'complete' if self.complete else
            'damaged' if self.damage else 'usable, not closed properly'))
        width = max((len(topic.name) for topic in self.topics), default=0)
        for topic in self.topics:
            rate = '' if topic.rate is None else f'{topic.rate:9.1f} Hz'
            gaps = f', {topic.gaps} gaps, longest {topic.longest_gap:.3f} s' if topic.gaps else ''
            lines.append(f'  {topic.name:{width}}  {topic.count:8d}  {rate:12}  '
                         f'{topic.type_name}{gaps}')
            if topic.joints:
                lines.append(f'  {"":{width}}  joints: {", ".join(topic.joints)}')
        lines += [f'damage: {item}' for item in self.damage]
        lines += [f'note: {item}' for item in self.notes]
        return '\n'.join(lines)


def summarise(path) -> BagSummary:
    """Return the BagSummary of a bag, also of a damaged one; BagError if it is no bag at all."""
    bag = Bag(path)
    times, first = {}, {}
    for batch in bag.batches():
        for topic, log, _, data in batch:
            times.setdefault(topic, []).append(log)
            first.setdefault(topic, data)
    every = [edge for log in times.values() for edge in (min(log), max(log))]
    topics = tuple(_topic(name, type_name, times.get(name, ()), first.get(name))
                   for name, type_name in sorted(bag.topics.items()))
    return BagSummary(
        path=str(path), topics=topics, count=sum(map(len, times.values())),
        start=min(every) * 1e-9 if every else None,
        duration=(max(every) - min(every)) * 1e-9 if every else None,
        damage=tuple(bag.damage), notes=tuple(bag.notes), complete=bag.complete)


def _topic(name, type_name, times, first):
    steps = np.diff(np.sort(times)) * 1e-9
    median = float(np.median(steps)) if len(steps) else 0.0
    joints = ()
    if type_name == JOINT_STATE and first is not None:
        try:
            joints = unpack_joint_state(first)[2]
        except BagError:
            joints = ()
    return TopicSummary(
        name=name, type_name=type_name, count=len(times),
        rate=1.0 / median if median > 0 else None,
        gaps=int(np.sum(steps > _GAP * median)) if median > 0 else 0,
        longest_gap=float(steps.max()) if len(steps) else None, joints=joints)
