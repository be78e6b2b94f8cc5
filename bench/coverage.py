# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
`python -m bench coverage`: how often the intervals of `gms_flex identify` hold the true friction.

Each seed is another rigid axis with four Maxwell blocks. Of the shipped example, whose friction is
that of config/robot.yaml, the intervals are counted as well. A killed run goes on when started
again with the same --out.
"""

from collections import defaultdict
from dataclasses import replace
from functools import partial
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from bench.hidden_robots.hide import seeds_of
from bench.identification_simulated import simulate_identification
from bench.journal import fingerprint, run_kept
from bench.known import known_presliding, known_values
from gms_flex_control.answer import align
from gms_flex_control.cli.options import add_verb, option, out_folder, Verb, WORKERS
from gms_flex_control.data.reader import read_experiment_of
from gms_flex_control.data.recording import Recording
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.experiment.identification_plan import plan_identification
from gms_flex_control.experiment.simulated import scaled_friction
from gms_flex_control.file_io import write_text
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import (
    EncoderParams,
    FrictionParams,
    RobotParams,
    StribeckParams,
)
from gms_flex_control.schema.files import load_robot, save_values
from gms_flex_control.simulation.loop import Loop
from gms_flex_control.trajectory import builders
import numpy as np

HERE = Path(__file__).resolve().parent
JOINT = 'joint1'
RATE, SUBSTEPS = 250.0, 40         # [Hz], integration steps in a sample
SECONDS = 30.0                     # of sinusoids and of moves
NOISES = (0.0, 0.01, 0.03, 0.06)   # of the recorded torque, standard deviation over F_s
ALL = (1, 2, 4, 6, 8)
BLOCKS = {'right': ALL, 'too few': (1,)}  # numbers that may be chosen; the axes have four
PLAN = {
    'speeds': 5, 'repeats': 1, 'dwell_time': 0.6, 'counts': 12.0, 'rest_time': 0.1,
    'torque_rate': 0.5, 'break_away_repeats': 1, 'presliding_levels': (0.45, 0.75),
    'presliding_places': 1, 'sliding_speeds': (1.0, 3.0), 'sliding_duration': 3.0,
    f'{JOINT}.lower': -1.6, f'{JOINT}.upper': 1.6, f'{JOINT}.velocity': 2.5,
    f'{JOINT}.acceleration': 6.0}
GAINS = ControllerParams(
    compensation='gms', kd_link=[0.8], lambda_link=[3.0], kd_motor=[0.22], lambda_motor=[40.0],
    observer_gain=[1.0], sign_slope=[50.0], filter_bandwidth=[100.0], torque_limit=[2.0])
CURVE = 'presliding curve'


VERB = Verb(
    'coverage', lambda args: run(args),
    'how often intervals of identify hold the truth, on simulated axes',
    'Identify simulated axes with known friction, and count how often the intervals that gms_flex '
    'identify prints hold it. A killed run goes on when started again with the same --out.', (
        option('--seeds', default='100:104', metavar='A:B',
               help='robots, from A up to, not including, B (default: 100:104)'),
        option('--motions', nargs='+', choices=('plan', 'sinusoids', 'moves'),
               default=['plan', 'sinusoids', 'moves']),
        option('--noises', nargs='+', type=float, default=NOISES, metavar='SHARE',
               help='of F_s (default: %(default)s)'),
        WORKERS, out_folder('coverage.json and coverage.md')), ())
add_parser = partial(add_verb, VERB)


def run(args):
    """Identify, count, print and write; return 0."""
    items = {' '.join(map(str, case)): case for case in cases_of(args)}
    outcomes = list(run_kept(try_case, items, args, fingerprint() + fingerprint(
        ('coverage.py',), HERE), 'identifications').values())
    *both, total = tables(outcomes)
    write_text(Path(args.out) / 'coverage.json', json.dumps(outcomes, indent=1))
    write_text(Path(args.out) / 'coverage.md',
               '\n\n'.join(markdown(*one) for one in both) + '\n')
    print('\n\n'.join([*(align(header, rows) for header, rows in both), f'all: {total}']))
    return 0


class Case(NamedTuple):
    """One identification."""

    motion: str
    noise: float
    blocks: str
    seed: int


def axis(seed):
    """Return a rigid axis like the paper's second, its friction drawn at random."""
    rng = np.random.default_rng([seed, 3])

    def between(low, high):
        return np.exp(rng.uniform(np.log(low), np.log(high), 1))
    static, sides = between(0.08, 0.13), []
    for _ in range(2):
        level = static * between(0.93, 1.07)
        sides.append(StribeckParams(static=level, coulomb=level * between(0.75, 0.92),
                                    velocity=between(0.01, 0.1), viscous=between(0.003, 0.06)))
    mean = 0.5 * (sides[0].static + sides[1].static)
    yields = [length * float(between(0.6, 1.6)[0]) for length in (0.15, 4.4e-3, 1.3e-3, 4.4e-4)]
    arm = ArmParams(kind='decoupled', mass=[0.0], length=[0.0], com=[0.0], inertia=[0.03],
                    motor_inertia=[0.005], stiffness=[np.inf], damping=[0.0])
    friction = FrictionParams(
        forward=sides[0], backward=sides[1], attraction=between(0.5, 2.0),
        weight=np.full((1, 4), 0.25), stiffness=[0.25 * mean / np.array(yields)])
    return RobotParams(joints=(JOINT,), motors=('',), arm=arm, friction=friction,
                       encoder=EncoderParams(counts=20000.0, velocity_cutoff=50.0))


