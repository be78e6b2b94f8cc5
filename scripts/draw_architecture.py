#!/usr/bin/env python3
# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Draw which layer of the package imports which, from the sources: docs/images/architecture.svg.

The order is that of LAYERS in test/test_import_direction.py, which fails when an import points
upwards; here such an import would stand above the diagonal.
"""

import ast
from functools import cache
from pathlib import Path
import sys
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'gms_flex_control'
PICTURE = ROOT / 'docs' / 'images' / 'architecture.svg'
CELL, LEFT, TOP, TEXT, LINE = 22, 165, 118, 11, 12  # sizes [px]
WIDEST = 84  # characters of a summary
LETTER = 0.62  # of the font size: width of a letter of a wide sans-serif, the mean of a line


def layers():
    """Return the names of the layers, lowest first."""
    tree = ast.parse((ROOT / 'test' / 'test_import_direction.py').read_text(encoding='utf-8'))
    values = [node.value for node in tree.body if isinstance(node, ast.Assign)
              and getattr(node.targets[0], 'id', '') == 'LAYERS']
    return [name for name in ast.literal_eval(values[0]) if files_of(name)]


def files_of(layer):
    """Return the modules of a layer."""
    single = PACKAGE / f'{layer}.py'
    return [single] if single.is_file() else sorted((PACKAGE / layer).rglob('*.py'))


@cache
def imports(path):
    """Return the layers that a module imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f'{node.module}.{alias.name}' for alias in node.names]
        found |= {name.split('.')[1] for name in names if name.startswith('gms_flex_control.')}
    return found


def summary(layer):
    """Return what a layer says of itself, in one line."""
    first = files_of(layer)[0] if len(files_of(layer)) == 1 else PACKAGE / layer / '__init__.py'
    text = (ast.get_docstring(ast.parse(first.read_text(encoding='utf-8'))) or '').strip()
    line = text.split('\n\n')[0].replace('\n', ' ').rstrip('.')
    return line if len(line) <= WIDEST else f'{line[:WIDEST].rsplit(" ", 1)[0]} ...'


def picture():
    """Return the drawing as SVG text."""
    names = layers()
    counts = {(user, used): sum(used in imports(path) for path in files_of(user))
              for user in names for used in names if user != used}
    size = CELL * len(names)
    shapes = []
    for row, user in enumerate(reversed(names)):
        y = TOP + CELL * row
        shapes += [box(LEFT, y, size, CELL - 2, '#f2f4f7'),
                   label(LEFT - 8, y + 15, user, 'end', weight='bold'),
                   label(LEFT + size + 10, y + 15, f'{len(files_of(user))}', size=TEXT),
                   label(LEFT + size + 42, y + 15, summary(user), size=TEXT)]
        for column, used in enumerate(names):
            x = LEFT + CELL * column
            if user == used:
                shapes.append(box(x, y, CELL - 2, CELL - 2, '#8a94a6'))
            elif counts[user, used]:
                shapes.append(cell(x, y, counts[user, used]))
    for column, used in enumerate(names):
        x, y = LEFT + CELL * column + 14, TOP - 8
        shapes.append(label(0, 0, used, place=f'translate({x} {y}) rotate(-60)'))
    words = max(len(summary(name)) for name in names)
    width, height = LEFT + size + 52 + round(LETTER * TEXT * words), TOP + size + 40
    return '\n'.join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'font-family="sans-serif">', box(0, 0, width, height, '#ffffff'), *shapes,
        label(LEFT, height - 14, 'A row imports the columns that are filled: from so many of its '
              'modules. Nothing stands right of the diagonal: imports point one way.'),
        label(LEFT + size + 10, TOP - 12, 'modules, and what they are for'), '</svg>', ''])


def box(x, y, width, height, colour):
    """Return a filled rectangle."""
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="{colour}"/>'


def cell(x, y, count):
    """Return a filled cell with its count; the more, the darker."""
    shade = '#9cc3e6' if count < 4 else '#5b9bd5' if count < 12 else '#2a6db0'
    colour = '#000000' if count < 12 else '#ffffff'
    return box(x, y, CELL - 2, CELL - 2, shade) + label(x + 10, y + 14, count, 'middle', 9,
                                                        colour=colour)


def label(x, y, text, anchor='start', size=LINE, *, weight='normal', colour='#1b1f24', place=''):
    """Return a line of text."""
    turned = f' transform="{place}"' if place else ''
    return (f'<text x="{x}" y="{y}" font-size="{size}" text-anchor="{anchor}" fill="{colour}" '
            f'font-weight="{weight}"{turned}>{escape(str(text))}</text>')


if __name__ == '__main__':
    PICTURE.write_text(picture(), encoding='utf-8')
    sys.stdout.write(f'{PICTURE.relative_to(ROOT)}\n')
