# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The figures as text: the table beside what is required, and the confusion matrix."""

from gms_flex_control.benchmarks.hidden_effects import figures
from gms_flex_control.benchmarks.hidden_effects.judgement import RIGHT
from gms_flex_control.benchmarks.hidden_effects.outcome import WORKFLOW
from gms_flex_control.discrepancy.thresholds import EVIDENCE

NUMBERS = ('cases', 'free run', 'energy', 'time [s]')  # figures of a population, else shares


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


def populations(outcomes):
    """Return a line of figures for each population, str; the workflow alone."""
    told = populations_of(outcomes)
    rows = [['population', *next(iter(told.values()), ())]]
    for name, values in told.items():
        rows.append([name, *(f'{value:.3g}' if value is not None and key in NUMBERS
                             else '-' if value is None else f'{100.0 * value:.0f} %'
                             for key, value in values.items())])
    return aligned(rows) if told else ''


def populations_of(outcomes):
    """Return the figures of every population there is an outcome of, dict of dict."""
    return {name: figures.of_population(outcomes, name)
            for name in dict.fromkeys(one['truth']['population'] for one in outcomes)}


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
    """Return the singles that were missed as lines, with the evidence of the truth."""
    rows = [['missed', 'hidden', 'answer',
             f'2 log evidence of the truth (threshold {EVIDENCE:g})']]
    for key, hidden, answer, gain in figures.missed(outcomes):
        first = answer if isinstance(answer, str) else ' of '.join(answer[0])
        rows.append([key, ' of '.join(hidden[0]), first, '-' if gain is None else f'{gain:.0f}'])
    return aligned(rows) if len(rows) > 1 else ''


def report(outcomes):
    """Return the whole report, str."""
    failed = [f'{one["key"]}: {one["error"]}' for one in outcomes if one.get('error')]
    parts = [matrix(outcomes), not_named(outcomes), populations(outcomes)]
    if any(one['truth']['population'] in figures.REQUIRED for one in outcomes):
        parts.append(table(outcomes))
    parts += ['The workflow failed:\n' + '\n'.join(failed)] if failed else []
    return '\n\n'.join(part for part in parts if part)


def values(outcomes):
    """Return figures, confusion matrix and missed cases as plain values for JSON."""
    tools = tools_of(outcomes)
    return {
        'cases': len(outcomes),
        'figures': [one._asdict() | {'met': one.met} for one in figures.figures_of(outcomes)],
        'populations': populations_of(outcomes),
        'peers': {tool: figures.peer_figures(outcomes, tool) for tool in tools[1:]},
        'confusion': figures.confusion(outcomes),
        'missed': [{'key': key, 'hidden': hidden, 'answer': answer, 'truth_gains': gain}
                   for key, hidden, answer, gain in figures.missed(outcomes)]}
