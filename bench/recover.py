# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench recover`: what an experiment finds, on a simulated robot many times."""

from dataclasses import asdict, replace
from functools import partial
import json
import math
from pathlib import Path
from typing import NamedTuple

from bench.identification_simulated import read_identification_plan, simulate_identification
from bench.journal import digest_of, fingerprint, run_kept
from bench.known import known_values, presliding_difference
from gms_flex_control.answer import align
from gms_flex_control.cli.options import (
    add_verb,
    CONTROLLER,
    JSON,
    number,
    option,
    out_folder,
    ROBOT,
    Verb,
    WORKERS,
)
from gms_flex_control.experiment.simulated import scaled_friction
from gms_flex_control.file_io import controller_file, robot_file, share_path, write_text
from gms_flex_control.identification.identify import identify
from gms_flex_control.identification.outcome import Estimate, Interval
from gms_flex_control.schema.build import controller_values, robot_values
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np

# what is asked of the identification, by the last part of a parameter's name (largest error)
ASKED = {'static': 0.03, 'coulomb': 0.03, 'viscous': 0.03, 'velocity': 0.15, 'attraction': 0.10}
CURVE = 0.02  # of F_s, at every displacement
# what an outcome depends on
SOURCES = ('params', 'friction', 'effects', 'dynamics', 'trajectory', 'control',
           'simulation', 'experiment', 'identification')


VERB = Verb(
    'recover', lambda args: run(args),
    'identify a simulated robot many times and compare with the truth',
    'Simulate the identification experiment and identify it, once per seed, and print how each '
    'parameter comes out, how often its 95 % interval holds the truth, and how far the presliding '
    'curve is off. A killed run goes on when started again with the same --out. Exit code 1 if '
    'what is asked of the identification is missed.', (
        ROBOT, CONTROLLER, option('--plan', metavar='FILE',
                                  help='default: config/identification.yaml'),
        number('--believed', 'FACTOR', 0.8, 'friction believed before, times the true one'),
        option('--seeds', type=int, default=20, metavar='N', least=1,
               help='default: %(default)s'),
        number('--rate', 'HZ', 500.0, 'samples per second'),
        number('--torque-noise', 'NM', 1e-3, 'of the recorded torque [N m]'),
        option('--first', type=int, default=0, metavar='SEED',
               help='the first seed (default: %(default)s)'),
        WORKERS, out_folder('recovery.json, journal of the seeds', 'recovery'), JSON), ())
add_parser = partial(add_verb, VERB)


def run(args):
    """Try, print and compare; return 1 if what is asked was missed, else 0."""
    robot = load_robot(args.robot or robot_file())
    gains = load_controller(args.controller or controller_file(), robot)
    believed = replace(robot, friction=scaled_friction(robot.friction, args.believed))
    plan = read_identification_plan(
        [args.plan or share_path() / 'config' / 'identification.yaml'], believed, gains)
    trials = trials_of(args, (plan, robot, believed, gains))
    rows = recovered(trials)
    missed = missed_of(rows, trials)
    figures = json.dumps({
        'seeds': [one.seed for one in trials], 'rate': args.rate,
        'torque_noise': args.torque_noise,
        'parameters': [{**row._asdict(), 'covered': row.covered if row.identified else None}
                       for row in rows],
        'curve': [[value if math.isfinite(value) else None for value in one.curve]
                  for one in trials], 'blocks': [one.blocks for one in trials],
        'missed': missed}, indent=2, allow_nan=False)
    write_text(Path(args.out) / 'recovery.json', figures + '\n')
    print(figures if args.json else '\n'.join([
        table(rows), summary(rows, trials), *(f'MISSED: {sentence}' for sentence in missed)]))
    return int(bool(missed))


def trials_of(args, setting):
    """Return the Trial of each seed; those in the journal of --out are not done again."""
    plan, robot, _, gains = setting
    asked = json.dumps([robot_values(robot), controller_values(gains, robot.joints), asdict(plan),
                        args.believed, args.rate, args.torque_noise],
                       default=np.ndarray.tolist)
    own = fingerprint(('recover.py',), Path(__file__).parent)
    items = {f'seed {seed}': TrialItem(*setting, seed, args.rate, args.torque_noise)
             for seed in range(args.first, args.first + args.seeds)}
    found = run_kept(try_item, items, args, f'{fingerprint(SOURCES)} {own} {digest_of(asked)}',
                     'seeds')
    return [from_values(values) for values in found.values()]


def table(rows):
    """Return the rows as aligned text."""
    return align(['parameter', 'true', 'median', 'worst error', 'interval holds',
                  'has interval'],
                 [[row.name.removeprefix('friction.'), f'{row.true:.5g}', f'{row.middle:.5g}',
                   f'{100 * row.worst:.2f} %',
                   f'{100 * row.covered:.0f} %' if row.identified else '-',
                   f'{100 * row.identified:.0f} %']
                  for row in rows])


