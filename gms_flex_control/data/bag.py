# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A bag opened for reading, whatever it is stored in, its storage in sqlite3, and its summary."""

from collections.abc import Iterator
from contextlib import closing, ExitStack
from dataclasses import dataclass
from pathlib import Path
import re
import shutil
import sqlite3
import tempfile
import warnings

from gms_flex_control.data import metadata
from gms_flex_control.data.cdr import JOINT_STATE, unpack_joint_state
from gms_flex_control.data.mcap_file import McapFile, StorageFile
from gms_flex_control.data.recording import Topics
from gms_flex_control.errors import BagError
import numpy as np
import zstandard

_HEADER = b'SQLite format 3\0'


class SqliteFile(StorageFile):
    """One db3 file, read with the journal or log beside it; nothing is changed."""

    def batches(self, only=None) -> Iterator:
        """Yield the messages as `StorageFile` says, in the order they were written."""
        self._only = only
        try:
            with open(self.path, 'rb') as stream:
                head = stream.read(len(_HEADER))
        except OSError as error:
            raise BagError(f'{self._original}: cannot be read ({error.strerror})') from error
        if head != _HEADER:
            raise BagError(f'{self._original}: is empty (0 bytes)' if not head else
                           f'{self._original}: is not an sqlite3 file (begins with '
                           f'{head.hex(" ")})')
        with tempfile.TemporaryDirectory() as folder:
            location = self._settled(Path(folder))
            try:
                with closing(sqlite3.connect(location, uri=True)) as database:
                    yield from self._read(database)
            except sqlite3.Error as error:
                self.damage.append(f'{self.label}: cannot be read whole ({error})')
        self.complete = not self.damage

    def _settled(self, folder):
        """Return a database to open: a copy where a killed recorder left a journal."""
        beside = [self.path.with_name(self.path.name + end) for end in ('-journal', '-wal')]
        if not any(path.is_file() for path in beside):
            return f'{self.path.absolute().as_uri()}?mode=ro&immutable=1'
        for path in (self.path, *beside):
            if path.is_file():
                shutil.copy(path, folder)
        self.notes.append(f'{self.label}: was left open by its recorder; what it had '
                          'committed is read')
        return f'{(folder / self.path.name).as_uri()}?mode=rw'

    def _read(self, database):
        names = self._read_topics(database)
        rows = database.execute('SELECT topic_id, timestamp, data FROM messages ORDER BY id')
        while batch := rows.fetchmany(2000):
            yield self._named(batch, names)

    def _named(self, rows, names):
        # a damaged page can yield rows of nonsense: without checksums no more can be checked
        good = [(names[topic], time, time, data) for topic, time, data in rows
                if topic in names and isinstance(data, bytes) and len(data) >= 4
                and isinstance(time, int) and time >= 0]
        if len(good) < len(rows):
            self.damage.append(f'{self.label}: {len(rows) - len(good)} rows are not messages')
        self.found += len(good)
        return good if self._only is None else [row for row in good if row[0] in self._only]

    def _read_topics(self, database):
        names = {}
        for number, name, type_name in database.execute('SELECT id, name, type FROM topics'):
            names[number] = name
            self.topics.setdefault(name, type_name)
        return names


_STORAGES = {'.mcap': McapFile, '.db3': SqliteFile}
_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # CDR begins with 00 00 or 00 01


class BagWarning(UserWarning):
    """A bag was read, but its reader should know something about it."""


