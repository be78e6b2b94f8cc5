# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Hidden effects on a six-axis and a seven-axis arm: what the workflow finds, with which resources.

    .venv/bin/python -m bench hidden-arms --seeds 0:10 --kinds single clean double outside

MuJoCo is the robot, gravity on. Masses, stiffnesses and friction are believed with errors of the
size of their priors. Every robot is asked for in a process of its own. With ``--identified``
nothing is known of friction: it is identified in the same recording, as a user does, and wrong
levels of friction are then no effects.

A free run begins with readings and ends with the true robot's own error: free runs are judged
above what the true parameters leave on the same recording, where what is missing shows in them.
"""

from dataclasses import replace
import json
from multiprocessing import get_context
from pathlib import Path
import resource
import time
from types import SimpleNamespace
from typing import NamedTuple

from bench.hidden_arms.plant import Hidden, PERIOD, recording_of, reference_of, with_change
from bench.hidden_robots import outsiders
from bench.hidden_robots.hide import seeds_of
from bench.hidden_robots.truth import Disturbance
from gms_flex_control.answer import align
from gms_flex_control.data.recording import Recording
from gms_flex_control.discrepancy.gap import free_rms
from gms_flex_control.discrepancy.result import COMPLETE, UNEXPLAINED
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.file_io import write_text
from gms_flex_control.identification.identify import identify
from gms_flex_control.identification.output import with_friction_of
from gms_flex_control.params.robot import EffectSpec, RobotParams, WHOLE_ARM
from gms_flex_control.schema.files import load_robot
import numpy as np

ARMS = {'industrial': 'industrial_arm', 'light': 'light_arm'}
_EXAMPLES = Path(__file__).parents[2] / 'examples'
_SPRING = ('backlash', 'stiffness_error')
_OF_JOINT = (*_SPRING, 'coulomb_error', 'viscous_error', 'position_friction', 'load_friction',
             'torque_ripple', 'torque_gain', 'constant_link_torque', 'quadratic_drag',
             'link_inertia_error', 'motor_inertia_error', 'input_delay')
_OF_ARM = ('gravity_tilt', 'tip_payload')
_OF_FRICTION = ('coulomb_error', 'viscous_error')  # right values, where it is identified
_INERTIA_SD, _STIFFNESS_SD, _FRICTION_SD = 0.01, 0.01, 0.01  # of what is believed
NOISES = (0.01, 0.03, 0.06)  # of Coulomb friction
KINDS = ('single', 'clean', 'double', 'outside')
_SHOWS = 2.0          # squared free-run error over that of the truth, from which it is judged


class Job(NamedTuple):
    """One hidden robot."""

    arm: str
    kind: str
    seed: int
    seconds: float
    identified: bool = False  # friction, in the same recording, instead of being believed


class Case(NamedTuple):
    """One hidden robot and its recording."""

    believed: RobotParams
    true: RobotParams       # with what is hidden, as far as the catalogue has it
    hidden: tuple           # of Hidden
    outside: str            # disturbance and joint from outside the catalogue, or ''
    motors_only: bool
    noise: float
    recording: Recording


class Outcome(NamedTuple):
    """What was hidden and what was answered."""

    hidden: str
    motors_only: bool
    noise: float
    answer: str        # verdict and the first names
    right: bool        # named first, of the joint; of two, both; of none, as KINDS require
    wrong: bool        # another is named first, of which the answer does not say that it may be it
    free_ratio: float  # error of free runs, after over before
    free_above: float  # likewise, both above that of the true robot; NaN where it does not show
    took: float        # [s]
    megabytes: float   # largest, of the process
    coulomb_off: float = np.nan  # F_c identified over the true one, less 1, of the worst joint


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
        'load_friction': {'ratio': size / 5.0, 'reach': 1e-3},
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


def disturbance_of(robot: RobotParams, seconds: float, rng: np.random.Generator) -> Disturbance:
    """Draw a disturbance from outside the catalogue."""
    j = int(rng.integers(robot.n_joints))
    name = str(rng.choice(outsiders.NAMES))
    angle, rate = reference_of(robot, seconds, np.random.default_rng(0))[:, :2, j].T
    return outsiders.draw_disturbance(rng, name, j, SimpleNamespace(
        static=robot.friction.forward.static[j], lowest=angle.min(), highest=angle.max(),
        speed=np.std(rate), duration=seconds), round(seconds / PERIOD), PERIOD)


def case_of(job: Job) -> Case:
    """Draw a robot and move it."""
    believed = load_robot(_EXAMPLES / ARMS[job.arm] / 'robot.yaml')
    rng = np.random.default_rng([job.seed, KINDS.index(job.kind), list(ARMS).index(job.arm)])
    base, hidden, disturbance = robot_near(believed, rng), [], None
    while len(hidden) < {'single': 1, 'double': 2}.get(job.kind, 0):
        one = hidden_of(believed, rng)
        if one.name not in [other.name for other in hidden]:
            hidden.append(one)
    if job.kind == 'outside':
        disturbance = disturbance_of(believed, job.seconds, rng)
    noise, motors_only = float(rng.choice(NOISES)), bool(rng.random() < 0.5)
    recording = recording_of(base, believed, hidden, seconds=job.seconds, noise=noise,
                             motors_only=motors_only, seed=job.seed, disturbance=disturbance)
    return Case(believed, truth_of(base, hidden), tuple(hidden), disturbance and (
        f'{disturbance.name} {believed.joints[disturbance.joint]}') or '', motors_only, noise,
        recording)


def truth_of(robot: RobotParams, hidden) -> RobotParams:
    """Return a robot with hidden effects, as parameters or as effects of the catalogue."""
    for one in hidden:
        changed = with_change(robot, one)
        robot = changed if changed is not robot else replace(robot, effects=(
            *robot.effects, EffectSpec(name=one.name, joint=one.joint, values=tuple(
                one.values[parameter.name] for parameter in find(one.name).parameters))))
    return robot


def judged(kind: str, truth: list, verdict: str, findings) -> tuple[bool, bool]:
    """
    Return whether an answer is right, and whether it is wrong.

    ``truth`` are the hidden (effect, joint), ``findings`` those that matter. One that the answer
    calls indistinguishable from the right one is neither.
    """
    names = [one.key for one in findings]
    if kind in ('clean', 'outside'):
        return (not names and verdict == {'clean': COMPLETE, 'outside': UNEXPLAINED}[kind],
                bool(names))
    right = names[:1] == truth if kind == 'single' else set(truth) <= set(names)
    alike = names and any(key in findings[0].indistinguishable_from for key in truth)
    return right, bool(names) and names[0] not in truth and not alike


def free_ratios(found, true: RobotParams) -> tuple[float, float]:
    """Return the error of free runs, after over before, and above what the truth leaves."""
    before, after = (np.sum(one ** 2) for one in (found.gap.free_before, found.gap.free_after))
    likelihood = found.behind.likelihood
    least = np.sum(free_rms(likelihood, likelihood.fitted(
        true, np.zeros(len(likelihood.nuisances)))) ** 2)
    shows = before > _SHOWS * least
    return float(np.sqrt(after / before)), float(np.sqrt(
        max(after - least, 0.0) / (before - least))) if shows else np.nan


def identified(case: Case) -> tuple[RobotParams, float]:
    """Return what is believed with friction as identified, and how far F_c is off at most."""
    found = identify([case.recording], case.believed)
    off = [getattr(found.robot.friction, side).coulomb / getattr(case.true.friction, side).coulomb
           for side in ('forward', 'backward')]
    return with_friction_of(found.robot, found), float(np.abs(np.array(off) - 1.0).max())


def try_job(job: Job) -> Outcome:
    """Simulate one hidden robot and ask the workflow."""
    case, base = case_of(job), _megabytes()
    begun, findings, ratios, off = time.monotonic(), (), (np.nan, np.nan), np.nan
    try:
        believed, off = identified(case) if job.identified else (case.believed, np.nan)
        found = find_discrepancy([case.recording], believed)
        findings, verdict = found.findings, found.verdict
    except GmsFlexError as error:
        found, verdict = None, f'error: {error}'
    took = time.monotonic() - begun
    if found and found.gap and job.kind in ('single', 'double'):
        ratios = free_ratios(found, case.true)
    truth = [(one.name, one.joint) for one in case.hidden
             if not (job.identified and one.name in _OF_FRICTION)]
    right, wrong = judged(job.kind, truth, verdict, findings)
    return Outcome(
        ', '.join(one.name + f' {one.joint} ' + ' '.join(
            f'{key} {value:.3g}' for key, value in one.values.items())
            for one in case.hidden) or case.outside or 'nothing', case.motors_only, case.noise,
        f'{verdict} ' + ', '.join(' '.join(one.key) for one in findings[:3]),
        right, wrong, *ratios, took, max(_megabytes(), base), off)


def _megabytes():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def add_parser(subparsers) -> None:
    """Add the verb to the tool's parser."""
    parser = subparsers.add_parser(
        'hidden-arms', help='effects hidden in arms in space that MuJoCo moves',
        description='Hide single effects in a six-axis and a seven-axis arm, two, nothing, or a '
                    'disturbance that is in no catalogue; print what discrepancy names, time and '
                    'memory, as they come, and how many are right.')
    parser.add_argument('--seeds', default='0:2', metavar='A:B', help='of robots of each kind')
    parser.add_argument('--kinds', nargs='+', choices=KINDS, default=list(KINDS))
    parser.add_argument('--arms', nargs='+', choices=ARMS, default=list(ARMS))
    parser.add_argument('--seconds', type=float, default=20.0, metavar='S',
                        help='of each recording (default: %(default)g)')
    parser.add_argument('--identified', action='store_true',
                        help='friction is not known, but identified in the same recording')
    parser.add_argument('--out', metavar='FILE', help='outcomes as JSON; those there are kept')
    parser.set_defaults(run=run)


