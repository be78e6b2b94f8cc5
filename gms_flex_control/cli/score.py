# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex score`: the discrepancy workflow on many hidden robots, judged."""

from pathlib import Path
import sys

from gms_flex_control.cli.batch_options import add_batch_options


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'score', help='how often the discrepancy workflow names what is hidden',
        description='Draw hidden robots (see gms_flex hide), ask the discrepancy workflow what '
                    'each lacks, beside two peers on the same library, and print the confusion '
                    'matrix and the figures beside what is required. A killed run goes on where '
                    'it was when started again with the same --out. Exit code 1 if a figure '
                    'misses what is required.')
    parser.add_argument('--set', default='quick', metavar='NAME', dest='chosen',
                        help='full (about 780 robots) or quick (92); default: quick')
    parser.add_argument('--share', type=float, default=1.0, metavar='PART',
                        help='of a set: only so much of it, from its beginning; kinds are mixed '
                             'evenly (default: %(default)g)')
    parser.add_argument('--kind', nargs='+', metavar='KIND',
                        help='instead of a set: kinds of hidden robots, with --seeds')
    parser.add_argument('--seeds', default='0:10', metavar='A:B',
                        help='of --kind, from A up to, not including, B (default: 0:10)')
    parser.add_argument('--population', nargs='+', default=['home'], metavar='NAME',
                        help='of --kind: which robots, see gms_flex_control/hidden/'
                             'populations.py (default: home)')
    parser.add_argument('--plant', metavar='NAME',
                        help='of --kind: soft or stiff; default: drawn')
    parser.add_argument('--duration', type=float, default=60.0, metavar='S',
                        help='of each recording of --kind (default: %(default)g)')
    parser.add_argument('--out', required=True, metavar='DIR',
                        help='journal outcomes.jsonl, report.txt and report.json')
    add_batch_options(parser)
    parser.add_argument('--no-peers', action='store_true', help='ask the workflow alone')
    parser.add_argument('--json', action='store_true', help='print the report as JSON')
    parser.set_defaults(run=run)


def run(args):
    """Try what is not in the journal yet, report; return 1 if a figure is missed, else 0."""
    import json

    from gms_flex_control.batches.journal import Journal
    from gms_flex_control.benchmarks.hidden_effects import text
    from gms_flex_control.benchmarks.hidden_effects.jobs import fingerprint
    from gms_flex_control.files import write_text

    jobs, journal = jobs_asked(args), Journal(args.out, fingerprint())
    if not args.json:
        tell_beginning(jobs, journal, args)
    try_missing(jobs, journal, args)
    outcomes = [journal.outcomes[job.key] for job in jobs if job.key in journal.outcomes]
    report, values = text.report(outcomes), text.values(outcomes)
    write_text(Path(args.out) / 'report.txt', report + '\n')
    write_text(Path(args.out) / 'report.json', json.dumps(values, indent=2) + '\n')
    print(json.dumps(values, indent=2) if args.json else f'\n{report}')
    return int(any(one['met'] is False for one in values['figures']))


def jobs_asked(args):
    """Return the jobs of --kind, less those whose effect cannot be there, else of --set."""
    from gms_flex_control.benchmarks.hidden_effects.jobs import Job, jobs_of
    from gms_flex_control.cli.hide import seeds_of
    from gms_flex_control.errors import ConfigError
    from gms_flex_control.hidden.cases import KINDS, require_duration, require_known
    from gms_flex_control.hidden.plants import PLANTS
    from gms_flex_control.hidden.populations import POPULATIONS

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


def tell_beginning(jobs, journal, args):
    """Say beside the results how much there is to do, and what is left out."""
    from gms_flex_control.benchmarks.hidden_effects import peers
    known = sum(job.key in journal.outcomes for job in jobs)
    print(f'{len(jobs)} hidden robots, {known} of them in {journal.path}', file=sys.stderr)
    if journal.stale:
        print(f'{journal.stale} outcomes there are of other sources and are tried again',
              file=sys.stderr)
    if not args.no_peers and not peers.can_regress():
        print(peers.NO_PYSINDY, file=sys.stderr)


def try_missing(jobs, journal, args):
    """Try every job that the journal lacks, and keep each outcome at once."""
    from functools import partial

    from gms_flex_control.batches.executor import open_executor
    from gms_flex_control.benchmarks.hidden_effects.outcome import try_job
    from gms_flex_control.errors import SimulationError

    waiting = [job for job in jobs if job.key not in journal.outcomes]
    try_one = partial(try_job, with_peers=not args.no_peers)
    with open_executor(args.workers, args.scheduler) as executor:
        for count, (_, result) in enumerate(executor.finished(try_one, waiting), 1):
            try:
                outcome = result()
            except SimulationError as error:  # nothing can be said of a robot never driven
                print(f'left out: {error}', file=sys.stderr)
                continue
            journal.add(outcome)
            if not args.json:
                print(f'[{count}/{len(waiting)}] {line_of(outcome)}', flush=True)


def line_of(outcome):
    """Return one outcome as a line of text."""
    truth = outcome['truth']
    hidden = ', '.join(f'{one["effect"]} of {one["joint"]}' for one in truth['effects'])
    hidden = hidden or (truth['outsider'] or {}).get('name', 'nothing')
    named = ', '.join(f'{one["effect"]} of {one["joint"]}{"" if one["main"] else " (minor)"}'
                      for one in outcome['findings'][:3])
    return (f'{truth["kind"]} {truth["seed"]} {truth["plant"]} {truth["population"]}: {hidden} -> '
            f'{outcome["verdict"]}{": " if named else ""}{named} ({outcome["seconds"]:.1f} s)')
