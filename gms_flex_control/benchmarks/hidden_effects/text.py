# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The figures as text: the table beside what is required, and the confusion matrix."""

from gms_flex_control.benchmarks.hidden_effects import figures
from gms_flex_control.benchmarks.hidden_effects.judgement import RIGHT
from gms_flex_control.benchmarks.hidden_effects.outcome import WORKFLOW
from gms_flex_control.discrepancy.search import LEAST_GAIN


def aligned(rows):
    """Return rows of str as lines with columns of equal width."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return '\n'.join('  '.join(f'{cell:<{width}}' for cell, width in zip(row, widths, strict=True)
                               ).rstrip() for row in rows)


def shown(value, percent):
    """Return a figure as text, a dash where nothing tells."""
    if value is None:
        return '-'
    return f'{100.0 * value:.1f} %' if percent else f'{value:.3g}'


def tools_of(outcomes):
    """Return the tools that were asked, the workflow first."""
    found = {tool for one in outcomes for tool in one['answers']}
    return [WORKFLOW, *sorted(found - {WORKFLOW})]


def table(outcomes):
    """
    Return the table of figures, workflow and peers side by side.

    Parameters
    ----------
    outcomes : sequence of dict
        Of `outcome.try_job`.

    Returns
    -------
    str

    """
    tools = tools_of(outcomes)
    peers = {tool: figures.peer_figures(outcomes, tool) for tool in tools[1:]}
    rows = [['figure', *tools, 'required', 'cases', '']]
    for one in figures.figures_of(outcomes):
        limit = '-' if one.required is None else (
            f'{">=" if one.at_least else "<="} {shown(one.required, one.percent)}')
        mark = {None: '', True: 'met', False: 'MISSED'}[one.met]
        rows.append([one.name, shown(one.value, one.percent),
                     *(shown(peers[tool].get(one.name), one.percent) for tool in tools[1:]),
                     limit, str(one.count), mark])
    return aligned(rows)


def matrix(outcomes):
    """Return the confusion matrix of singles as lines: hidden, how many right, other answers."""
    counts = figures.confusion(outcomes)
    if not counts:
        return ''
    rows = [['hidden', RIGHT, 'other first answers (* on another joint)']]
    for name, row in counts.items():
        others = ', '.join(f'{answer} {number}' for answer, number in row.items()
                           if answer != name)
        rows.append([name, f'{row.get(name, 0)} of {sum(row.values())}', others])
    return aligned(rows)


def not_named(outcomes):
    """Return the singles that were missed as lines, with what the truth would have gained."""
    rows = [['missed', 'hidden', 'answer', f'the truth gains (of {LEAST_GAIN:g} that are asked)']]
    for key, hidden, answer, gain in figures.missed(outcomes):
        first = answer if isinstance(answer, str) else ' of '.join(answer[0])
        rows.append([key, ' of '.join(hidden[0]), first, '-' if gain is None else f'{gain:.0f}'])
    return aligned(rows) if len(rows) > 1 else ''


def report(outcomes):
    """Return the whole report, str."""
    failed = [f'{one["key"]}: {one["error"]}' for one in outcomes if one.get('error')]
    parts = [matrix(outcomes), not_named(outcomes), table(outcomes)]
    parts += ['The workflow failed:\n' + '\n'.join(failed)] if failed else []
    return '\n\n'.join(part for part in parts if part)


def values(outcomes):
    """Return figures, confusion matrix and missed cases as plain values for JSON."""
    tools = tools_of(outcomes)
    return {
        'cases': len(outcomes),
        'figures': [one._asdict() | {'met': one.met} for one in figures.figures_of(outcomes)],
        'peers': {tool: figures.peer_figures(outcomes, tool) for tool in tools[1:]},
        'confusion': figures.confusion(outcomes),
        'missed': [{'key': key, 'hidden': hidden, 'answer': answer, 'truth_gains': gain}
                   for key, hidden, answer, gain in figures.missed(outcomes)]}
