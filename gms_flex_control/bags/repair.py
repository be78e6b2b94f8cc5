# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Make a sound bag out of one that was killed, cut off or damaged, and count what is gone."""

from dataclasses import asdict, dataclass
from pathlib import Path

from gms_flex_control.bags.definitions import definition
from gms_flex_control.bags.source import Bag
from gms_flex_control.bags.writer import BagWriter
from gms_flex_control.errors import BagError


@dataclass(frozen=True, kw_only=True)
class Repair:
    """
    What a repair did.

    Parameters
    ----------
    source, out : str
        The bag read and the one written; ``out`` is empty where there was nothing to repair.
    kept : int
        Messages in the new bag.
    lost : int or None
        Messages known to be lost; None if nobody knows how many.
    counts : dict of int
        Messages kept per topic.
    damage, notes : tuple of str
        What failed a check, and what else was odd.

    """

    source: str
    out: str
    kept: int
    lost: int | None
    counts: dict
    damage: tuple
    notes: tuple

    def as_dict(self):
        """Return plain dicts, lists and numbers for JSON."""
        return asdict(self)

    def text(self):
        """Return the result for people."""
        lost = 'an unknown number' if self.lost is None else self.lost
        lines = [f'damage: {item}' for item in self.damage]
        lines += [f'note: {item}' for item in self.notes]
        if not self.out:
            return '\n'.join([*lines, f'{self.source}: nothing to repair, all {self.kept} '
                              'messages are there'])
        lines += [f'  {name}  {count}' for name, count in self.counts.items()]
        return '\n'.join([*lines, f'{self.out}: {self.kept} messages kept, {lost} lost'])


def repair_bag(path, out=None):
    """
    Write what is sound in a bag to a new one; the old one is not touched.

    Parameters
    ----------
    path : str or Path
        Bag folder or file: killed, cut off, damaged or without metadata.yaml.
    out : str or Path, optional
        The new folder, by default ``<path>_repaired``.

    Returns
    -------
    Repair
        What was kept and lost. A message is kept if its checksum holds or it has none.

    Raises
    ------
    BagError
        If ``path`` is no bag at all, holds nothing to keep, or ``out`` exists.

    """
    path = Path(path)
    bare = Path(path.name.removesuffix('.zstd')).stem if path.is_file() else path.name
    default = path.resolve().with_name(f'{bare or path.resolve().name}_repaired')
    out = Path(out) if out is not None else default
    bag = Bag(path)
    # read twice: only the first pass tells whether there is anything to repair
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
