# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Hidden effects on a six-axis and a seven-axis arm: what the workflow finds, with which resources.

    .venv/bin/python -m bench hidden-arms --seeds 0:10 --clean 0:4

MuJoCo is the robot, gravity on. Masses, stiffnesses and friction are believed with errors of the
size of their priors. Every robot is asked for in a process of its own.
"""

from dataclasses import replace
import json
from multiprocessing import get_context
import os
from pathlib import Path
import resource
import time
from typing import NamedTuple

from bench.hidden_arms.plant import Hidden, recording_of
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.errors import ConfigError, GmsFlexError
from gms_flex_control.params.robot import RobotParams, WHOLE_ARM
from gms_flex_control.schema.files import load_robot
import numpy as np

ARMS = {'industrial': 'industrial_arm', 'light': 'light_arm'}
_EXAMPLES = Path(__file__).parents[2] / 'examples'
_SPRING = ('backlash', 'stiffness_error')
_OF_JOINT = (*_SPRING, 'coulomb_error', 'viscous_error', 'position_friction', 'load_friction',
             'torque_ripple', 'torque_gain', 'constant_link_torque', 'quadratic_drag',
             'link_inertia_error', 'motor_inertia_error', 'input_delay')
_OF_ARM = ('gravity_tilt', 'tip_payload')
_INERTIA_SD, _STIFFNESS_SD, _FRICTION_SD = 0.01, 0.01, 0.01  # of what is believed
NOISES = (0.01, 0.03, 0.06)  # of Coulomb friction


class Job(NamedTuple):
    """One hidden robot."""

    arm: str
    seed: int
    clean: bool
    seconds: float


class Outcome(NamedTuple):
    """What was hidden and what was answered."""

    hidden: str
    motors_only: bool
    noise: float
    answer: str        # verdict and the first names
    right: bool        # named first, of the joint
    wrong: bool        # another is named first
    free_ratio: float  # error of free runs, after over before
    seconds: float
    megabytes: float   # largest, of the process


def hidden_of(robot: RobotParams, rng: np.random.Generator) -> Hidden:
    """Draw an effect; its torque is some 20 to 60 % of Coulomb friction."""
    name = str(rng.choice([*_OF_JOINT, *_OF_ARM]))
    if name in _OF_ARM:
        values = {'mass': float(rng.uniform(0.1, 0.4) * robot.arm.mass[-1])}
        if name == 'gravity_tilt':
            values = {'tilt': float(np.radians(rng.uniform(0.5, 2.0))),
                      'direction': float(rng.uniform(-np.pi, np.pi))}
        return Hidden(name=name, joint=WHOLE_ARM, values=values)
    soft = np.flatnonzero(~robot.arm.rigid)
    j = int(rng.choice(soft if name in _SPRING else np.arange(robot.n_joints)))
    level, sign = robot.friction.forward.coulomb[j], float(rng.choice([-1.0, 1.0]))
    size = float(rng.uniform(0.2, 0.6))
    order, phase = float(rng.integers(1, 5)), float(rng.uniform(-np.pi, np.pi))
    values = {
        'backlash': {'half_gap': size * level / robot.arm.stiffness[j]},
        'stiffness_error': {'ratio': sign * float(rng.uniform(0.1, 0.25))},
        'coulomb_error': {'ratio': sign * size}, 'viscous_error': {'ratio': sign * size},
        'position_friction': {'ratio': size, 'order': order, 'phase': phase},
        'load_friction': {'ratio': size, 'load': 5.0 * level},
        'torque_ripple': {'amplitude': size * level, 'order': 4.0 * order, 'phase': phase},
        'torque_gain': {'gain_error': sign * float(rng.uniform(0.06, 0.2))},
        'constant_link_torque': {'bias': sign * size * level},
        'quadratic_drag': {'drag': 2.0 * size * level},
        'link_inertia_error': {'ratio': sign * float(rng.uniform(0.1, 0.3))},
        'motor_inertia_error': {'ratio': sign * float(rng.uniform(0.15, 0.4))},
        'input_delay': {'delay': float(rng.uniform(2e-3, 6e-3))}}[name]
    return Hidden(name=name, joint=robot.joints[j], values=values)


def robot_near(robot: RobotParams, rng: np.random.Generator) -> RobotParams:
    """Return a robot as far from what is believed as beliefs usually are."""
    def off(values, sd):
        return values * (1.0 + sd * rng.standard_normal(np.shape(values)))
    n, friction = robot.n_joints, robot.friction
    arm = robot.arm.scaled(1.0 + _INERTIA_SD * rng.standard_normal(n))
    arm = replace(arm, motor_inertia=off(arm.motor_inertia, _INERTIA_SD),
                  stiffness=off(arm.stiffness, _STIFFNESS_SD))
    level, viscous = (1.0 + _FRICTION_SD * rng.standard_normal((2, n)))
    return replace(robot, arm=arm, friction=friction.each_way(
        lambda steady: steady.scaled(static=level, coulomb=level, viscous=viscous)))


def try_job(job: Job) -> Outcome:
    """Simulate one hidden robot and ask the workflow."""
    believed = load_robot(_EXAMPLES / ARMS[job.arm] / 'robot.yaml')
    rng = np.random.default_rng([job.seed, job.clean, list(ARMS).index(job.arm)])
    true = robot_near(believed, rng)
    hidden = None if job.clean else hidden_of(believed, rng)
    noise, motors_only = float(rng.choice(NOISES)), bool(rng.random() < 0.5)
    recording = recording_of(true, believed, hidden, seconds=job.seconds, noise=noise,
                             motors_only=motors_only, seed=job.seed)
    begun, base = time.monotonic(), _megabytes()
    try:
        found = find_discrepancy([recording], believed)
        names = [(one.effect, one.joint) for one in found.findings]
        verdict, gap = found.verdict, found.gap
    except GmsFlexError as error:
        names, verdict, gap = [], f'error: {error}', None
    truth = None if hidden is None else (hidden.name, hidden.joint)
    ratio = np.nan if gap is None else float(np.sqrt(
        np.nansum(gap.free_after ** 2) / np.nansum(gap.free_before ** 2)))
    first = ', '.join(f'{name} {joint}' for name, joint in names[:3])
    return Outcome(
        'nothing' if hidden is None else f'{hidden.name} {hidden.joint} '
        + ' '.join(f'{key} {value:.3g}' for key, value in hidden.values.items()),
        motors_only, noise, f'{verdict} {first}'.strip(),
        verdict == 'complete' if job.clean else bool(names) and names[0] == truth,
        bool(names) and names[0] != truth, ratio, time.monotonic() - begun,
        max(_megabytes(), base))


def _megabytes():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def add_parser(subparsers) -> None:
    """Add the verb to the tool's parser."""
    parser = subparsers.add_parser(
        'hidden-arms', help='effects hidden in arms in space that MuJoCo moves',
        description='Hide single effects in a six-axis and a seven-axis arm and nothing in '
                    'others; print what discrepancy names, time and memory, as they come.')
    parser.add_argument('--seeds', default='0:5', metavar='A:B', help='of single effects')
    parser.add_argument('--clean', default='0:2', metavar='A:B', help='of robots with none')
    parser.add_argument('--arms', nargs='+', choices=ARMS, default=list(ARMS))
    parser.add_argument('--seconds', type=float, default=20.0, metavar='S',
                        help='of each recording (default: %(default)g)')
    parser.add_argument('--out', metavar='FILE', help='outcomes as JSON')
    parser.set_defaults(run=run)


