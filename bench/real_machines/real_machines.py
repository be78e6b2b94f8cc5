# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench real-machines`: recordings of real machines, beside least squares."""

from functools import partial
from pathlib import Path
import sys

from bench.real_machines import pictures, table
from bench.real_machines.machines import MACHINES, ROOT, shared_data, VARIABLE
from bench.real_machines.split import try_split
from gms_flex_control.cli.options import add_verb, option, Verb
from gms_flex_control.errors import ConfigError, did_you_mean
from gms_flex_control.file_io import write_json

DOCUMENT = ROOT / 'docs' / 'real_machines.md'


VERB = Verb(
    'real-machines', lambda args: run(args),
    'public recordings of real machines, beside least squares',
    'Run identification and discrepancy on public recordings of real machines, beside least '
    f'squares. They are looked for in {shared_data()} (set {VARIABLE}).', (
        option('machines', nargs='*', metavar='MACHINE', default=list(MACHINES),
               help=f'of {", ".join(MACHINES)} (default: all)'),
        option('--first', action='store_true', help='only the first split of each'),
        option('--out', type=Path, metavar='DIR', help='folder for results.json and pictures'),
        option('--docs', action='store_true',
               help=f'write {DOCUMENT.relative_to(ROOT)} and its pictures anew')), ())
add_parser = partial(add_verb, VERB)


def run(args):
    """Run the machines asked for; return 0, or 1 if none has its files."""
    for name in args.machines:
        if name not in MACHINES:
            raise ConfigError(f'there is no machine {name!r}{did_you_mean(name, MACHINES)}')
    outcomes, skipped = [], []
    for name in args.machines:
        machine = MACHINES[name]
        if machine.absent():
            skipped.append(f'{machine.title}: skipped, {machine.absent()} is absent')
            continue
        for split in machine.splits[:1 if args.first else None]:
            outcomes.append(try_split(
                machine, split, lambda text, name=name, split=split: print(
                    f'  {name}, {split.name}: {text} ...', file=sys.stderr, flush=True)))
    write(args, outcomes, skipped)
    print('\n'.join([table.as_text(table.rows(outcomes)), *table.remarks(outcomes), *skipped]))
    return 0 if outcomes else 1


def write(args, outcomes, skipped):
    """Write results and pictures where they were asked for."""
    firsts = {outcome.machine: outcome for outcome in reversed(outcomes)}
    shown = [(MACHINES[name].title, pictures.NAMES[name]) for name in MACHINES if name in firsts]
    folders = [args.out] if args.out else []
    folders += [DOCUMENT.parent / 'images'] if args.docs else []
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
        for name, outcome in firsts.items():
            pictures.draw(outcome, folder / pictures.NAMES[name])
    if args.out:
        write_json(args.out / 'results.json', table.as_values(outcomes, skipped))
    if args.docs:
        table.into_document(DOCUMENT, outcomes, skipped, shown)
