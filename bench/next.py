# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench next`: names that a first recording leaves, and motions that separate them."""

from contextlib import suppress
from dataclasses import replace
from functools import partial
import json
from pathlib import Path
import time
from typing import NamedTuple

from bench.hidden_robots import motions, plants, sizes, truth
from bench.hidden_robots.cases import recording_of
from bench.hidden_robots.hide import seeds_of
from bench.journal import fingerprint, run_kept
from gms_flex_control.answer import align
from gms_flex_control.cli.options import add_verb, option, out_folder, Verb, WORKERS
from gms_flex_control.compiled import in_one_thread
from gms_flex_control.design.motions import Candidate, candidates, random_moves
from gms_flex_control.design.plan import clipped, separate
from gms_flex_control.design.separation import beliefs_of, keeps
from gms_flex_control.discrepancy.thresholds import CREDIBLE
from gms_flex_control.errors import ConfigError, GmsFlexError, SimulationError
from gms_flex_control.file_io import write_text
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.reports.figure_style import COLOURS, panels_of, save_figure, WIDTH
import numpy as np

GENTLE = 4.8          # times the time that limits allow to slow swings
PERIOD, FIRST = 2e-3, 6.0       # [s]; of the first recording
FIXED = 'rich', 'random', 'small'  # motions that are compared with designed ones
TIMES = 5.0, 10.0, 20.0         # of robot time at which the fixed motions are judged [s]
BUDGET, ODDS = 20.0, 99.0       # robot time of the designed motions [s]; odds wanted
NARROW = 0.5                    # share of first recordings that are; the others are random moves
_DRAWS, _TRIES, _SMALLER = 12, 12, 0.7  # robots, sizes of a hidden effect, until two are left
NOTHING = frozenset()           # no effect is missing
_SEED = 27                      # stream of random numbers, of no other bench
_STEP, _MOVE, _HOLD = 0.3, 1.5, 0.5  # small moves by hand: at most [rad], time of each, rest [s]
_SOURCES = ('discrepancy', 'design', 'effects', 'simulation')
ONE_WAY = {'trajectory.type': 'via_points', 'trajectory.move_time': 2.0,
           'trajectory.hold_time': 0.0, 'trajectory.joint1.points': [0.0, 0.3, 0.6, 0.9],
           'trajectory.joint2.points': [0.0, 0.4, 0.8, 1.2]}
CREEPING = {'trajectory.type': 'velocity_levels', 'trajectory.durations': [8.0],
            'trajectory.ramp_time': 1.0, 'trajectory.joint1.velocities': [0.1],
            'trajectory.joint2.velocities': [0.15]}


def swings(amplitude, period, ramp=2.0):
    """Return parameters of sinusoids of both joints."""
    return {'trajectory.type': 'sinusoid', 'trajectory.ramp_time': ramp} | {
        f'trajectory.joint{j + 1}.{name}': values[j]
        for j in range(2) for name, values in (('amplitude', amplitude), ('period', period))}


class Family(NamedTuple):
    """Effects that one kind of recording does not separate."""

    effects: tuple   # of (effect, index of the joint)
    motion: dict     # narrow, that shows all of them alike


FAMILIES = {
    'payload, inertia': Family((('tip_payload', 0), ('link_inertia_error', 1)),
                               swings((0.0, 0.5), (3.0, 3.0))),
    'stiffness, torque gain': Family((('stiffness_error', 1), ('torque_gain', 1)),
                                     swings((0.3, 0.3), (4.0, 5.0))),
    'spring offset, link torque, eccentricity': Family(
        (('spring_offset', 1), ('constant_link_torque', 1), ('link_encoder_eccentricity', 1)),
        swings((0.1, 0.1), (3.0, 4.0))),
    'lag, delay': Family((('actuator_lag', 1), ('input_delay', 1)),
                         CREEPING),
    'backlash, spring offset': Family((('backlash', 1), ('spring_offset', 1)), CREEPING),
    'friction asymmetry, link torque': Family(
        (('friction_asymmetry', 1), ('constant_link_torque', 1)), ONE_WAY),
    'friction drift, load friction': Family((('friction_drift', 1), ('load_friction', 1)),
                                            swings((0.3, 0.3), (3.0, 3.0), FIRST))}


