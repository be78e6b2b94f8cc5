# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Outcomes as a table for a terminal, for docs/real_machines.md, and as JSON."""

from dataclasses import asdict
import math
import re

from bench.real_machines.machines import MACHINES, shared_data
from bench.real_machines.split import CRASHED

BEGIN = '<!-- made by make bench-real: begin -->'
END = '<!-- made by make bench-real: end -->'
_HEAD = ('machine: fitted, then held out', 'band [Hz]', 'torque', '(a)', '(b)', '(b) chosen',
         'identified', 'final', 'final / (b)', 'free run', 'verdict', 'named', 'known: named',
         'time [s]')
_NUMBERS = range(1, 9)


def rows(outcomes, most=None):
    """
    Return the table (list of lists of str), its head first.

    With at ``most`` so many rows of each split, one per band, the lowest first; by default all.
    """
    table = [list(_HEAD)]
    for outcome in outcomes:
        machine = MACHINES[outcome.machine]
        for k, one in enumerate(outcome.bands[:most]):
            torques = [f'{machine.factor * value:.3g}' for value in (
                one.torque, one.textbook, one.library, one.chosen, one.identified, one.final)]
            torques[0] += f' {machine.unit}'
            first = [f'{machine.title}: {outcome.split}'] if k == 0 else ['']
            reported = _reported(outcome, machine) if k == 0 else [''] * 5
            table.append([*first, f'{one.band:g}', *torques, f'{one.ratio:.2f}', *reported])
    return table


def _reported(outcome, machine):
    """Return the cells of a row that are the same in every band."""
    unit, factor = machine.length
    free = '-'
    if math.isfinite(outcome.free_before):
        errors = dict.fromkeys(f'{factor * one:.3g}' for one in (
            outcome.free_before, outcome.free_after))
        free = f'{" -> ".join(errors)} {unit}'
    named = [effect for effect, _ in outcome.named]
    reported = [effect if effect in outcome.added else f'{effect} (not added)' for effect in named]
    known = [f'{one.words}: {" and ".join(_names_of(one, outcome)) or "-"}'
             for one in machine.known]
    return [free, outcome.verdict, ', '.join(reported) or '-', '; '.join(known) or '-',
            f'{outcome.identify_seconds + outcome.seconds:.0f}']


def _names_of(known, outcome):
    """Return under which names (list of str) an Outcome has what is Known."""
    named = {effect for effect, _ in outcome.named}
    return [*(effect for effect in known.effects if effect in named),
            *(f'{effect} by identify' for effect in known.effects
              if effect in outcome.identified)]


def as_text(table):
    """Return a table as aligned lines."""
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    lines = ['  '.join(cell.rjust(width) if k in _NUMBERS else cell.ljust(width)
                       for k, (cell, width) in enumerate(zip(row, widths, strict=True))).rstrip()
             for row in table]
    return '\n'.join([lines[0], '  '.join('-' * width for width in widths), *lines[1:]])


def as_markdown(table, numbers=_NUMBERS):
    """Return a table for a document; columns of ``numbers`` are aligned to the right."""
    head, *rows = (f'| {" | ".join(row)} |' for row in table)
    marks = ('--:' if k in numbers else '---' for k in range(len(table[0])))
    return '\n'.join([head, f'|{"|".join(marks)}|', *rows])


def remarks(outcomes):
    """Return a line for each identification that refused and each discrepancy that crashed."""
    lines = []
    for one in outcomes:
        machine = MACHINES[one.machine]
        folder, name = f'{shared_data() / machine.folder}/', f'{machine.title}, {one.split}'
        if one.refused:
            lines.append(f'- {name}: `identify` refuses ({one.refused}); the believed robot '
                         'replaces its result.'.replace(folder, ''))
        if one.verdict == CRASHED:
            lines.append(f'- {name}: `discrepancy` ends with an error: {one.words}'.replace(
                folder, ''))
    return lines


def _short(outcomes):
    """
    Return the table of the document: a machine's title and the better (b) once, no band.

    What is known of a machine is bold where it was named, else behind 'missed'; what was named
    and not added stands in brackets.
    """
    head, *table = rows(outcomes, most=1)
    short, last = [[head[0], *head[2:5], *head[6:10], head[11]]], None
    for row, outcome in zip(table, outcomes, strict=True):
        machine = MACHINES[outcome.machine]
        known = {effect for one in machine.known for effect in one.effects}
        named = [(effect, '{} by identify') for effect in outcome.identified if effect in known]
        named += [(name, '{}' if name in outcome.added else '({})') for name, _ in outcome.named]
        named = [form.format(f'**{effect}**' if effect in known else effect)
                 for effect, form in named]
        named += [] if outcome.named else [outcome.verdict]
        missed = [one.words for one in machine.known if not _names_of(one, outcome)]
        cells = [', '.join(named), *([f'missed: {", ".join(missed)}'] if missed else [])]
        title = row[0] if outcome.machine != last else outcome.split
        better = row[5 if outcome.bands[0].chosen < outcome.bands[0].library else 4]
        short.append([title, *row[2:4], better, *row[6:10], '; '.join(cells)])
        last = outcome.machine
    return short


def into_document(path, outcomes, skipped, pictures):
    """
    Write the results between the markers of a document, of each split in its lowest band.

    ``skipped`` is a line for each machine that was not run, ``pictures`` title and file name in
    images/.
    """
    lines = [*remarks(outcomes), *(f'- {line}' for line in skipped)]
    parts = [as_markdown(_short(outcomes), range(1, 7)), *(['\n'.join(lines)] if lines else []),
             *(f'![{title}](images/{name})' for title, name in pictures)]
    text, made = path.read_text(encoding='utf-8'), '\n\n'.join(parts)
    pattern = f'{re.escape(BEGIN)}.*?{re.escape(END)}'
    path.write_text(re.sub(pattern, lambda _: f'{BEGIN}\n\n{made}\n\n{END}', text,
                           flags=re.DOTALL), encoding='utf-8')


def as_values(outcomes, skipped):
    """Return everything for `write_json`, in SI units."""
    return {'skipped': skipped, 'outcomes': [
        {name: value for name, value in asdict(one).items() if name != 'pictured'}
        | {'ratio': [band.ratio for band in one.bands]} for one in outcomes]}
