# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Text tables as written by anything: named columns of numbers that know their lines."""

import csv
from pathlib import Path

from gms_flex_control.errors import ImportDataError
from gms_flex_control.suggest import did_you_mean
import numpy as np

EMPTY = ('', 'nan', 'na', 'n/a', 'null', 'none', '-')


class CsvTable:
    """
    A table read into memory, its cells still text.

    Parameters
    ----------
    path : str or Path
        The file, UTF-8.
    form : FileFormat
        Delimiter, header rows, decimal sign and comment sign.

    Attributes
    ----------
    names : list of str
        Column names; '1', '2', ... where there is no header.
    lines : ndarray of int, shape (T,)
        Line of each row in the file.

    Raises
    ------
    ImportDataError
        If it cannot be read, is empty, or a row has another length than the header.

    """

    def __init__(self, path, form):
        self.path = Path(path)
        self._form = form
        rows = list(self._rows())
        header, body = rows[:form.header_rows], rows[form.header_rows:]
        if not body:
            raise ImportDataError(f'{path}: has no data below {len(header)} header rows; '
                                  'is it the right file, or file.header_rows too large?')
        if header:
            self.names = [cell.strip().lstrip('#').strip() for cell in header[-1][1]]
        else:
            self.names = [str(i + 1) for i in range(len(body[0][1]))]
        self._check_delimiter((header or body)[-1])
        self._cells = [self._fitting(line, cells, last=i == len(body) - 1)
                       for i, (line, cells) in enumerate(body)]
        self.lines = np.array([line for line, _ in body])

    def column(self, name, asked_by):
        """
        Return one column as numbers.

        Parameters
        ----------
        name : str or int
            Its name, or its number from 1.
        asked_by : str
            Who wants it, for the message.

        Returns
        -------
        ndarray, shape (T,)
            NaN where a cell is empty or says so.

        Raises
        ------
        ImportDataError
            If there is no such column or a cell is no number.

        """
        index = self._index(name, asked_by)
        cells = [row[index] for row in self._cells]
        if self._form.decimal == ',':
            cells = [cell.replace(',', '.') for cell in cells]
        try:
            values = np.array(cells).astype(float)
        except ValueError:
            values = np.array([self._number(cell, k, index) for k, cell in enumerate(cells)])
        values[~np.isfinite(values)] = np.nan
        return values

    def _index(self, name, asked_by):
        if isinstance(name, int):
            if not 1 <= name <= len(self.names):
                raise ImportDataError(f'{self.path}: has {len(self.names)} columns, {asked_by} '
                                      f'asks for column {name}; they count from 1')
            return name - 1
        if name not in self.names:
            raise ImportDataError(f'{self.path}: has no column {name!r}, which {asked_by} asks '
                                  f'for{did_you_mean(name, self.names)}')
        if self.names.count(name) > 1:
            raise ImportDataError(f'{self.path}: has {self.names.count(name)} columns named '
                                  f'{name!r}; give the number of the one meant (from 1)')
        return self.names.index(name)

    def _number(self, cell, k, index):
        text = cell.strip()
        if text.lower() in EMPTY:
            return np.nan
        try:
            return float(text)
        except ValueError:
            hint = "; set file.decimal: ','" if text.replace(',', '').lstrip('-').isdigit() else (
                '; correct the cell or leave it empty')
            raise ImportDataError(f'{self.path}:{self.lines[k]}: column {self.names[index]!r} '
                                  f'holds {text[:40]!r}, which is no number{hint}') from None

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

    def _fitting(self, line, cells, last):
        count = len(self.names)
        if len(cells) == count + 1 and not cells[-1].strip():
            cells = cells[:-1]  # a delimiter at the end of each row
        if len(cells) != count:
            hint = 'the file seems cut off, remove the last line' if last else (
                'check file.delimiter and file.decimal, or correct the line')
            raise ImportDataError(f'{self.path}:{line}: has {len(cells)} cells where there are '
                                  f'{count} columns; {hint}')
        return cells
