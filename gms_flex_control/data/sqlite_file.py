# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Read the sqlite3 storage of rosbag2; it has no checksums of its own."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
import shutil
import sqlite3
import tempfile

from gms_flex_control.data.mcap_file import StorageFile, Topic
from gms_flex_control.data.metadata import Definition
from gms_flex_control.errors import BagError

_HEADER = b'SQLite format 3\0'


class SqliteFile(StorageFile):
    """One db3 file, read with the journal or log beside it; nothing is changed."""

    def __init__(self, path, original=None):
        super().__init__(path, original)
        self.unchecked = 1

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
                           f'{self._original}: is no sqlite3 file (begins with {head.hex(" ")})')
        with tempfile.TemporaryDirectory() as folder:
            location = self._settled(Path(folder))
            try:
                with closing(sqlite3.connect(location, uri=True)) as database:
                    yield from self._read(database)
            except sqlite3.Error as error:
                self._damaged('', f'cannot be read ({error})', None)
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
        rows = database.execute('SELECT id, topic_id, timestamp, data FROM messages ORDER BY id')
        last, batch = 0, []
        try:
            for row in rows:
                last = row[0]
                batch.append(row[1:])
                if len(batch) == 2000:
                    yield self._named(batch, names)
                    batch = []
        except sqlite3.Error as error:
            yield self._named(batch, names)
            yield self._named(self._behind(database, last, error), names)
            return
        yield self._named(batch, names)

    def _named(self, rows, names):
        # a damaged page can yield rows of nonsense: without checksums no more can be checked
        good = [(names[topic], time, time, data) for topic, time, data in rows
                if topic in names and isinstance(data, bytes) and len(data) >= 4
                and isinstance(time, int) and time >= 0]
        if len(good) < len(rows):
            self._damaged('', 'rows that are no messages', len(rows) - len(good))
        self.found += len(good)
        return good if self._only is None else [row for row in good if row[0] in self._only]

    def _behind(self, database, last, error):
        """Return the rows behind a damaged page, asked for one by one, and count the others."""
        rows, lost = [], 0
        try:
            end, = database.execute('SELECT max(id) FROM messages').fetchone()
        except sqlite3.Error:
            end, lost = last, None
        for number in range(last + 1, end + 1):
            try:
                rows += database.execute('SELECT topic_id, timestamp, data FROM messages '
                                         'WHERE id = ?', (number,)).fetchall()
            except sqlite3.Error:
                lost += 1
        self._damaged(f'after row {last}', str(error), lost)
        return rows

    def _read_topics(self, database):
        definitions = {}
        if database.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'"
                            ).fetchone():
            for type_name, encoding, text in database.execute(
                    'SELECT topic_type, encoding, encoded_message_definition '
                    'FROM message_definitions'):
                definitions[type_name] = encoding, text
        names = {}
        cursor = database.execute('SELECT * FROM topics')
        columns = [column[0] for column in cursor.description]
        for row in cursor.fetchall():
            row = dict(zip(columns, row, strict=True))
            encoding, text = definitions.get(row['type'], ('ros2msg', ''))
            described = Definition(text, row.get('type_description_hash', ''), encoding)
            names[row['id']] = row['name']
            self.topics.setdefault(row['name'], Topic(
                row['name'], row['type'], described, row.get('offered_qos_profiles')))
        return names