class Bag:
    """A bag folder or one file of it, opened; complete once `batches` ended; BagError if none."""

    def __init__(self, path):
        self.path = Path(path)
        self.topics = {}  # types by name, those of the messages yielded so far
        self.damage = []  # what cannot be read (str)
        self.notes = []   # what a reader should know though nothing failed (str)
        self.complete = False  # metadata and every file have their proper end
        self.metadata = None   # FolderMetadata, if metadata.yaml is there
        self._files = self._locate()

    def _locate(self):
        if not self.path.exists():
            raise BagError(f'{self.path}: there is no such bag; give the folder that '
                           'ros2 bag or gms_flex record made')
        if not self.path.is_dir():
            if not self.path.is_file() or _storage_suffix(self.path) is None:
                raise BagError(f'{self.path}: is not a bag file (expected .mcap or .db3, '
                               'also with .zstd)')
            return [self.path]
        present = sorted((path for path in self.path.iterdir()
                          if path.is_file() and _storage_suffix(path)), key=_split_number)
        if (self.path / 'metadata.yaml').is_file():
            try:
                self.metadata = metadata.load(self.path / 'metadata.yaml')
            except BagError as error:
                self.notes.append(str(error))
        else:
            self.notes.append(f'{self.path}: has no metadata.yaml (recorder killed?)')
        if self.metadata is None:
            files = present
        else:
            files = [self.path / Path(name).name for name in self.metadata.files]
            files += [path for path in present if path not in files]
        if not files:
            raise BagError(f'{self.path}: holds no .mcap or .db3 file; it is not a bag')
        self.damage += [f'{self.path.name}: {path.name} is missing'
                        for path in files if not path.is_file()]
        return [path for path in files if path.is_file()]

    def batches(self, only=None) -> Iterator:
        """Yield messages file by file as `StorageFile.batches`, of topics ``only``; BagError."""
        found, whole = 0, True
        for path in self._files:
            with ExitStack() as stack:
                plain = self._plain(path, stack)
                storage = _STORAGES[plain.suffix](plain, path)
                for batch in storage.batches(None if only is None else frozenset(only)):
                    self.topics = storage.topics | self.topics
                    yield [row if row[3][:4] != _ZSTD_MAGIC else
                           (*row[:3], _decompressed(row[3], path)) for row in batch]
            self.topics = storage.topics | self.topics
            found += storage.found
            self.damage += storage.damage
            self.notes += storage.notes
            whole = whole and storage.complete
        if self.metadata and self.metadata.count > found and not self.damage:
            self.damage.append(f'{self.path.name}: metadata.yaml announces {self.metadata.count} '
                               f'messages, {found} were found')
        self.complete = whole and not self.damage and (
            self.path.is_file() or (self.metadata is not None and self.metadata.count == found))

    def _plain(self, path, stack):
        """Return an uncompressed file with the content of ``path``."""
        if path.suffix != '.zstd':
            return path
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        plain = folder / path.stem
        try:
            with open(path, 'rb') as packed, open(plain, 'wb') as out:
                zstandard.ZstdDecompressor().copy_stream(packed, out)
        except (zstandard.ZstdError, OSError) as error:
            if not plain.stat().st_size:
                raise BagError(f'{path}: cannot be unpacked ({error})') from error
            self.damage.append(f'{path.name}: cannot be unpacked whole ({error})')
        return plain

    def warn(self) -> None:
        """Issue all damage and every note as a BagWarning."""
        for text in (*self.damage, *self.notes):
            warnings.warn(text, BagWarning, stacklevel=3)


def _storage_suffix(path):
    name = path.name.removesuffix('.zstd')
    suffix = Path(name).suffix
    return suffix if suffix in _STORAGES else None


def _split_number(path):
    numbers = re.findall(r'_(\d+)\.', path.name)
    return (int(numbers[-1]) if numbers else -1, path.name)


def _decompressed(data, path):
    try:
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    except zstandard.ZstdError as error:
        raise BagError(f'{path}: a compressed message cannot be unpacked ({error})') from error


def namespace_of(bag) -> str:
    """Return the namespace of the one closed loop in a bag, such as '/left'; '' if left open."""
    plain = Topics()
    names = bag.metadata.topics if bag.metadata else ()
    if plain.joint_states in names:
        return ''
    found = [name.removesuffix(plain.joint_states) for name in names
             if name.endswith(plain.joint_states)]
    looped = [space for space in found if space + plain.command in names]
    one = looped if looped else found
    return one[0] if len(one) == 1 else ''


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
