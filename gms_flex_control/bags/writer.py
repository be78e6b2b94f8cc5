# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Write a bag that survives its writer: chunks closed, checked and flushed as time goes by."""

from contextlib import suppress
import os
from pathlib import Path
import shutil
import time

from gms_flex_control.bags import metadata
from gms_flex_control.bags.definitions import definition
from gms_flex_control.errors import BagError
from gms_flex_control.files import make_folder
from mcap.writer import CompressionType, Writer


class BagWriter:
    """
    Write one rosbag2 folder with mcap storage; use it in a ``with`` statement.

    Parameters
    ----------
    path : str or Path
        The folder to be made; anything there already is refused.
    topics : dict of str, optional
        Type of each topic; more can follow by :meth:`add_topic`.
    atomic : bool, optional
        Write under another name and take ``path`` only when the block succeeds; else the bag
        is there from the start and keeps what was written whatever happens.
    flush_period : float, optional
        Longest wall time between writes that leave messages in memory [s].
    chunk_size : int, optional
        A chunk is closed above this many bytes; a flipped bit costs at most one chunk.
    custom : dict of str, optional
        Remarks kept in the metadata.

    Raises
    ------
    BagError
        If ``path`` exists, a type is unknown or the disk refuses.

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
        self._folder = None
        self._channels, self._entries, self.counts = {}, {}, {}
        self._start, self._end = metadata.NEVER, 0
        self._broken = False

    def __enter__(self):
        """Make the folder and begin its first file; raise BagError where that cannot be."""
        if not self._final.name:
            raise BagError(f'{self.path}: is no name for a bag; give a new folder')
        self._refuse_existing()
        self._folder = self._final
        if self._atomic:
            self._folder = self._final.with_name(f'.{self._final.name}.{os.getpid()}')
        try:
            make_folder(self._final.parent, self.path)
            self._folder.mkdir()
        except FileExistsError:
            raise self._exists() from None
        except OSError as error:
            raise self._failure(error) from error
        try:
            self._open()
        except BaseException:
            self._abandon()
            raise
        return self

    def _open(self):
        self._file_name = f'{self._final.name}_0.mcap'
        try:
            self._stream = open(self._folder / self._file_name, 'xb')
            # no compression: a chunk cut off by a power failure can be read up to the cut
            self._mcap = Writer(self._stream, chunk_size=self._chunk_size,
                                compression=CompressionType.NONE,
                                enable_crcs=True, enable_data_crcs=True)
            self._mcap.start(profile='ros2')
            self._schemas = {}
            self._mcap.add_metadata('rosbag2', {'serialized_metadata': self._metadata()})
            self._stream.flush()
            self._flushed = time.monotonic()
            for name, type_name in self._topics.items():
                self.add_topic(name, type_name, save=False)
            self._save_metadata()
        except OSError as error:
            raise self._failure(error) from error

    def add_topic(self, name, type_name, *, described=None, qos=None, save=True):
        """
        Announce a topic; one that is there already stays as it is.

        Parameters
        ----------
        name : str
            Topic name with its leading slash.
        type_name : str
            Message type.
        described : Definition, optional
            Its definition where the caller knows better than the installed packages.
        qos : str, optional
            YAML text of the offered QoS profiles.
        save : bool, optional
            Write metadata.yaml anew.

        """
        if name in self._channels:
            return
        if not name.startswith('/'):
            raise BagError(f'{self.path}: topic {name!r} has no leading slash; write /{name}')
        described = described or definition(type_name)
        qos = metadata.qos_profile() if qos is None else qos
        key = (type_name, described.text)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.register_schema(
                type_name, described.encoding, described.text.encode())
        self._channels[name] = self._mcap.register_channel(
            name, 'cdr', self._schemas[key],
            {'offered_qos_profiles': qos, 'topic_type_hash': described.type_hash})
        self._entries[name] = metadata.TopicEntry(name, type_name, described.type_hash, qos, 0)
        self.counts[name] = 0
        if save:
            self._save_metadata()

    def write(self, topic, time_ns, data, publish_ns=None):
        """
        Write one message.

        Parameters
        ----------
        topic : str
            An announced topic.
        time_ns : int
            Receive time [ns].
        data : bytes
            The message as CDR.
        publish_ns : int, optional
            Send time [ns], ``time_ns`` if not known.

        Raises
        ------
        BagError
            If the topic was not announced or the disk refuses.

        """
        try:
            channel = self._channels[topic]
        except KeyError:
            raise BagError(f'{self.path}: topic {topic!r} was not announced '
                           f'(has {", ".join(self._channels) or "none"})') from None
        if time_ns < 0:
            raise BagError(f'{self.path}: {topic} has the time {time_ns} ns; '
                           'a bag holds none before 1970')
        try:
            self._mcap.add_message(channel, time_ns, data,
                                   time_ns if publish_ns is None else publish_ns,
                                   self.counts[topic] & 0xFFFFFFFF)
            self.counts[topic] += 1
            self._start = min(self._start, time_ns)
            self._end = max(self._end, time_ns)
            if time.monotonic() - self._flushed >= self._flush_period:
                self._flush()
        except OSError as error:
            self._broken = True
            raise self._failure(error) from error

    def flush(self):
        """Close the chunk and hand it to the operating system: kill -9 cannot take it back."""
        try:
            self._flush()
        except OSError as error:
            self._broken = True
            raise self._failure(error) from error

    def flush_if_due(self):
        """Flush if the last time is longer ago than the flush period."""
        if time.monotonic() - self._flushed >= self._flush_period:
            self.flush()

    def _flush(self):
        self._mcap.flush()
        self._flushed = time.monotonic()

    @property
    def message_count(self):
        """Return how many messages were written."""
        return sum(self.counts.values())

    def __exit__(self, kind, value, trace):
        """End the bag; an ``atomic`` one gets its name, or is removed after an exception."""
        if self._atomic and kind is not None:
            self._abandon()
            return
        try:
            self._close()
            if self._atomic:
                self._refuse_existing()
                os.rename(self._folder, self._final)
        except (OSError, BagError) as error:
            self._release()
            if self._atomic:
                self._abandon()
            if kind is None:
                raise (self._failure(error) if isinstance(error, OSError) else error) from error

    def _close(self):
        if self._broken:
            # the disk refused: what is on it is a bag without its end, which repair completes
            self._release()
            self._save_metadata()
            return
        self._mcap.flush()
        self._mcap.add_metadata('rosbag2', {'serialized_metadata': self._metadata()})
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
        if getattr(self, '_stream', None) is not None:
            with suppress(ValueError):
                self._release()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _metadata(self, final=False):
        entries = [entry._replace(count=self.counts[name] if final else 0)
                   for name, entry in self._entries.items()]
        return metadata.render(entries, self._file_name, self._start, self._end, self.custom)

    def _save_metadata(self, final=False):
        path = self._folder / 'metadata.yaml'
        temporary = path.with_suffix('.yaml.tmp')
        try:
            temporary.write_text(metadata.indent_under_root(self._metadata(final)),
                                 encoding='utf-8')
            os.replace(temporary, path)
        except OSError:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise

    def _refuse_existing(self):
        if os.path.lexists(self._final):
            raise self._exists()

    def _exists(self):
        return BagError(f'{self.path}: exists already; bags are never overwritten, '
                        'give another name or remove it first')

    def _failure(self, error):
        kept = '' if self._atomic or self._folder is None else (
            f'; what was flushed is kept, see it with gms_flex repair {self.path}')
        return BagError(f'{self.path}: cannot be written ({error.strerror or error}){kept}')