def _seeds(text, name):
    try:
        first, last = map(int, text.split(':'))
    except ValueError:
        raise ConfigError(f'{name} {text!r}: give A:B, such as 0:10') from None
    return range(first, last)


def run(args) -> int:
    """Ask, print each outcome and their figures; return 0."""
    jobs = [Job(arm, seed, clean, args.seconds) for clean, seeds in (
        (False, _seeds(args.seeds, '--seeds')), (True, _seeds(args.clean, '--clean')))
        for seed in seeds for arm in args.arms]
    found, context = [], get_context('spawn')
    for job in jobs:
        with context.Pool(1, maxtasksperchild=1) as pool:
            outcome = pool.apply(try_job, (job,))
        found.append((job, outcome))
        print(f'{job.arm} {job.seed}{" clean" if job.clean else ""}: {outcome.hidden}'
              f'{", motors only" if outcome.motors_only else ""}, noise {outcome.noise:g} -> '
              f'{outcome.answer} [{"right" if outcome.right else "-"}'
              f'{", wrong" if outcome.wrong else ""}] free {outcome.free_ratio:.2f}, '
              f'{outcome.seconds:.0f} s, {outcome.megabytes:.0f} MB', flush=True)
        if args.out:
            Path(args.out).write_text(json.dumps(
                [{**one._asdict(), **two._asdict()} for one, two in found], indent=1) + os.linesep)
    for title, rows in (('single', [o for j, o in found if not j.clean]),
                        ('clean', [o for j, o in found if j.clean])):
        if rows:
            ratios = [one.free_ratio for one in rows if np.isfinite(one.free_ratio)]
            print(f'{title}: right {sum(one.right for one in rows)} of {len(rows)}, wrong '
                  f'{sum(one.wrong for one in rows)}, free runs {np.median(ratios):.2f}, '
                  f'{np.median([one.seconds for one in rows]):.0f} s, '
                  f'{max(one.megabytes for one in rows):.0f} MB')
    return 0