class Item(NamedTuple):
    """One robot to be tried."""

    family: str
    seed: int

    @property
    def key(self) -> str:
        """Return a name of its own."""
        return f'{self.family}/{self.seed}'


class Robot(NamedTuple):
    """A hidden robot whose first recording leaves two names or more."""

    true: object        # RobotParams
    believed: object
    gains: object
    limits: Limits
    effect: frozenset   # of (effect, joint), hidden
    sets: list          # left by the first recording
    first: object       # Recording
    plant: str          # 'soft' or 'stiff'
    motion: str         # of the first recording, 'narrow' or 'random'


VERB = Verb(
    'next', lambda args: run(args),
    'designed motions beside rich and random ones, on hidden robots',
    'Hide an effect in robots whose first recording leaves two names or more. Count how many are '
    'resolved rightly by so much robot time of designed motions, of the rich motion and of random '
    'moves. A killed run goes on.', (
        option('--seeds', default='0:2', metavar='A:B',
               help='of each family of effects (default: %(default)s)'),
        option('--families', nargs='*', default=list(FAMILIES), metavar='NAME', choices=FAMILIES,
               help='default: all'),
        WORKERS, out_folder('next.json, next_bench.png, journal', 'next')), ())
add_parser = partial(add_verb, VERB)


def run(args) -> int:
    """Try all, write and print the figures; return 0."""
    items = [Item(family, seed) for seed in seeds_of(args.seeds) for family in args.families]
    found = run_kept(tried, {item.key: item for item in items}, args,
                     fingerprint(_SOURCES) + fingerprint(('next.py',), Path(__file__).parent),
                     'robots')
    rows = [one for one in found.values() if one]
    write_text(Path(args.out) / 'next.json', json.dumps(rows, indent=1) + '\n')
    print('\n\n'.join(text_of(rows)))
    if rows:
        save_figure(figure_of(rows), Path(args.out) / 'next_bench.png')
    return 0


# --- one robot ----------------------------------------------------------------------------------


def tried(item) -> dict | None:
    """Return what becomes of an Item as plain values; None if no draw leaves two names."""
    with in_one_thread(), np.errstate(all='ignore'):
        robot = draw(item)
        if robot is None:
            return None
        kept = []
        row = {'family': item.family, 'seed': item.seed, 'plant': robot.plant,
               'first': robot.motion, 'hidden': ' '.join(*robot.effect),
               'left': [' '.join(sorted(one)[0]) for one in robot.sets],
               'designed': _designed(robot, item, kept)}
        rng = np.random.default_rng([_SEED, item.seed, 1])
        grid = PERIOD * np.arange(round(TIMES[-1] / PERIOD))
        for name, reference in (
                ('rich', motions.draw_reference(rng, 'rich', robot.plant, grid)),
                ('random', random_moves(robot.limits, robot.true.joints, item.seed).trajectory(
                    robot.true.joints).sample(grid)),
                ('small', small_moves(robot.limits, robot.true.joints, item.seed).trajectory(
                    robot.true.joints).sample(grid))):
            row[name] = _judged(robot, reference, item.seed)
        return row | {'kept_limits': all(kept)}


def small_moves(limits, joints, seed) -> Candidate:
    """Return small moves to and fro through random postures, as a person jogs an arm."""
    rng, places = np.random.default_rng([_SEED, seed, 2]), [np.zeros(len(joints))]
    while len(places) * (_MOVE + _HOLD) < BUDGET + _MOVE:
        places.append(np.clip(places[-1] + rng.uniform(-_STEP, _STEP, len(joints)),
                              limits.lower, limits.upper))
    return Candidate('small_moves', 'small random moves', {
        'trajectory.type': 'via_points', 'trajectory.move_time': _MOVE,
        'trajectory.hold_time': _HOLD} | {
        f'trajectory.{joint}.points': [float(one[j]) for one in places]
        for j, joint in enumerate(joints)})


