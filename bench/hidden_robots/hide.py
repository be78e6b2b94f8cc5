# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench hide`: bags of robots with a hidden effect, and the truth beside them."""

from functools import partial
import json
import os
from pathlib import Path
import shutil

from bench.hidden_robots.cases import make_case
from gms_flex_control.cli.options import add_verb, JSON, number, option, out_folder, Verb
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import write_text
from gms_flex_control.reports.discrepancy_values import described
from gms_flex_control.schema.build import controller_values
from gms_flex_control.schema.files import save_robot, save_values

VERB = Verb(
    'hide', lambda args: run(args), 'bags of simulated robots in which an effect is hidden',
    'Draw robots in which something is hidden, drive them and write, for each, '
    'DIR/<kind>_<seed>[_<population>]/ with bag and held_out (two motions of the same robot), '
    'robot.yaml (what its user believes), controller.yaml and truth.json. The integrator is not '
    'the one of the workflow.', (
        out_folder('folder of all'),
        option('--kind', nargs='+', default=['single'], metavar='KIND',
               help='single, clean, double, outside, clutter, deleted (default: single)'),
        option('--seeds', default='0:1', metavar='A:B',
               help='from A up to, not including, B; or a single one (default: 0:1)'),
        option('--population', default='home', metavar='NAME',
               help='which robots, see bench/hidden_robots/populations.py (default: home)'),
        option('--plant', metavar='NAME', help='soft or stiff; default: drawn'),
        option('--effect', metavar='NAME',
               help='hide this one instead of the one whose turn it is'),
        number('--duration', 'S', 60.0, 'of each bag'), JSON), ())
add_parser = partial(add_verb, VERB)


def run(args):
    """Write the cases; return 0."""
    reported, population = [], '' if args.population == 'home' else f'_{args.population}'
    for kind in args.kind:
        for seed in seeds_of(args.seeds):
            folder = Path(args.out) / f'{kind}_{seed}{population}'
            if folder.exists():
                if not args.json:
                    print(f'{folder}: exists, kept as it is')
                continue
            case = make_case(kind, seed, population=args.population, plant=args.plant,
                             duration=args.duration, effect=args.effect)
            write_case(case, folder)
            reported.append({'folder': str(folder), **truth_values(case.truth)})
            if not args.json:
                print(f'{folder}: {case.truth.population}, {case.truth.plant}')
    if args.json:
        print(json.dumps(reported, indent=2))
    return 0


def seeds_of(text):
    """Return the seeds (range) of ``A:B`` or of a single number; ConfigError if it is neither."""
    first, colon, last = text.partition(':')
    try:
        begin = int(first)
        end = int(last) if colon else begin + 1
    except ValueError:
        begin, end = 0, 0
    if not 0 <= begin < end:
        raise ConfigError(f'--seeds {text!r} must be a number or A:B with 0 <= A < B')
    return range(begin, end)


def write_case(case, folder):
    """Write a Case as its user would have it, and the truth, whole or not at all."""
    part = folder.with_name(f'.{folder.name}.{os.getpid()}')
    part.mkdir(parents=True)
    try:
        for name, recording in (('bag', case.recording), ('held_out', case.held_out)):
            write_recording(part / name, recording, case.nominal.motors)
        save_robot(case.nominal, part / 'robot.yaml')
        if case.gains is not None:
            save_values(controller_values(case.gains, case.nominal.joints),
                        part / 'controller.yaml')
        write_text(part / 'truth.json', json.dumps(truth_values(case.truth), indent=2) + '\n')
        os.replace(part, folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def truth_values(truth):
    """
    Return a Truth as plain values (dict).

    Kind, seed, population, plant, motion, ``effects`` (main ones), ``clutter``, ``outsider``,
    ``belief_errors`` (joint -> kind -> relative error), ``torque_noise``.
    """
    outsider = None
    if truth.outsider is not None:
        outsider = {'name': truth.outsider, 'joint': truth.outsider_joint}
    return {'kind': truth.kind, 'seed': truth.seed, 'population': truth.population,
            'plant': truth.plant,
            'motion': truth.motion, 'effects': [described(spec) for spec in truth.effects],
            'clutter': [described(spec) for spec in truth.clutter], 'outsider': outsider,
            'belief_errors': {joint: {
                kind: float(error[j]) for kind, error in truth.belief_errors.items()}
                for j, joint in enumerate(truth.robot.joints)},
            'torque_noise': truth.torque_noise.tolist()}