def summary(rows, trials):
    """Return coverage and the presliding curve in two lines."""
    counts = np.array([row.trials * row.identified for row in rows])
    holds = np.nansum([row.covered for row in rows] * counts)
    covered = 100 * holds / max(counts.sum(), 1.0)
    curves = 100 * np.array([one.curve for one in trials])
    worst = ', '.join(f'{value:.2f} %' for value in curves.max(axis=0))
    return (f'95 % intervals hold the truth in {covered:.1f} % of cases\npresliding curve at most '
            f'{worst} of F_s off, any displacement, any seed')


def missed_of(rows, trials):
    """Return a sentence for each thing that was asked and missed."""
    missed = [f'{row.name}: {100 * row.worst:.1f} % off, asked {100 * ASKED[kind]:.0f} %'
              for row in rows if (kind := row.name.rsplit('.', 1)[-1]) in ASKED
              and row.worst > ASKED[kind]]
    curves = [value for one in trials for value in one.curve]
    if not all(map(math.isfinite, curves)):
        missed.append('presliding curve: no stiffness of a joint is identifiable')
    worst = max(filter(math.isfinite, curves), default=0.0)
    if worst > CURVE:
        missed.append(f'presliding curve: {100 * worst:.1f} % of F_s off, asked '
                      f'{100 * CURVE:.0f} %')
    return missed


class Trial(NamedTuple):
    """One identification of a robot that is known."""

    seed: int
    estimates: tuple   # of (Estimate, true value), those of friction of all joints
    blocks: tuple      # number of blocks chosen for each joint
    curve: tuple       # largest error of the presliding curve of each joint, over F_s
    seconds: float


class Recovered(NamedTuple):
    """One parameter over all trials."""

    name: str
    true: float
    middle: float      # median estimate
    worst: float       # largest relative error
    covered: float     # share of intervals that hold the truth; NaN without any
    identified: float  # share of trials with an interval
    trials: int


class TrialItem(NamedTuple):
    """A trial to be done, perhaps in another process; see `trial`."""

    plan: object
    robot: object
    believed: object
    gains: object
    seed: int
    rate: float
    torque_noise: float


def try_item(item):
    """Return the Trial of a TrialItem as `as_values` does."""
    *setting, seed, rate, torque_noise = item
    return as_values(trial(*setting, seed, rate=rate, torque_noise=torque_noise))


def as_values(one):
    """Return a Trial as plain values for JSON, from which `from_values` makes it again."""
    pairs = [[*estimate._replace(value=_written(estimate.value),
                                 interval=[*map(_written, estimate.interval)]), _written(true)]
             for estimate, true in one.estimates]
    return {**one._asdict(), 'estimates': pairs, 'blocks': [*map(int, one.blocks)],
            'curve': [*map(_written, one.curve)]}


def _written(number):
    """Return a float; as text what JSON has no number for."""
    return float(number) if math.isfinite(number) else str(float(number))


def from_values(values):
    """Return the Trial of what `as_values` returned."""
    pairs = []
    for *fields, true in values['estimates']:
        estimate = Estimate(*fields)
        pairs.append((estimate._replace(
            value=float(estimate.value), interval=Interval(*map(float, estimate.interval)),
            flags=tuple(estimate.flags)), float(true)))
    return Trial(**{**values, 'estimates': tuple(pairs), 'blocks': tuple(values['blocks']),
                    'curve': tuple(map(float, values['curve']))})


def trial(plan, robot, believed, gains, seed, *, rate, torque_noise, options=None):
    """
    Simulate an experiment and identify it; return the Trial.

    ``believed`` is the robot as controller and identification believe it to be. ``rate`` in
    samples per second [Hz], ``torque_noise`` of the recorded torque [N m].
    """
    take = simulate_identification(plan, robot, gains, seed, rate=rate,
                                   torque_noise=torque_noise, model=believed)
    found = identify([take], believed, options=options)
    pairs = []
    for result in found.joints:
        known = known_values(robot, found.robot, result.joint)
        pairs += [(estimate, known[estimate.name]) for estimate in result.estimates
                  if estimate.name in known]
    return Trial(seed, tuple(pairs),
                 tuple(next(c.n_blocks for c in result.candidates if c.chosen)
                       for result in found.joints),
                 tuple(presliding_difference(result, robot)[0] for result in found.joints),
                 found.seconds)


def recovered(trials):
    """
    Return how each parameter came out over all trials, one or more.

    Block stiffnesses only of trials with as many blocks as the truth.
    """
    groups = {}
    for one in trials:
        for estimate, true in one.estimates:
            groups.setdefault(estimate.name, []).append((estimate, true))
    rows = []
    for name, pairs in groups.items():
        values = np.array([estimate.value for estimate, _ in pairs])
        truth = np.array([true for _, true in pairs])
        holds = [e.interval.low <= true <= e.interval.high for e, true in pairs
                 if np.isfinite(e.interval).all()]
        rows.append(Recovered(
            name, float(truth[0]), float(np.median(values)),
            float(np.max(np.abs(values / truth - 1.0))),
            float(np.mean(holds)) if len(holds) else np.nan, len(holds) / len(pairs),
            len(pairs)))
    return tuple(rows)
