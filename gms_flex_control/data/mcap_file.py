# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Scan an mcap file from front to back, trusting nothing that can be checked.

The index at the end is not needed, so a file whose recorder was killed reads as far as it
goes; what fails a check is counted and named, never passed on and never dropped in silence.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
import mmap
import struct
from typing import NamedTuple
import zlib

from gms_flex_control.data.metadata import Definition
from gms_flex_control.errors import BagError
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from zstandard import ZstdError

_MAGIC = b'\x89MCAP0\r\n'
_MESSAGE = struct.Struct('<BQHIQQ')
_READERS = {opcode: getattr(records, opcode.name.title().replace('_', '')).read
            for opcode in Opcode if opcode not in (Opcode.MESSAGE, Opcode.MESSAGE_INDEX)}
_FOOTER_SIZE = 20
_IS_MESSAGE = int(Opcode.MESSAGE)
_MALFORMED = (McapError, ValueError, struct.error, UnicodeDecodeError, OverflowError,
              MemoryError, RuntimeError, EOFError)
_FRAME = struct.Struct('<BQ')
_CHUNK_HEAD = struct.Struct('<QQQII')
_INDEX_HEAD = struct.Struct('<HI')
_INDEX_ENTRY = 16        # bytes: time and place of one message
_WINDOW = 8 * 1024 ** 2  # what of a mapped file is resident at once [bytes]


class Window:
    """Let go of what was read of a mapped file, for its pages count as memory of the process."""

    def __init__(self, data):
        self._data, self._start = data, 0

    def reach(self, at) -> None:
        """Say that what is before byte ``at`` is done with."""
        if at - self._start >= _WINDOW and hasattr(self._data, 'madvise'):
            end = at - at % mmap.PAGESIZE
            self._data.madvise(mmap.MADV_DONTNEED, self._start, end - self._start)
            self._start = end


def checksum(data, end) -> int:
    """Return the CRC-32 of the first ``end`` bytes of a mapped file."""
    value, window = 0, Window(data)
    for at in range(0, end, _WINDOW):
        value = zlib.crc32(data[at:min(at + _WINDOW, end)], value)
        window.reach(min(at + _WINDOW, end))
    return value