def recorded(motion, robot, believed, seed):
    """Return (Recording, phases) of a motion, its torque without noise."""
    if motion == 'plan':
        plan = plan_identification({f'identification.{name}': value
                                    for name, value in PLAN.items()}, believed, GAINS)
        return simulate_identification(plan, robot, GAINS, seed, rate=RATE, torque_noise=0.0,
                                       model=believed)
    rng = np.random.default_rng([seed, 4])
    loop = Loop(robot, believed, period_ns=round(1e9 / RATE), substeps=SUBSTEPS, seed=seed,
                q_link=rng.uniform(-1e-3, 1e-3, 1))
    pieces = [loop.run(reference, GAINS) for reference in MOTIONS[motion](rng)]
    measured, command, applied = (np.concatenate([getattr(piece, name) for piece in pieces])
                                  for name in ('measured', 'command', 'applied'))
    nothing = np.full_like(command, np.nan)
    return Recording(
        joints=robot.joints, time=np.arange(len(command)) / RATE, q_link=measured[:, 0],
        dq_link=measured[:, 1], q_motor=nothing, dq_motor=nothing, tau_motor=applied,
        command=command, reference=np.full((len(command), 5, 1), np.nan), friction_hat=nothing,
        source=motion), ()


def sinusoids(rng):
    """Yield the reference of a sinusoid, or of two added up."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    amplitudes = np.exp(rng.uniform(np.log(0.1), 0.0, 2))
    periods = rng.uniform(1.5, 6.0, rng.integers(1, 3))
    yield sum(builders.sinusoid(np.array([amplitude]), np.array([period]), ramp_time=1.0).sample(
        time) for amplitude, period in zip(amplitudes, periods, strict=False))


def moves(rng):
    """Yield references of rests and of moves between random places."""
    place, left = 0.0, SECONDS
    while left > 0.0:
        goal, time, rest = rng.uniform(-1.2, 1.2), rng.uniform(0.5, 2.5), rng.uniform(0.1, 0.6)
        way = builders.via_points(np.array([[place], [goal]]), time, rest)
        yield way.sample(np.arange(round((time + 2 * rest) * RATE)) / RATE)
        place, left = goal, left - time - 2 * rest


MOTIONS = {'plan': None, 'sinusoids': sinusoids, 'moves': moves}


def try_case(case):
    """Return what an identification printed of a Case beside the truth, plain values."""
    try:
        robot, found = identified(case)
    except GmsFlexError as error:
        return {**case._asdict(), 'refused': str(error), 'rows': []}
    return {**case._asdict(), 'refused': '', 'rows': [
        row for result in found.joints for row in rows_of(result, robot, found.robot)]}


def identified(case):
    """Return the true robot of a Case, and its Identification."""
    if case.motion == 'example':
        robot, made = example()
        believed = robot
    else:
        robot = axis(case.seed)
        believed = replace(robot, friction=scaled_friction(robot.friction, 0.8))
        made = noisy(recorded(case.motion, robot, believed, case.seed),
                     case.noise * float(robot.friction.forward.static[0]), case.seed)
    return robot, identify([made], believed, options=IdentifyOptions(blocks=BLOCKS[case.blocks]))


def noisy(made, level, seed):
    """Return a recording with white noise on the torque that it recorded [N m]."""
    recording, phases = made
    noise = np.random.default_rng([seed, 5]).standard_normal(recording.tau_motor.shape)
    return replace(recording, tau_motor=recording.tau_motor + level * noise), phases


def example():
    """Return the robot and the recording of examples/arm_with_play, its play known."""
    with TemporaryDirectory() as folder:
        play = Path(folder) / 'play.yaml'
        save_values({'effects.joint2.backlash.half_gap': 0.012}, play)
        robot = load_robot([HERE.parent / 'config' / 'robot.yaml', play])
    return robot, read_experiment_of(str(HERE.parent / 'examples' / 'arm_with_play'), robot)


def rows_of(result, robot, found):
    """Yield name, estimate, truth, low and high end of a joint's parameters; None for no end."""
    known = known_values(robot, found, result.joint)
    for one in result.estimates:
        if one.name in known:
            yield [short(one.name), one.value, known[one.name],
                   *(float(end) if np.isfinite(end) else None for end in one.interval)]
    x, torque, low, high = result.curve
    for k in np.linspace(0, len(x) - 1, 5, dtype=int) if len(x) else ():
        true = float(known_presliding(robot, result.joint, x[k:k + 1])[0])
        yield [CURVE, float(torque[k]), true,
               *(float(end) if np.isfinite(end) else None for end in (low[k], high[k]))]


