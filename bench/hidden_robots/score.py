# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench score`: the discrepancy workflow on many hidden robots, judged."""

from functools import partial
import json
from pathlib import Path
import sys

from bench.hidden_robots import figures, peers
from bench.hidden_robots.cases import KINDS, require_duration, require_known
from bench.hidden_robots.hide import seeds_of
from bench.hidden_robots.jobs import fingerprint, Job, jobs_of
from bench.hidden_robots.judgement import RIGHT, WORKFLOW
from bench.hidden_robots.outcome import try_job
from bench.hidden_robots.plants import PLANTS
from bench.hidden_robots.populations import POPULATIONS
from bench.journal import Journal
from gms_flex_control.batches import run_batch
from gms_flex_control.cli.options import add_verb, JSON, number, option, out_folder, Verb, WORKERS
from gms_flex_control.discrepancy.thresholds import EVIDENCE
from gms_flex_control.errors import ConfigError, SimulationError
from gms_flex_control.file_io import write_text

NUMBERS = ('cases', 'free run', 'free run above truth', 'set size', 'energy',
           'time [s]')  # figures of a population, else shares


VERB = Verb(
    'score', lambda args: run(args), 'how often the discrepancy workflow names what is hidden',
    'Draw hidden robots (see hide), ask the discrepancy workflow what each lacks, beside two '
    'peers on the same library, and print the confusion matrix and the figures beside what is '
    'required. A killed run goes on where it was when started again with the same --out. Exit '
    'code 1 if a figure misses what is required.', (
        option('--set', default='quick', metavar='NAME', dest='chosen',
               help='full (about 780 robots) or quick (92); default: quick'),
        number('--share', 'PART', 1.0, 'of a set: only so much of it, from its beginning; kinds '
               'are mixed evenly'),
        option('--kind', nargs='+', metavar='KIND',
               help='instead of a set: kinds of hidden robots, with --seeds'),
        option('--seeds', default='0:10', metavar='A:B',
               help='of --kind, from A up to, not including, B (default: 0:10)'),
        option('--population', nargs='+', default=['home'], metavar='NAME',
               help='of --kind: which robots, see bench/hidden_robots/populations.py (default: '
                    'home)'),
        option('--plant', metavar='NAME', help='of --kind: soft or stiff; default: drawn'),
        number('--duration', 'S', 60.0, 'of each recording of --kind'),
        out_folder('journal outcomes.jsonl, report.txt and report.json'), WORKERS,
        option('--no-peers', action='store_true', help='ask the workflow alone'), JSON), ())
add_parser = partial(add_verb, VERB)


def run(args):
    """Try what is not in the journal yet, report; return 1 if a figure is missed, else 0."""
    jobs, journal = jobs_asked(args), Journal(args.out, fingerprint())
    if not args.json:
        print_beginning(jobs, journal, args)
    try_missing(jobs, journal, args)
    outcomes = [journal.outcomes[job.key] for job in jobs if job.key in journal.outcomes]
    text, values = report(outcomes), values_of(outcomes)
    write_text(Path(args.out) / 'report.txt', text + '\n')
    write_text(Path(args.out) / 'report.json', json.dumps(values, indent=2) + '\n')
    print(json.dumps(values, indent=2) if args.json else f'\n{text}')
    return int(any(one['met'] is False for one in values['figures']))


def jobs_asked(args):
    """Return the jobs of --kind, less those whose effect cannot be there, else of --set."""
    if not args.kind:
        if args.population != ['home']:
            raise ConfigError('--population is of --kind: give kinds and --seeds as well')
        return jobs_of(args.chosen, args.share)
    for kind in args.kind:
        require_known('kind', kind, KINDS)
    for population in args.population:
        require_known('population', population, POPULATIONS)
    if args.plant is not None:
        require_known('plant', args.plant, PLANTS)
    require_duration(args.duration)
    jobs = [Job(kind, seed, population, args.plant, args.duration)
            for seed in seeds_of(args.seeds) for kind in args.kind
            for population in args.population]
    return [job for job in jobs if job.can_be_seen]


def print_beginning(jobs, journal, args):
    """Say beside the results how much there is to do, and what is left out."""
    known = sum(job.key in journal.outcomes for job in jobs)
    print(f'{len(jobs)} hidden robots, {known} of them in {journal.path}', file=sys.stderr)
    if journal.stale:
        print(f'{journal.stale} outcomes there are of other sources and are tried again',
              file=sys.stderr)
    if not args.no_peers and not peers.can_regress():
        print(peers.NO_PYSINDY, file=sys.stderr)


def try_missing(jobs, journal, args):
    """Try every job that the journal lacks, and keep each outcome at once."""
    waiting, count = {job.key: job for job in jobs if job.key not in journal.outcomes}, 0

    def keep(_, outcome):
        nonlocal count
        count += 1
        if outcome is None:
            return
        journal.add(outcome)
        if not args.json:
            print(f'[{count}/{len(waiting)}] {line_of(outcome)}', flush=True)

    run_batch(partial(try_driven, with_peers=not args.no_peers), waiting, args.workers, keep=keep)


def try_driven(job, with_peers):
    """Return the outcome of `try_job`, None of a robot that the motion cannot be driven with."""
    try:
        return try_job(job, with_peers=with_peers)
    except SimulationError as error:
        print(f'left out: {error}', file=sys.stderr)
        return None


def line_of(outcome):
    """Return one outcome as a line of text."""
    truth = outcome['truth']
    hidden = ', '.join(f'{one["effect"]} of {one["joint"]}' for one in truth['effects'])
    hidden = hidden or (truth['outsider'] or {}).get('name', 'nothing')
    named = ', '.join(f'{one["effect"]} of {one["joint"]}{"" if one["main"] else " (minor)"}'
                      for one in outcome['findings'][:3])
    return (f'{truth["kind"]} {truth["seed"]} {truth["plant"]} {truth["population"]}: {hidden} -> '
            f'{outcome["verdict"]}{": " if named else ""}{named} ({outcome["seconds"]:.1f} s)')


def aligned(rows):
    """Return rows of str as lines with columns of equal width."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return '\n'.join('  '.join(f'{cell:<{width}}' for cell, width in zip(row, widths, strict=True)
                               ).rstrip() for row in rows)


def shown(value, percent):
    """Return a figure as text, a dash where it is unknown."""
    if value is None:
        return '-'
    return f'{100.0 * value:.1f} %' if percent else f'{value:.3g}'


def tools_of(outcomes):
    """Return the tools that were asked, the workflow first."""
    found = {tool for one in outcomes for tool in one['answers']}
    return [WORKFLOW, *sorted(found - {WORKFLOW})]


def table(outcomes):
    """Return the table of figures (str) of outcomes, workflow and peers side by side."""
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
    reported = populations_of(outcomes)
    rows = [['population', *next(iter(reported.values()), ())]]
    for name, values in reported.items():
        rows.append([name, *(f'{value:.3g}' if value is not None and key in NUMBERS
                             else '-' if value is None else f'{100.0 * value:.0f} %'
                             for key, value in values.items())])
    return aligned(rows) if reported else ''


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


def values_of(outcomes):
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