def draw(item) -> Robot | None:
    """
    Draw a Robot whose first recording shows that something is missing, and leaves two names.

    As `discrepancy` does: no name has 95 % of the probability.
    """
    rng = np.random.default_rng([_SEED, list(FAMILIES).index(item.family), item.seed])
    for _ in range(_DRAWS):
        with suppress(GmsFlexError):
            found = _drawn(rng, item, FAMILIES[item.family])
            if found is not None:
                return found
    return None


def _drawn(rng, item, family):
    """Return a Robot with smaller and smaller effects until two names are left, or None."""
    plant = str(rng.choice(plants.PLANTS))
    robot, gains = plants.draw_robot(rng, plant)
    believed = plants.draw_belief(rng, robot)
    limits = Limits(torque=gains.torque_limit, torque_rate=[100.0] * 2, velocity=[1.5, 2.0],
                    velocity_margin=[0.5] * 2, lower=[-1.2] * 2, upper=[1.2] * 2,
                    position_margin=[0.1] * 2, torsion=1.0 / robot.arm.stiffness)
    sets = [frozenset({(name, 'arm' if name == 'tip_payload' else robot.joints[j])})
            for name, j in family.effects]
    hidden, (name, j) = (some[item.seed % len(sets)] for some in (sets, family.effects))
    narrow, grid = rng.random() < NARROW, PERIOD * np.arange(round(FIRST / PERIOD))
    reference, slow = (one.trajectory(robot.joints).sample(grid) for one in (
        Candidate('narrow', '', family.motion) if narrow else random_moves(
            limits, robot.joints, int(rng.integers(1000, 2000))), next(
                one for one in candidates(limits, robot.joints, GENTLE)
                if one.name == 'slow_swings')))
    bare = truth.simulate(robot, believed, gains, reference, period=PERIOD)
    given = sizes.MAIN[name](rng, sizes.figures_of(robot, bare, PERIOD)[j])
    size = next(iter(given))
    for _ in range(_TRIES):
        true = replace(robot, effects=(sizes.spec(name, j, robot.joints, given),))
        first = drive(true, believed, gains, reference, item.seed)[1]
        beliefs = beliefs_of([first], believed, [*sets, NOTHING])
        evidence = {one.effects: one.evidence for one in beliefs.hypotheses}
        if max(evidence.values()) - evidence[NOTHING] < 2.0 * np.log(ODDS):
            return None  # and a smaller one shows less
        left = beliefs.left(np.log(ODDS))
        names = [one.effects for one in left.hypotheses if one.effects != NOTHING]
        if (left.probabilities[0] < CREDIBLE and len(names) > 1 and hidden in names
                and keeps(drive(true, believed, gains, slow, item.seed)[0], limits)):
            return Robot(true, believed, clipped(gains, limits), limits, hidden, names, first,
                         plant, 'narrow' if narrow else 'random')
        given = given | {size: _SMALLER * given[size]}
    return None


def drive(true, believed, gains, reference, seed):
    """Return the hidden Motion of a robot along a reference (T, 5, n), and its Recording."""
    motion = truth.simulate(true, believed, gains, reference, period=PERIOD, seed=seed)
    return motion, recording_of(motion, reference, PERIOD * np.arange(len(reference)), true, True,
                                'hidden robot', None)


def _designed(robot, item, kept):
    """Return robot time, time to design and what is left with designed motions."""
    def driven(plan, number):
        reference = plan.best.candidate.trajectory(robot.true.joints).sample(
            PERIOD * np.arange(round(plan.best.duration / PERIOD)))
        motion, recording = drive(robot.true, robot.believed, robot.gains, reference,
                                  1000 * number + item.seed)
        kept.append(keeps(motion, robot.limits))
        return recording

    begun = time.process_time()
    try:
        found = separate([robot.first], robot.believed, robot.sets, robot.gains, robot.limits,
                         driven, period=PERIOD, odds=ODDS, budget=BUDGET, longest=BUDGET)
    except ConfigError:  # every motion would cross a limit
        return {'time': 0.0, 'verdict': 'refused', 'rounds': 0,
                'seconds': time.process_time() - begun, 'answer': 'open'}
    return {'time': found.spent, 'verdict': found.verdict, 'rounds': len(found.rounds),
            'seconds': time.process_time() - begun,
            'answer': _answer(robot, [one.effects for one in found.left])}