def _index_entries(data, at, size):
    """Return how many messages the index record at ``at`` names, None if it is malformed."""
    if size < _INDEX_HEAD.size:
        return None
    _, length = _INDEX_HEAD.unpack_from(data, at + _FRAME.size)
    entries = -(-length // _INDEX_ENTRY)
    return entries if size == _INDEX_HEAD.size + entries * _INDEX_ENTRY else None


def _summary_is_sound(footer, data, at):
    """Return whether the index before the footer record at ``at`` has its checksum."""
    start = footer.summary_start
    return 0 < start <= at and zlib.crc32(memoryview(data)[start:at + 25]) == footer.summary_crc


def _is_chunk(data, at, size):
    """Return whether the chunk record at ``at`` has lengths that agree with each other."""
    if size < _CHUNK_HEAD.size + 8:
        return False
    _, _, uncompressed, _, name = _CHUNK_HEAD.unpack_from(data, at + 9)
    if name not in (0, 3, 4) or size < _CHUNK_HEAD.size + name + 8:
        return False
    inner, = struct.unpack_from('<Q', data, at + 9 + _CHUNK_HEAD.size + name)
    return (inner + name + _CHUNK_HEAD.size + 8 == size
            and (name > 0 or inner == uncompressed))


def _next_sound(data, start):
    """Return where the next chunk or the end of the data begins, None if there is none."""
    end_mark = data.find(_FRAME.pack(Opcode.DATA_END, 4), start)
    at = data.find(b'\x06', start)
    while at != -1 and (end_mark == -1 or at < end_mark):
        if at + 9 <= len(data):
            _, size = _FRAME.unpack_from(data, at)
            if at + 9 + size <= len(data) and _is_chunk(data, at, size):
                return at
        at = data.find(b'\x06', at + 1)
    return None if end_mark == -1 else end_mark


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    type_name: str
    described: Definition
    qos: str | None  # YAML text of the offered profiles


@dataclass
class Damage:
    """Something a check refused."""

    where: str        # which file and chunk
    reason: str
    lost: int | None  # messages that cannot be had back, None if nobody knows

    def __str__(self):
        """Return where, why and how much was lost, as text."""
        lost = {None: 'an unknown number of messages', 1: '1 message'}.get(
            self.lost, f'{self.lost} messages')
        return f'{self.where}: {self.reason}; ' + (
            f'{lost} lost' if self.lost != 0 else 'no message lost')


class StorageFile:
    """A file of a bag; what it found is complete once its `batches` have ended."""

    def __init__(self, path, original=None):
        self.path, self._original = path, original or path
        self.label = self._original.name
        self.topics = {}      # Topics by name
        self.damage = []      # Damage: what failed a check
        self.notes = []       # what a reader should know though nothing failed (str)
        self.checked = self.unchecked = 0  # parts whose checksum was compared, or that have none
        self.complete = False  # the file has its proper end
        self.found = 0         # whole messages met, whatever their topic
        self._only = None

    def batches(self, only=None) -> Iterator:
        """
        Yield the messages in file order, in lists of (topic, log time [ns], publish time, bytes).

        Only those of the topics ``only``, a set of str, but everything is checked all the same.
        BagError if the file is empty, cannot be read or is of another kind.
        """
        raise NotImplementedError

    def _damaged(self, where, reason, lost):
        damage = Damage(f'{self.label}: {where}' if where else self.label, reason, lost)
        self.damage.append(damage)
        return damage


class McapFile(StorageFile):
    """One mcap file; messages name ``original``, where ``path`` was unpacked from it."""

    def __init__(self, path, original=None):
        super().__init__(path, original)
        self._schemas, self._channels = {}, {}
        self._indexed = self._chunks = 0
        self._announced = None
        self._loose = 0           # messages outside of chunks
        self._open_damage = None  # damage of the chunk whose index records follow
        self._unknown = {}        # messages of each channel without a name

    def batches(self, only=None) -> Iterator:
        """Yield the messages as `StorageFile` says, what fails a check left out."""
        self._only = only
        try:
            with open(self.path, 'rb') as stream:
                if not stream.seek(0, 2):
                    raise BagError(f'{self._original}: is empty (0 bytes)')
                with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    yield from self._scan(data)
        except OSError as error:
            raise BagError(f'{self._original}: cannot be read ({error.strerror})') from error

    def _scan(self, data):
        self._check_magic(data)
        self._read_topics(data)
        at, window = len(_MAGIC), Window(data)
        while not self.complete:
            window.reach(at)
            frame = self._frame(data, at)
            if frame is None:
                resumed = _next_sound(data, at + 1)
                if resumed is None:
                    yield self._cut_off(data, at)
                    break
                self._damaged('the records', f'bytes {at} to {resumed} make no sense', None)
                at = resumed
                continue
            opcode, end = frame
            if opcode == Opcode.CHUNK:
                yield self._chunk(data[at + 9:end], at)
            elif opcode == Opcode.MESSAGE:
                self._loose += 1
                messages, count, _ = self._messages(data[at:end])
                self.found += count
                yield messages
            else:
                self._record(opcode, data, at, end)
            at = end
        self._reckon()

    def _check_magic(self, data):
        alike = sum(a == b for a, b in zip(data[:len(_MAGIC)], _MAGIC, strict=False))
        if alike < min(len(_MAGIC) - 1, len(data)):
            raise BagError(f'{self._original}: is no mcap file (begins with '
                           f'{data[:len(_MAGIC)].hex(" ")})')
        if len(data) >= len(_MAGIC) and alike < len(_MAGIC):
            self._damaged('the first bytes', f'read {data[:len(_MAGIC)].hex(" ")}', 0)

    def _read_topics(self, data):
        """Take the topics from a sound index: their first mention may be in a bad chunk."""
        at = len(data) - len(_MAGIC) - _FOOTER_SIZE - 9
        if at < 0 or data[at] != Opcode.FOOTER:
            return
        footer = self._parse(Opcode.FOOTER, data[at + 9:at + 9 + _FOOTER_SIZE])
        if footer is None or not footer.summary_crc or not _summary_is_sound(footer, data, at):
            return
        start = footer.summary_start
        while start < at:
            frame = self._frame(data, start)
            if frame is None:
                return
            opcode, end = frame
            self._announcement(opcode, data[start + _FRAME.size:end])
            start = end

    def _frame(self, data, at):
        """Return (opcode, end) of the record at ``at``, None if there is no whole sound one."""
        if at + 9 > len(data):
            return None
        opcode, size = _FRAME.unpack_from(data, at)
        end = at + 9 + size
        if end > len(data):
            return None
        if opcode == Opcode.CHUNK:
            return (opcode, end) if _is_chunk(data, at, size) else None
        if opcode == Opcode.MESSAGE:
            return (opcode, end) if size >= 22 else None
        sound = _index_entries(data, at, size) if opcode == Opcode.MESSAGE_INDEX else \
            self._parse(opcode, data[at + 9:end])
        return (opcode, end) if sound is not None else None

    def _parse(self, opcode, body):
        if opcode not in _READERS or (opcode == Opcode.FOOTER and len(body) != _FOOTER_SIZE):
            return None
        stream = ReadDataStream(BytesIO(body))
        try:
            record = _READERS[opcode](stream)
        except _MALFORMED:
            return None
        return record if stream.count == len(body) else None

    def _record(self, opcode, data, at, end):
        if opcode == Opcode.MESSAGE_INDEX:
            entries = _index_entries(data, at, end - at - _FRAME.size)
            self._indexed += entries
            if self._open_damage is not None:
                self._open_damage.lost = (self._open_damage.lost or 0) + entries
            return
        self._open_damage = None
        if self._announcement(opcode, data[at + 9:end]):
            return
        record = self._parse(opcode, data[at + 9:end])
        if opcode == Opcode.STATISTICS:
            self._announced = record.message_count
        elif opcode == Opcode.DATA_END:
            expected = record.data_section_crc
            if expected and checksum(data, at) != expected and not self.damage:
                # chunks carry their own checksums: what they hold is sound
                self._damaged('the records between the chunks', 'fail the checksum of the file',
                              None if self._loose or self.unchecked else 0)
        elif opcode == Opcode.FOOTER:
            self._check_summary(record, data, at)
            self.complete = True

    def _check_summary(self, footer, data, at):
        if footer.summary_crc and not _summary_is_sound(footer, data, at):
            self._announced = None
            self._damaged('the index at the end', 'fails its checksum', 0)
        elif data[at + 9 + _FOOTER_SIZE:] != _MAGIC:
            self._damaged('the last bytes', 'are not those of an mcap file', 0)

    def _add_channel(self, channel):
        if channel.id in self._channels:
            return
        schema = self._schemas.get(channel.schema_id)
        described = Definition('', channel.metadata.get('topic_type_hash', ''))
        if schema is not None:
            described = Definition(schema.data.decode(errors='replace'),
                                   described.type_hash, schema.encoding)
        self._channels[channel.id] = channel.topic
        self.topics.setdefault(channel.topic, Topic(
            channel.topic, schema.name if schema else '', described,
            channel.metadata.get('offered_qos_profiles')))

    def _chunk(self, body, at):
        self._chunks += 1
        name = f'chunk {self._chunks} (at byte {at})'
        self._open_damage = None
        try:
            chunk = records.Chunk.read(ReadDataStream(BytesIO(body)))
            stream, size = get_chunk_data_stream(chunk, validate_crc=True)
            content = stream.read(size)
            if len(content) != chunk.uncompressed_size:
                raise ValueError(f'has {len(content)} bytes of {chunk.uncompressed_size}')
        except CRCValidationError:
            self._open_damage = self._damaged(name, 'fails its checksum', None)
            return []
        except (*_MALFORMED, ZstdError) as error:  # lz4 raises RuntimeError
            self._open_damage = self._damaged(name, f'cannot be read ({error})', None)
            return []
        messages, count, end = self._messages(content)
        if end < len(content):
            self._open_damage = self._damaged(name, f'makes no sense from byte {end} on', None)
            return []
        if chunk.uncompressed_crc:
            self.checked += 1
        else:
            self.unchecked += 1
        self.found += count
        return messages

    def _messages(self, content):
        """Return a chunk's wanted messages, how many there are, and where sense ended."""
        messages, count, at, size = [], 0, 0, len(content)
        topics, only = self._channels, self._only
        while at + _FRAME.size <= size:
            if at + _MESSAGE.size <= size:
                opcode, length, channel, _, log, publish = _MESSAGE.unpack_from(content, at)
            else:
                opcode, length = _FRAME.unpack_from(content, at)
            end = at + _FRAME.size + length
            if end > size:
                break
            if opcode == _IS_MESSAGE and length >= 22:
                topic = topics.get(channel)
                if topic is None:
                    self._unknown[channel] = self._unknown.get(channel, 0) + 1
                else:
                    count += 1
                    if only is None or topic in only:
                        messages.append((topic, log, publish, content[at + _MESSAGE.size:end]))
            elif not self._announcement(opcode, content[at + _FRAME.size:end]):
                break
            at = end
        return messages, count, at

    def _announcement(self, opcode, body):
        """Read a schema or channel; return whether it is one."""
        record = self._parse(opcode, body) if opcode in (Opcode.SCHEMA, Opcode.CHANNEL) else None
        if opcode == Opcode.SCHEMA and record is not None:
            self._schemas.setdefault(record.id, record)
        elif record is not None:
            self._add_channel(record)
        return record is not None

    def _cut_off(self, data, at):
        """Return the whole messages of the chunk the file ends in."""
        messages, count, note = [], 0, ''
        head = at + 9 + _CHUNK_HEAD.size
        if head + 8 <= len(data) and data[at] == Opcode.CHUNK:
            if not _CHUNK_HEAD.unpack_from(data, at + 9)[4]:
                messages, count, _ = self._messages(data[head + 8:])
            self.found += count
            self.unchecked += bool(count)
            note = (f', in the middle of a chunk: its first {count} messages are whole '
                    'but could not be checked')
        self.notes.append(f'{self.label}: ends without its index after {self.found} messages '
                          f'(recorder killed, or file cut off){note}')
        return messages

    def _reckon(self):
        """Compare what was found with what the file says it holds."""
        for channel, count in self._unknown.items():
            self._damaged(f'channel {channel}', 'its name and type are lost', count)
        expected = max(self._announced or 0, self._indexed)
        open_ended = [item for item in self.damage if item.lost is None]
        missing = expected - self.found - sum(item.lost or 0 for item in self.damage)
        if open_ended and self._announced is not None:
            open_ended[0].lost = max(missing, 0)
            for item in open_ended[1:]:
                item.lost = 0
        elif missing > 0 and not open_ended:
            self._damaged('somewhere', f'{expected} messages were announced and '
                          f'{self.found} found', missing)
