# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Write a recording as the bag that the nodes' own topics would have made."""

from collections.abc import Sequence

from gms_flex_control.bags.cdr import JOINT_STATE, MULTI_ARRAY, pack_joint_states
from gms_flex_control.bags.messages import pack_command, pack_reference, pack_supply
from gms_flex_control.bags.names import MOTOR_SUFFIX, Topics
from gms_flex_control.bags.phases import pack_phase, PHASE_TOPIC
from gms_flex_control.bags.writer import BagWriter
from gms_flex_control.recording import Recording
import numpy as np


def write_recording(path, recording: Recording, motors: Sequence[str] | None = None, *,
                    topics: Topics | None = None, start: int = 0, source: str = 'gms_flex',
                    custom: dict | None = None, phases: Sequence = ()) -> None:
    """
    Write a recording as a bag, whole or not at all.

    Parameters
    ----------
    path : str or Path
        The folder to be made.
    recording : Recording
        What to write; a topic all of whose values are NaN is left out.
    motors : sequence of str, optional
        Motor name of each joint, '' for a rigid one; by default ``<joint>_motor`` for the
        joints whose motor angle is known.
    topics : Topics, optional
        Topic names.
    start : int, optional
        Stamp of the first sample [ns].
    source : str, optional
        Who answers, in the label of each command.
    custom : dict of str, optional
        Remarks kept in the metadata.
    phases : sequence of Phase, optional
        What an identification experiment was doing.

    Raises
    ------
    BagError
        If ``path`` exists or the disk refuses.

    Notes
    -----
    Receive times are the stamps themselves.

    """
    topics = topics or Topics()
    stamps = start + np.rint(np.asarray(recording.time) * 1e9).astype(np.int64)
    if motors is None:
        known = ~np.all(np.isnan(recording.q_motor), axis=0)
        motors = [name + MOTOR_SUFFIX if there else ''
                  for name, there in zip(recording.joints, known, strict=True)]
    series = list(_series(recording, motors, stamps, topics, source))
    types = {name: type_name for name, type_name, _ in series}
    types |= {PHASE_TOPIC: MULTI_ARRAY} if phases else {}
    waiting = sorted(phases, key=lambda phase: phase.time_ns, reverse=True)
    with BagWriter(path, types, atomic=True, custom=custom) as writer:
        for k, stamp in enumerate(stamps.tolist()):
            while waiting and start + waiting[-1].time_ns <= stamp:
                phase = waiting.pop()
                writer.write(PHASE_TOPIC, stamp, pack_phase(
                    phase._replace(time_ns=start + phase.time_ns)))
            for name, _, messages in series:
                if messages[k] is not None:
                    writer.write(name, stamp, messages[k])
        for phase in reversed(waiting):  # from the sample on that would have come next
            writer.write(PHASE_TOPIC, int(stamps[-1]), pack_phase(
                phase._replace(time_ns=start + phase.time_ns)))


def _series(recording, motors, stamps, topics, source):
    """Yield topic, type and one message (or None) per sample."""
    sides = [k for k, name in enumerate(motors) if name]
    rigid = [k for k, name in enumerate(motors) if not name]
    link_effort = np.full(recording.q_link.shape, np.nan)
    link_effort[:, rigid] = recording.tau_motor[:, rigid]
    names = (*recording.joints, *(motors[k] for k in sides))
    yield topics.joint_states, JOINT_STATE, pack_joint_states(
        names, stamps, np.hstack([recording.q_link, recording.q_motor[:, sides]]),
        np.hstack([recording.dq_link, recording.dq_motor[:, sides]]),
        np.hstack([link_effort, recording.tau_motor[:, sides]]))
    if not np.all(np.isnan(recording.reference)):
        yield topics.reference, MULTI_ARRAY, _packed(
            recording.reference, stamps, pack_reference)
    if not np.all(np.isnan(recording.command)):
        yield topics.command, MULTI_ARRAY, _packed(
            recording.command, stamps,
            lambda torque, stamp: pack_command(torque.tolist(), stamp, source))
    if not np.all(np.isnan(recording.supply)):
        yield topics.supply, MULTI_ARRAY, _packed(recording.supply, stamps, pack_supply)
    if not np.all(np.isnan(recording.friction_hat)):
        error = recording.q_link - recording.reference[:, 0]
        rate = recording.dq_link - recording.reference[:, 1]
        yield topics.controller_state, JOINT_STATE, pack_joint_states(
            recording.joints, stamps, error, rate, recording.friction_hat)


def _packed(values, stamps, pack):
    return [None if np.all(np.isnan(value)) else pack(value, stamp)
            for value, stamp in zip(values, stamps.tolist(), strict=True)]
