# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What a verb ends with and its page begins with: a sentence, three numbers, a command."""

from pathlib import Path
import shlex
from shutil import which
import sys
from typing import NamedTuple

import numpy as np


class Number(NamedTuple):
    """One measured quantity, as text; '-' where it is not known."""

    name: str     # with its unit, 'error of joint1 [mrad]'
    before: str   # without what the answer is about
    after: str    # with it
    floor: str    # what is left where nothing is wrong, as by noise


class Answer(NamedTuple):
    """The answer of a page or a verb."""

    sentence: str
    columns: tuple   # titles of the three columns of numbers
    numbers: tuple   # of Number, three; none where nothing could be measured
    command: str     # to be run next

    @property
    def header(self) -> tuple:
        """Return the column titles of the table of numbers."""
        return ('', *self.columns)


def measured(name: str, before, after, floor, scale: float = 1e3) -> Number:
    """Return a Number of values in SI units, by default in thousandths; None is not known."""
    return Number(name, *(
        '-' if value is None or not np.isfinite(value) else f'{scale * value:.3g}'
        for value in (before, after, floor)))


def unbroken(text: str) -> str:
    """Return a text whose arrows stay with the words on both sides of them."""
    return text.replace(' -> ', '\u00a0→\u00a0')


def command(verb: str, *words) -> str:
    """Return a command line of gms_flex that a shell takes as it is, on its path or not."""
    called = Path(sys.argv[0])
    tool = called if called.name == 'gms_flex' and not which('gms_flex') else 'gms_flex'
    return shlex.join(map(str, [tool, verb, *words]))


def align(header, rows) -> str:
    """Return a header and rows of cells as text with aligned columns, numbers to the right."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    numeric = [all(row[i][:1] in '-+(0123456789' and '..' not in row[i] for row in rows)
               for i in range(len(header))]

    def line(cells):
        return '  '.join(cell.rjust(width) if right else cell.ljust(width) for
                         cell, width, right in zip(cells, widths, numeric, strict=True)).rstrip()

    return '\n'.join([line(header), '  '.join('-' * width for width in widths),
                      *(line(row) for row in rows)])
