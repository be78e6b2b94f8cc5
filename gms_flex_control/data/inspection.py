# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What is in a bag and whether its checksums hold; make a sound bag of a damaged one."""

from dataclasses import dataclass
from pathlib import Path

from gms_flex_control.data.bag import Bag
from gms_flex_control.data.cdr import JOINT_STATE, unpack_joint_state
from gms_flex_control.data.metadata import definition
from gms_flex_control.data.writer import BagWriter
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
    checksums: str  # 'hold', 'none in the bag', 'hold where there are any' or 'damaged'
    damage: tuple   # what failed a check (str)
    notes: tuple    # what else a reader should know (str)
    sound: bool     # no message is known or feared to be lost
    complete: bool  # the bag was closed properly and nothing failed

    def text(self) -> str:
        """Return a table for people."""
        lines = [f'bag        {self.path}', f'messages   {self.count}']
        if self.count:
            lines.append(f'duration   {self.duration:.3f} s from {self.start:.3f} s')
        lines.append(f'checksums  {self.checksums}')
        lines.append('state      ' + (
            'complete' if self.complete else
            'usable, not closed properly' if self.sound else 'damaged: gms_flex repair it'))
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
    topics = tuple(_topic(topic, times.get(topic.name, ()), first.get(topic.name))
                   for _, topic in sorted(bag.topics.items()))
    return BagSummary(
        path=str(path), topics=topics, count=sum(map(len, times.values())),
        start=min(every) * 1e-9 if every else None,
        duration=(max(every) - min(every)) * 1e-9 if every else None,
        checksums=_checksums(bag), damage=tuple(map(str, bag.damage)),
        notes=tuple(bag.notes), sound=bag.sound, complete=bag.complete)


def _topic(topic, times, first):
    steps = np.diff(np.sort(times)) * 1e-9
    median = float(np.median(steps)) if len(steps) else 0.0
    joints = ()
    if topic.type_name == JOINT_STATE and first is not None:
        try:
            joints = unpack_joint_state(first)[2]
        except BagError:
            joints = ()
    return TopicSummary(
        name=topic.name, type_name=topic.type_name, count=len(times),
        rate=1.0 / median if median > 0 else None,
        gaps=int(np.sum(steps > _GAP * median)) if median > 0 else 0,
        longest_gap=float(steps.max()) if len(steps) else None, joints=joints)


def _checksums(bag):
    if bag.damage:
        return 'damaged'
    if not bag.checked:
        return 'none in the bag'
    return 'hold where there are any' if bag.unchecked else 'hold'


@dataclass(frozen=True, kw_only=True)
class Repair:
    """What a repair did."""

    source: str       # the bag read
    out: str          # the bag written, '' where there was nothing to repair
    kept: int         # messages in the new bag
    lost: int | None  # messages known to be lost; None if nobody knows how many
    counts: dict      # messages kept per topic
    damage: tuple     # what failed a check (str)
    notes: tuple      # what else was odd (str)

    def text(self) -> str:
        """Return the result for people."""
        lost = 'an unknown number' if self.lost is None else self.lost
        lines = [f'damage: {item}' for item in self.damage]
        lines += [f'note: {item}' for item in self.notes]
        if not self.out:
            return '\n'.join([*lines, f'{self.source}: nothing to repair, all {self.kept} '
                              'messages are there'])
        lines += [f'  {name}  {count}' for name, count in self.counts.items()]
        return '\n'.join([*lines, f'{self.out}: {self.kept} messages kept, {lost} lost'])


def repair_bag(path, out=None) -> Repair:
    """
    Write what is sound in a bag to a new one; the old one is not touched.

    The bag may be killed, cut off, damaged or without metadata.yaml; a message is kept if its
    checksum holds or it has none. ``out`` is by default ``<path>_repaired``. BagError if ``path``
    is no bag at all, holds nothing to keep, or ``out`` exists.
    """
    path = Path(path)
    bare = Path(path.name.removesuffix('.zstd')).stem if path.is_file() else path.name
    default = path.resolve().with_name(f'{bare or path.resolve().name}_repaired')
    out = Path(out) if out is not None else default
    bag = Bag(path)
    # read twice: only the first pass shows whether there is anything to repair
    count = sum(map(len, bag.batches()))
    if bag.complete and not bag.notes:
        return _result(bag, '', count, {})
    if not count and not bag.sound:
        raise BagError(f'{path}: not one message can be kept ({bag.damage[0]})')
    lost = _lost(bag)
    custom = {'repaired_from': path.name, 'lost': 'unknown' if lost is None else str(lost)}
    with BagWriter(out, atomic=True, custom=custom) as writer:
        for topic in bag.topics.values():
            writer.add_topic(topic.name, topic.type_name, described=_described(topic),
                             qos=topic.qos, save=False)
        for batch in Bag(path).batches():
            for name, log, publish, data in batch:
                writer.write(name, log, data, publish)
        counts = dict(writer.counts)
    return _result(bag, str(out), count, counts)


def _described(topic):
    """Return the definition a bag carries, completed where an old one lacks a part."""
    described = topic.described
    if described.text and described.type_hash:
        return described
    try:
        known = definition(topic.type_name)
    except BagError:
        return described
    return known if not described.text else described._replace(type_hash=known.type_hash)


def _lost(bag):
    counts = [item.lost for item in bag.damage]
    return None if None in counts else sum(counts)


def _result(bag, out, kept, counts):
    return Repair(source=str(bag.path), out=out, kept=kept, lost=_lost(bag), counts=counts,
                  damage=tuple(map(str, bag.damage)), notes=tuple(bag.notes))