def short(name):
    """Return the kind of a parameter, 'coulomb' for 'friction.joint1.forward.coulomb'."""
    return name.rsplit('.', 1)[-1].partition('[')[0]


def held(outcomes):
    """Return how many intervals hold the truth, how many there are, and how many could be."""
    rows = [row for one in outcomes for row in one['rows']]
    ends = [row for row in rows if row[3] is not None]
    return sum(low <= true <= high for _, _, true, low, high in ends), len(ends), len(rows)


def cell(counts):
    """Return a share of intervals that hold the truth, its binomial error, and their number."""
    holds, count, most = counts
    if not count:
        return f'- (0 of {most})'
    share = (holds + 1.0) / (count + 2.0)  # Laplace's: an error also where all hold the truth
    return (f'{100 * holds / count:.0f} ± {100 * np.sqrt(share * (1 - share) / count):.0f} % '
            f'({count} of {most})')


def tables(outcomes):
    """Return headers and rows of coverage by condition, and by parameter."""
    groups, kinds = defaultdict(list), defaultdict(lambda: defaultdict(list))
    for one in outcomes:
        groups[one['motion'], one['blocks'], one['noise']].append(one)
        for row in one['rows']:
            kinds[row[0]][one['blocks']].append({'rows': [row]})
    noises = sorted({one['noise'] for one in outcomes})
    conditions = dict.fromkeys((one['motion'], one['blocks']) for one in outcomes)
    by_condition = [(motion, blocks, *(cell(held(groups[motion, blocks, noise])) for noise in
                                       noises)) for motion, blocks in conditions]
    by_parameter = [(kind, *(cell(held(found[blocks])) for blocks in BLOCKS))
                    for kind, found in kinds.items()]
    total = cell(held(outcomes))
    return ((('motion', 'blocks', *(f'noise {100 * noise:g} % of F_s' for noise in noises)),
             by_condition),
            (('parameter', *(f'blocks {blocks}' for blocks in BLOCKS)),
             [*by_parameter, ('all', *(cell(held([one for one in outcomes if one['blocks']
                                                  == blocks])) for blocks in BLOCKS))]), total)


def cases_of(args):
    """Return the cases that are asked for."""
    cases = [Case(motion, noise, blocks, seed) for seed in seeds_of(args.seeds)
             for motion in args.motions for noise in args.noises for blocks in BLOCKS]
    return [*cases, *(Case('example', 0.0, blocks, 0) for blocks in BLOCKS)]


def markdown(header, rows):
    """Return a table as markdown."""
    lines = [header, ['---'] * len(header), *rows]
    return '\n'.join(f"| {' | '.join(line)} |" for line in lines)