def run(args) -> int:
    """Ask, print each outcome and their figures; return 0."""
    jobs = [Job(arm, kind, seed, args.seconds, args.identified) for seed in seeds_of(args.seeds)
            for kind in args.kinds for arm in args.arms]
    found, context = kept(args.out), get_context('spawn')
    for job in jobs:
        if job in found:
            continue
        with context.Pool(1, maxtasksperchild=1) as pool:
            found[job] = outcome = pool.apply(try_job, (job,))
        print(f'{job.arm} {job.kind} {job.seed}: {outcome.hidden}'
              f'{", motors only" if outcome.motors_only else ""}, noise {outcome.noise:g} -> '
              f'{outcome.answer} [{"right" if outcome.right else "-"}'
              f'{", wrong" if outcome.wrong else ""}] free {outcome.free_ratio:.2f}, above the '
              f'truth {outcome.free_above:.2f}, {outcome.took:.0f} s, '
              f'{outcome.megabytes:.0f} MB'
              f'{f", F_c off by {outcome.coulomb_off:.1%} at most" if job.identified else ""}',
              flush=True)
        if args.out:
            keep(args.out, found)
    print(align(['kind', 'encoders', 'robots', 'right', 'wrong', 'free runs', 'above the truth',
                 'time [s]', 'memory [MB]'], figures(found)))
    return 0


