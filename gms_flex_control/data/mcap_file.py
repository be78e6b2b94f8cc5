# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Scan an mcap file from front to back; a file whose recorder was killed reads as far as it goes.

A chunk that fails its checksum is left out and named.
"""

from collections.abc import Iterator
from io import BytesIO
import struct

from gms_flex_control.data import metadata  # noqa: F401  it says what to install
from gms_flex_control.errors import BagError
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from zstandard import ZstdError

_MAGIC = b'\x89MCAP0\r\n'
_FRAME = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<BQHIQQ')
_CHUNK_HEAD = struct.Struct('<QQQII')
_OPCODES = frozenset(map(int, Opcode))
_IS_MESSAGE = int(Opcode.MESSAGE)
_READERS = {Opcode.SCHEMA: records.Schema.read, Opcode.CHANNEL: records.Channel.read,
            Opcode.STATISTICS: records.Statistics.read}
_MALFORMED = (McapError, ValueError, struct.error, UnicodeDecodeError, OverflowError,
              MemoryError, RuntimeError, EOFError)


class StorageFile:
    """A file of a bag; what it found is complete once its `batches` have ended."""

    def __init__(self, path, original=None):
        self.path, self._original = path, original or path
        self.label = self._original.name
        self.topics = {}       # type by name
        self.damage = []       # what cannot be read (str)
        self.notes = []        # what a reader should know though nothing failed (str)
        self.complete = False  # the file has its proper end
        self.found = 0         # whole messages met, whatever their topic
        self._only = None

    def batches(self, only=None) -> Iterator:
        """
        Yield the messages in file order, in lists of (topic, log time [ns], publish time, bytes).

        Only those of the topics ``only``, a set of str. BagError if the file is empty, cannot be
        read or is of another kind.
        """
        raise NotImplementedError


class McapFile(StorageFile):
    """One mcap file; messages name ``original``, where ``path`` was unpacked from it."""

    def __init__(self, path, original=None):
        super().__init__(path, original)
        self._schemas, self._channels = {}, {}
        self._chunks, self._announced = 0, None

    def batches(self, only=None) -> Iterator:
        """Yield the messages as `StorageFile` says, what fails a checksum left out."""
        self._only = only
        try:
            with open(self.path, 'rb') as stream:
                length = stream.seek(0, 2)
                if not length:
                    raise BagError(f'{self._original}: is empty (0 bytes)')
                stream.seek(0)
                magic = stream.read(len(_MAGIC))
                if not _MAGIC.startswith(magic):
                    raise BagError(f'{self._original}: is not an mcap file (begins with '
                                   f'{magic.hex(" ")})')
                self._read_topics(stream)
                yield from self._scan(stream, length)
        except OSError as error:
            raise BagError(f'{self._original}: cannot be read ({error.strerror})') from error

    def _read_topics(self, stream):
        """Take the topics from the index, if any: their first mention may be in a bad chunk."""
        stream.seek(0)
        try:
            summary = make_reader(stream).get_summary()
        except (*_MALFORMED, OSError):
            return
        if summary is not None:
            self._schemas |= summary.schemas
            for channel in summary.channels.values():
                self._add_channel(channel)

    def _scan(self, stream, length):
        at = stream.seek(len(_MAGIC))
        while not self.complete:
            head = stream.read(_FRAME.size)
            opcode, size = _FRAME.unpack(head) if len(head) == _FRAME.size else (-1, 0)
            end = at + _FRAME.size + size
            if opcode not in _OPCODES or end > length:
                yield self._cut_off(opcode, stream)
                break
            body = stream.read(size)
            if opcode == Opcode.CHUNK:
                yield self._chunk(body, at)
            elif opcode == Opcode.MESSAGE:
                yield self._messages(head + body)[0]
            else:
                self._record(opcode, body)
                self.complete = opcode == Opcode.FOOTER
            at = end
        if self._announced not in (None, self.found) and not self.damage:
            self.damage.append(f'{self.label}: {self._announced} messages were announced, '
                               f'{self.found} found')

    def _record(self, opcode, body):
        """Take a schema, channel or statistics; return whether it is a schema or channel."""
        if opcode not in _READERS:
            return False
        try:
            record = _READERS[opcode](ReadDataStream(BytesIO(body)))
        except _MALFORMED:
            return False
        if opcode == Opcode.STATISTICS:
            self._announced = record.message_count
            return False
        if opcode == Opcode.SCHEMA:
            self._schemas.setdefault(record.id, record)
        else:
            self._add_channel(record)
        return True

    def _add_channel(self, channel):
        if channel.id in self._channels:
            return
        schema = self._schemas.get(channel.schema_id)
        self._channels[channel.id] = channel.topic
        self.topics.setdefault(channel.topic, schema.name if schema else '')

    def _chunk(self, body, at):
        self._chunks += 1
        try:
            chunk = records.Chunk.read(ReadDataStream(BytesIO(body)))
            stream, size = get_chunk_data_stream(chunk, validate_crc=True)
            content = stream.read(size)
            if len(content) != chunk.uncompressed_size:
                raise ValueError(f'has {len(content)} bytes of {chunk.uncompressed_size}')
        except (*_MALFORMED, ZstdError) as error:  # lz4 raises RuntimeError
            reason = ('fails its checksum' if isinstance(error, CRCValidationError)
                      else f'cannot be read ({error})')
            self.damage.append(f'{self.label}: chunk {self._chunks} (at byte {at}) {reason} and '
                               'is left out')
            return []
        messages, end = self._messages(content)
        if end < len(content):
            self.damage.append(f'{self.label}: chunk {self._chunks} (at byte {at}) makes no sense '
                               f'from byte {end} on')
        return messages

    def _messages(self, content):
        """Return the wanted messages of a chunk or a cut one, and where sense ended."""
        messages, at, size = [], 0, len(content)
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
                if topic is not None:
                    self.found += 1
                    if only is None or topic in only:
                        messages.append((topic, log, publish, content[at + _MESSAGE.size:end]))
            elif not self._record(opcode, content[at + _FRAME.size:end]):
                break
            at = end
        return messages, at

    def _cut_off(self, opcode, stream):
        """Return the whole messages of the chunk the file ends in, its head read already."""
        messages, head = [], stream.read(_CHUNK_HEAD.size)
        if opcode == Opcode.CHUNK and len(head) == _CHUNK_HEAD.size and not _CHUNK_HEAD.unpack(
                head)[4]:
            messages, _ = self._messages(stream.read()[8:])
        self.notes.append(f'{self.label}: ends without its index after {self.found} messages '
                          '(still being written, recorder killed, or file cut off)')
        return messages
