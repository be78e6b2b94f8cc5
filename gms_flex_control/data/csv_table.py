# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Text tables as written by anything: named columns of numbers that know their lines."""

from array import array
import csv
from itertools import chain, islice
from pathlib import Path

from gms_flex_control.errors import did_you_mean, ImportDataError
import numpy as np


class CsvTable:
    """
    A UTF-8 table of numbers read into memory, laid out as a FileFormat says.

    ``names`` are its columns ('1', '2', ... without a header), ``lines`` (T,) the line of each.
    ImportDataError if it cannot be read, is empty, or a row has another length than the header.
    """

    def __init__(self, path, form):
        self.path = Path(path)
        self._form = form
        rows = self._rows()
        header = list(islice(rows, form.header_rows))
        first = next(rows, None)
        if first is None:
            raise ImportDataError(f'{path}: has no data below {len(header)} header rows; '
                                  'is it the right file, or file.header_rows too large?')
        if header:
            self.names, *self._other_names = map(_names, (row for _, row in reversed(header)))
            self._check_header(*header[-1])
        else:
            self.names, self._other_names = [
                str(i + 1) for i in range(len(_names(first[1])))], []
        self._check_delimiter(header[-1] if header else first)
        self._texts = {}  # (row, column): what is no number
        self._values, self.lines = self._numbers(chain([first], rows))

    def _numbers(self, rows):
        """Return all cells (T, columns), NaN for texts, and their lines (T,)."""
        values, lines, comma = array('d'), array('q'), self._form.decimal == ','
        for line, cells in rows:
            cells = self._fitting(line, cells, rows)
            if comma:
                cells = [cell.replace(',', '.') for cell in cells]
            try:
                numbers = tuple(map(float, cells))
            except ValueError:
                numbers = [self._number(cell, len(lines), i) for i, cell in enumerate(cells)]
            values.extend(numbers)
            lines.append(line)
        table = np.array(values).reshape(len(lines), len(self.names))
        table[~np.isfinite(table)] = np.nan
        return table, np.array(lines)

    def _number(self, cell, row, column):
        text = cell.strip()
        try:
            return float(text)
        except ValueError:
            if text.lower() not in ('', 'nan', 'na', 'n/a', 'null', 'none', '-'):
                self._texts[row, column] = text
            return np.nan

    def column(self, name, asked_by) -> np.ndarray:
        """
        Return the numbers (T,) under a name, or a number from 1; NaN where a cell is empty.

        ImportDataError, naming ``asked_by``, if there is no such column or a cell is no number.
        """
        index = self._index(name, asked_by)
        texts = [row for row, column in self._texts if column == index]
        if texts:
            self._refuse(min(texts), index)
        return self._values[:, index].copy()

    def _index(self, name, asked_by):
        if isinstance(name, int):
            if not 1 <= name <= len(self.names):
                raise ImportDataError(f'{self.path}: has {len(self.names)} columns, {asked_by} '
                                      f'requires column {name}; they count from 1')
            return name - 1
        for names in self._other_names:
            if name not in self.names and names.count(name) == 1:
                return names.index(name)  # the last header row holds units or the like
        if name not in self.names:
            raise ImportDataError(f'{self.path}: has no column {name!r}, which {asked_by} '
                                  f'requires{did_you_mean(name, self.names)}')
        if self.names.count(name) > 1:
            raise ImportDataError(f'{self.path}: has {self.names.count(name)} columns named '
                                  f'{name!r}; give the number of the one meant (from 1)')
        return self.names.index(name)

    def _refuse(self, row, index):
        text = self._texts[row, index]
        hint = '; correct the cell or leave it empty'
        if text.replace(',', '').lstrip('-').isdigit():
            hint = "; set file.decimal: ','"
        elif ':' in text:
            hint = '; give a time of day as seconds since the start'
        elif row == 0:
            hint = ('; if this line is no data, set file.header_rows: '
                    f'{self._form.header_rows + 1}')
        raise ImportDataError(f'{self.path}:{self.lines[row]}: column {self.names[index]!r} '
                              f'holds {text[:40]!r}, which is no number{hint}')

    def _rows(self):
        """Yield (line, cells) of every line that is neither blank nor a comment."""
        try:
            text = self.path.read_text(encoding='utf-8-sig')
        except OSError as error:
            raise ImportDataError(f'{self.path}: cannot be read ({error.strerror})') from error
        except UnicodeDecodeError as error:
            raise ImportDataError(
                f'{self.path}: is not UTF-8 text (byte {error.start} is '
                f'0x{error.object[error.start]:02x}); export it as UTF-8 CSV') from error
        if '\0' in text:
            raise ImportDataError(f'{self.path}: holds NUL bytes, so it is no text table; '
                                  'export it as CSV')
        comment, blank = self._form.comment, self._form.delimiter == ' '
        lines = text.splitlines(keepends=True)
        del text
        if blank:
            source = ((i + 1, line.split()) for i, line in enumerate(lines))
        else:
            reader = csv.reader(lines, delimiter=self._form.delimiter)
            source = ((reader.line_num, cells) for cells in reader)
        for line, cells in source:
            if any(cell.strip() for cell in cells) and not (
                    comment and cells[0].lstrip().startswith(comment)):
                yield line, cells

    def _check_delimiter(self, row):
        line, cells = row
        if len(cells) > 1:
            return
        found = {sign: cells[0].count(sign) for sign in (',', ';', '\t') if sign in cells[0]}
        if found:
            sign = max(found, key=found.get)
            name = {'\t': 'tab'}.get(sign, sign)
            raise ImportDataError(f'{self.path}:{line}: has one column only with the delimiter '
                                  f'{self._form.delimiter!r} but {found[sign]} {name!r}; '
                                  f"set file.delimiter: '{name}'")

    def _check_header(self, line, cells):
        """Refuse a row of numbers as names: the first sample would be lost in silence."""
        names = _names(cells)
        if len(names) < 2 or names == [str(i + 1) for i in range(len(names))]:
            return
        comma = self._form.decimal == ','
        try:
            for name in names:
                float((name.replace(',', '.') if comma else name) or 'nan')
        except ValueError:
            return
        raise ImportDataError(f'{self.path}:{line}: has numbers where file.header_rows: '
                              f'{self._form.header_rows} expects column names; set '
                              f'file.header_rows: {self._form.header_rows - 1} and give '
                              'columns by number, from 1')

    def _fitting(self, line, cells, following):
        count = len(self.names)
        while len(cells) > count and not cells[-1].strip():
            cells = cells[:-1]  # delimiters at the end of each row
        if len(cells) != count:
            last = next(following, None) is None
            hint = 'the file seems cut off, remove the last line' if last else (
                'check file.delimiter and file.decimal, or correct the line')
            raise ImportDataError(f'{self.path}:{line}: has {len(cells)} cells where there are '
                                  f'{count} columns; {hint}')
        return cells


def _names(cells):
    """Return the names in a header row, without empty columns at its end."""
    names = [cell.strip().lstrip('#%').strip() for cell in cells]
    while len(names) > 1 and not names[-1]:
        names.pop()
    return names