def keep(path, found: dict) -> None:
    """Write outcomes by job as JSON."""
    write_text(path, json.dumps([{**one._asdict(), **two._asdict()} for one, two in found.items()],
                                indent=1) + '\n')


def kept(path) -> dict:
    """Return the outcomes of a file by job, none where there is no file."""
    if not path or not Path(path).exists():
        return {}
    return {Job(**{key: one[key] for key in Job._fields if key in one}): Outcome(**{
        key: one[key] for key in Outcome._fields if key in one})
        for one in json.loads(Path(path).read_text())}


def figures(found: dict) -> list:
    """Return rows of the table, by kind and encoders."""
    rows = []
    for kind in KINDS:
        for motors_only, words in ((False, 'both'), (True, 'motors')):
            own = [two for one, two in found.items()
                   if one.kind == kind and two.motors_only == motors_only]
            if own:
                rows.append([kind, words, f'{len(own)}', f'{sum(one.right for one in own)}',
                             f'{sum(one.wrong for one in own)}',
                             *(_median([getattr(one, name) for one in own])
                               for name in ('free_ratio', 'free_above')),
                             f'{np.median([one.took for one in own]):.0f}',
                             f'{max(one.megabytes for one in own):.0f}'])
    return rows


def _median(values):
    known = [one for one in values if np.isfinite(one)]
    return f'{np.median(known):.2f} of {len(known)}' if known else '-'