def _judged(robot, reference, seed):
    """Return what so much time of a fixed motion leaves, by time, and whether limits are kept."""
    try:
        motion, _ = drive(robot.true, robot.believed, robot.gains, reference, 77 + seed)
    except SimulationError:
        return {'answers': ['open'] * len(TIMES), 'kept_limits': False}
    answers = []
    for duration in TIMES:
        _, recording = drive(robot.true, robot.believed, robot.gains,
                             reference[:round(duration / PERIOD)], 77 + seed)
        beliefs = beliefs_of([robot.first, recording], robot.believed, robot.sets)
        answers.append(_answer(robot, [
            one.effects for one in beliefs.left(np.log(ODDS)).hypotheses]))
    return {'answers': answers, 'kept_limits': keeps(motion, robot.limits)}


def _answer(robot, left):
    """Return 'right', 'wrong' or 'open'."""
    return 'open' if len(left) > 1 else 'right' if left[0] == robot.effect else 'wrong'


# --- words --------------------------------------------------------------------------------------


def shares(rows) -> dict:
    """Return the share resolved rightly at each of `TIMES` by kind of motion, dict of list."""
    designed = [np.mean([one['designed']['answer'] == 'right' and one['designed']['time'] <= at
                         for one in rows]) for at in TIMES]
    return {'designed': designed} | {name: [np.mean([
        one[name]['answers'][k] == 'right' for one in rows]) for k in range(len(TIMES))]
        for name in FIXED}


def text_of(rows):
    """Yield tables of the figures."""
    yield align(['hidden', 'left', 'plant', 'first', 'designed', 's', *FIXED], [
        [one['hidden'], str(len(one['left'])), one['plant'], one['first'],
         one['designed']['answer'], f'{one["designed"]["time"]:.0f}',
         *('/'.join(one[name]['answers']) for name in FIXED)] for one in rows])
    if not rows:
        return
    yield align(['resolved rightly', *(f'{at:g} s' for at in TIMES)], [
        [name, *(f'{100.0 * share:.0f} %' for share in values)]
        for name, values in shares(rows).items()])
    wrong = {name: sum(one[name]['answers'][-1] == 'wrong' for one in rows) for name in FIXED}
    yield (f'{len(rows)} robots. Resolved wrongly: designed '
           f'{sum(one["designed"]["answer"] == "wrong" for one in rows)}, '
           f'{", ".join(f"{name} {count}" for name, count in wrong.items())}. '
           'Limits crossed by designed motions: '
           f'{sum(not one["kept_limits"] for one in rows)}. Processor time to design and update, '
           f'median {np.median([one["designed"]["seconds"] for one in rows]):.0f} s, most '
           f'{max(one["designed"]["seconds"] for one in rows):.0f} s.')


def figure_of(rows):
    """Return the shares resolved rightly over robot time."""
    figure, panels = panels_of(1, 1, (0.6 * WIDTH, 3.0))
    at = np.sort([one['designed']['time'] for one in rows
                  if one['designed']['answer'] == 'right'])
    panels[0, 0].step([0.0, *at, TIMES[-1]], [*(np.arange(len(at) + 1) / len(rows)),
                                              len(at) / len(rows)], where='post',
                      color=COLOURS[0], label='designed')
    for k, name in enumerate(FIXED, 1):
        panels[0, 0].plot([0.0, *TIMES], [0.0, *shares(rows)[name]], 'o-', color=COLOURS[k],
                          label=name)
    panels[0, 0].set(xlabel='robot time after the first recording [s]',
                     ylabel='share resolved rightly', ylim=(0.0, 1.0))
    panels[0, 0].legend(frameon=False)
    panels[0, 0].grid(color='0.9')
    return figure
