# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Write a bag that survives its writer: chunks closed, checked and flushed as time goes by."""

from collections.abc import Sequence
from contextlib import suppress
import os
from pathlib import Path
import shutil
import time

from gms_flex_control.data import cdr, metadata
from gms_flex_control.data.metadata import definition
from gms_flex_control.data.recording import MOTOR_SUFFIX, Recording, Topics
from gms_flex_control.errors import BagError
from gms_flex_control.file_io import as_yaml, make_folder, write_text
from mcap.writer import CompressionType, Writer
import numpy as np


class BagWriter:
    """
    Write one rosbag2 folder with mcap storage; use it in a ``with`` statement.

    ``path`` is the folder to be made, ``topics`` the type of each by name; more can follow by
    `add_topic`. An ``atomic`` bag is written under another name and takes ``path`` when the block
    succeeds; any other is there from the start and keeps what was written whatever happens. At
    most ``flush_period`` of wall time [s] passes between writes that leave messages in memory. A
    chunk is closed above ``chunk_size`` bytes: a flipped bit costs one at most. ``custom`` (dict
    of str) are remarks for the metadata. BagError if anything is there or the disk refuses.
    """

    def __init__(self, path, topics=None, *, atomic=False, flush_period=0.1,
                 chunk_size=256 * 1024, custom=None):
        self.path = Path(path)
        self._final = self.path.resolve()
        self._topics = dict(topics or {})
        self._atomic = atomic
        self._flush_period = flush_period
        self._chunk_size = chunk_size
        self.custom = dict(custom or {})
        self._stream, self._broken = None, False
        self._channels, self._schemas = {}, {}  # (number, TopicEntry) by topic, schema by type
        self.counts = {}                        # messages by topic
        self._span = metadata.NEVER, 0          # first and last receive time [ns]

    @property
    def _folder(self):
        hidden = f'.{self._final.name}.{os.getpid()}'
        return self._final.with_name(hidden) if self._atomic else self._final

    def __enter__(self):
        """Make the folder and begin its first file; raise BagError where that cannot be."""
        if not self._final.name:
            raise BagError(f'{self.path}: cannot be the name of a bag; give a new folder')
        refuse_existing(self.path)
        try:
            make_folder(self._final.parent, self.path)
            self._folder.mkdir()
        except FileExistsError:
            raise _exists(self.path) from None
        except OSError as error:
            raise self._failure(error) from error
        try:
            self._open()
        except BaseException:
            self._abandon()
            raise
        return self

    def _open(self):
        try:
            self._stream = open(self._folder / f'{self._final.name}_0.mcap', 'xb')
            # no compression: a chunk cut off by a power failure can be read up to the cut
            self._mcap = Writer(self._stream, chunk_size=self._chunk_size,
                                compression=CompressionType.NONE,
                                enable_crcs=True, enable_data_crcs=True)
            self._mcap.start(profile='ros2')
            self._add_metadata()
            self._stream.flush()
            self._flushed = time.monotonic()
            for name, type_name in self._topics.items():
                self.add_topic(name, type_name, save=False)
            self._save_metadata()
        except OSError as error:
            raise self._failure(error) from error

    def add_topic(self, name, type_name, *, qos=None, save=True) -> None:
        """Announce a topic, if new, with a `metadata.qos_profile`; ``save`` writes metadata."""
        if name in self._channels:
            return
        if not name.startswith('/'):
            raise BagError(f'{self.path}: topic {name!r} has no leading slash; write /{name}')
        described = definition(type_name)
        qos = metadata.qos_profile() if qos is None else qos
        if type_name not in self._schemas:
            self._schemas[type_name] = self._mcap.register_schema(
                type_name, 'ros2msg', described.text.encode())
        number = self._mcap.register_channel(
            name, 'cdr', self._schemas[type_name],
            {'offered_qos_profiles': as_yaml([qos]),
             'topic_type_hash': described.type_hash})
        self._channels[name] = number, metadata.TopicEntry(
            name, type_name, described.type_hash, qos, 0)
        self.counts[name] = 0
        if save:
            self._save_metadata()

    def write(self, topic, time_ns, data) -> None:
        """
        Write one CDR message of an announced topic, received at a time [ns].

        BagError if the topic was not announced or the disk refuses.
        """
        try:
            channel, _ = self._channels[topic]
        except KeyError:
            raise BagError(f'{self.path}: topic {topic!r} was not announced '
                           f'(has {", ".join(self._channels) or "none"})') from None
        if time_ns < 0:
            raise BagError(f'{self.path}: {topic} has the time {time_ns} ns; '
                           'a bag holds none before 1970')
        try:
            self._mcap.add_message(channel, time_ns, data, time_ns,
                                   self.counts[topic] & 0xFFFFFFFF)
        except OSError as error:
            self._broken = True
            raise self._failure(error) from error
        self.counts[topic] += 1
        first, last = self._span
        self._span = min(first, time_ns), max(last, time_ns)
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Hand what is written to the system, where kill -9 leaves it, once a flush period."""
        if time.monotonic() - self._flushed < self._flush_period:
            return
        try:
            self._mcap.flush()
        except OSError as error:
            self._broken = True
            raise self._failure(error) from error
        self._flushed = time.monotonic()

    def __exit__(self, kind, value, trace):
        """End the bag; an ``atomic`` one gets its name, or is removed after an exception."""
        if self._atomic and kind is not None:
            self._abandon()
            return
        try:
            self._close()
            if self._atomic:
                refuse_existing(self.path)
                os.rename(self._folder, self._final)
        except (OSError, BagError) as error:
            self._release()
            if self._atomic:
                self._abandon()
            if kind is None:
                raise (self._failure(error) if isinstance(error, OSError) else error) from error

    def _close(self):
        if self._broken:
            # the disk refused: what is on it is a bag without its end
            self._release()
            self._save_metadata()
            return
        self._mcap.flush()
        self._add_metadata()
        self._mcap.finish()
        self._stream.close()
        self._save_metadata(final=True)

    def _release(self):
        """Close the file without writing what its buffer could not."""
        if not self._stream.closed:
            with suppress(OSError):
                raw = self._stream.detach()
                raw.close()

    def _abandon(self):
        if self._stream is not None:
            with suppress(ValueError):
                self._release()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _metadata(self, final=False):
        entries = [entry._replace(count=self.counts[name] if final else 0)
                   for name, (_, entry) in self._channels.items()]
        return metadata.information(entries, f'{self._final.name}_0.mcap', *self._span,
                                    self.custom)

    def _add_metadata(self):
        self._mcap.add_metadata('rosbag2', {'serialized_metadata': as_yaml(self._metadata())})

    def _save_metadata(self, final=False):
        write_text(self._folder / 'metadata.yaml',
                   as_yaml({'rosbag2_bagfile_information': self._metadata(final)}))

    def _failure(self, error):
        kept = '' if self._atomic or self._stream is None else (
            '; what was flushed is kept and can be read')
        return BagError(f'{self.path}: cannot be written ({error.strerror or error}){kept}')


def refuse_existing(path) -> None:
    """Raise BagError if anything is where a bag is to be made."""
    if os.path.lexists(Path(path).resolve()):
        raise _exists(path)


def _exists(path):
    return BagError(f'{path}: exists already; bags are never overwritten, '
                    'give another name or remove it first')


def write_recording(path, recording: Recording, motors: Sequence[str] | None = None, *,
                    topics: Topics | None = None, start: int = 0, source: str = 'gms_flex',
                    custom: dict | None = None, phases: Sequence = ()) -> None:
    """
    Write a recording as a bag, whole or not at all; receive times are the stamps themselves.

    ``path`` is the folder to be made; a topic all of whose values are NaN is left out. ``motors``
    has the motor name of each joint, '' for a rigid one, by default ``<joint>_motor`` where the
    motor angle is known. ``start`` is the stamp of the first sample [ns], ``source`` who answers,
    in the label of each command, ``custom`` remarks kept in the metadata, ``phases`` what an
    identification experiment was doing. BagError if the folder exists or the disk refuses.
    """
    topics = topics or Topics()
    stamps = start + np.rint(np.asarray(recording.time) * 1e9).astype(np.int64)
    if motors is None:
        known = ~np.all(np.isnan(recording.q_motor), axis=0)
        motors = [name + MOTOR_SUFFIX if there else ''
                  for name, there in zip(recording.joints, known, strict=True)]
    series = list(_series(recording, motors, stamps, topics, source))
    types = {name: type_name for name, type_name, _ in series}
    types |= {cdr.PHASE_TOPIC: cdr.MULTI_ARRAY} if phases else {}
    beginning = {}  # phases by the sample they begin with, those after the end by the last
    for phase in sorted(phases, key=lambda phase: phase.time_ns):
        phase = phase._replace(time_ns=start + phase.time_ns)
        k = min(int(np.searchsorted(stamps, phase.time_ns)), len(stamps) - 1)
        beginning.setdefault(k, []).append(cdr.pack_phase(phase))
    with BagWriter(path, types, atomic=True, custom=custom) as writer:
        for k, stamp in enumerate(stamps.tolist()):
            for message in beginning.get(k, ()):
                writer.write(cdr.PHASE_TOPIC, stamp, message)
            for name, _, messages in series:
                if messages[k] is not None:
                    writer.write(name, stamp, messages[k])


def _series(recording, motors, stamps, topics, source):
    sides = [k for k, name in enumerate(motors) if name]
    rigid = [k for k, name in enumerate(motors) if not name]
    link_effort = np.full(recording.q_link.shape, np.nan)
    link_effort[:, rigid] = recording.tau_motor[:, rigid]
    # a motor stands for its joint where nobody sees the link
    seen = [k for k, name in enumerate(motors) if not name or recording.links_seen[k]]
    names = (*(recording.joints[k] for k in seen), *(motors[k] for k in sides))
    yield topics.joint_states, cdr.JOINT_STATE, cdr.pack_joint_states(
        names, stamps, np.hstack([recording.q_link[:, seen], recording.q_motor[:, sides]]),
        np.hstack([recording.dq_link[:, seen], recording.dq_motor[:, sides]]),
        np.hstack([link_effort[:, seen], recording.tau_motor[:, sides]]))
    for topic, values, pack in (
            (topics.reference, recording.reference, cdr.pack_reference),
            (topics.command, recording.command, lambda torque, stamp: cdr.pack_command(
                torque.tolist(), stamp, source)),
            (topics.supply, recording.supply, cdr.pack_supply)):
        if not np.all(np.isnan(values)):
            yield topic, cdr.MULTI_ARRAY, [
                None if np.all(np.isnan(value)) else pack(value, stamp)
                for value, stamp in zip(values, stamps.tolist(), strict=True)]
    if not np.all(np.isnan(recording.friction_hat)):
        error = recording.q_link - recording.reference[:, 0]
        rate = recording.dq_link - recording.reference[:, 1]
        yield topics.controller_state, cdr.JOINT_STATE, cdr.pack_joint_states(
            recording.joints, stamps, error, rate, recording.friction_hat)
