# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Read a bag as a recording: states, and what was asked and estimated at each of them."""

from collections.abc import Sequence
from typing import NamedTuple

from gms_flex_control.data.bag import Bag, namespace_of
from gms_flex_control.data.recording import Recording, Topics
from gms_flex_control.data.series import names_of, Series
from gms_flex_control.errors import BagError
import numpy as np


class Aside(NamedTuple):
    """The messages of a topic as they are."""

    topic: str       # its name in the bag
    type_name: str   # its type, '' where the bag has no such topic
    messages: list   # of bytes


def read_recording(path, joints: Sequence[str] | None = None, motors: Sequence[str] | None = None,
                   *, topics: Topics | None = None) -> Recording:
    """
    Read one experiment from a bag of `ros2 bag record` or of this package.

    Parameters
    ----------
    path : str or Path
        Bag folder or file: mcap or sqlite3, plain or zstd, also one cut off.
    joints : sequence of str, optional
        Link names in the order of the command; by default those of the first joint state
        that are not the motor of another, in its order.
    motors : sequence of str, optional
        Motor name of each joint, '' where there is no motor side; by default
        ``<joint>_motor`` where the first joint state has it. A link whose motor alone is in the
        states has no angles (NaN).
    topics : Topics, optional
        Topic names; by default those of our nodes, in the namespace they were recorded in.

    Returns
    -------
    Recording
        Sampled at the joint states; the command of a state is the one that carries its stamp,
        the reference that of the same time.

    Raises
    ------
    BagError
        If the bag is damaged, or lacks the joint states, a joint or a length that fits.

    Warns
    -----
    BagWarning
        If the bag was cut off or otherwise odd, and what that means.

    """
    return read_beside(path, joints, motors, topics=topics)[0]


def read_beside(path, joints=None, motors=None, *, topics=None, aside=()) -> tuple:
    """
    Read one experiment, and the messages of further topics as they are.

    As `read_recording`; ``aside`` names topics of any type, in the namespace of the others. Return
    the Recording, its first stamp [ns], and an Aside for each of these names (dict).
    """
    bag = Bag(path)
    space = namespace_of(bag)
    topics = topics or Topics().within(space)
    further = {space + name: [] for name in aside}
    series = Series(bag, topics, joints, motors)
    series.collect(further)
    if not bag.sound:
        first = next(item for item in bag.damage if item.lost != 0)
        raise BagError(f"{path}: {first}; run 'gms_flex repair {path}' to keep the rest")
    series.require_names()
    bag.warn()
    joints, motors = series.resolved()
    series.note_others(joints, motors)
    begin, columns = _columns(path, series, motors)
    return (Recording(joints=joints, source=str(path), **columns), begin,
            {name: Aside(space + name, bag.type_of(space + name), further[space + name])
             for name in aside})


def joint_names(path) -> tuple:
    """Return the names in the first joint state of a bag; BagError if there is none."""
    bag = Bag(path)
    topics = Topics().within(namespace_of(bag))
    for batch in bag.batches({topics.joint_states}):
        for *_, message in batch:
            return names_of(bag, message, topics)
    return names_of(bag, None, topics)


def _columns(path, series, motors):
    """Return the first stamp [ns], and the arrays of the Recording by name."""
    stamps, received, order = series.clock()
    if len(stamps) < 2:
        raise BagError(f'{path}: {series.topics.joint_states} has {len(stamps)} joint state of '
                       'these joints; a recording needs at least 2')
    period = float(np.median(np.diff(stamps)))
    columns = {'time': (stamps - stamps[0]) * 1e-9}
    columns['q_link'], columns['q_motor'] = series.states('position', order)
    columns['dq_link'], columns['dq_motor'] = series.states('velocity', order)
    columns['tau_motor'] = np.where([not name for name in motors],
                                    *series.states('effort', order))
    columns['command'] = series.commands(stamps, received, period)
    columns['reference'] = series.reference(stamps, received, period)
    columns['friction_hat'] = series.friction(stamps)
    columns['supply'] = series.supply(stamps, received)
    return int(stamps[0]), columns
