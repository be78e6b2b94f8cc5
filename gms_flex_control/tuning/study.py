# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A controller tried in simulation: how it tracks, what it costs, how quietly it rests.

It is tried on a robot as believed, on robots drawn, whose parameters are scaled evenly within a
spread, those of one group in `GROUPS` together; and every compensation under every condition.
"""

from collections.abc import Iterator
from dataclasses import replace
import math
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import rms
from gms_flex_control.effects.catalogue.drive import InputDelay
from gms_flex_control.experiment.simulated import scaled_robot
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import EffectSpec, RobotParams, with_effects
from gms_flex_control.schema.build import robot_from_values, robot_values
from gms_flex_control.simulation import loop
from gms_flex_control.trajectory import builders
from gms_flex_control.tuning.linear_loop import Timing
from gms_flex_control.tuning.margins import judged
import numpy as np

MOTIONS = ('sinusoid', 'polynomial')
PERIOD, MOVE, HOLD = 6.0, 5.0, 5.0  # of the paper's motions as assumed in config/ [s]
DURATION = {'sinusoid': 20.0, 'polynomial': 3 * HOLD + 2 * MOVE}  # [s]
_SETTLING = 1.0         # of a hold, before its rest is judged [s]

_LOST = 10.0            # an error beyond this is no tracking any more [rad]
# what is scaled by one factor per joint, and by how much at most
SPREADS = {'friction level': 0.3, 'viscous friction': 0.3, 'presliding stiffness': 0.3,
           'joint stiffness': 0.2, 'link mass': 0.3, 'motor inertia': 0.3}
GROUPS = {'static': 'friction level', 'coulomb': 'friction level',
          'viscous': 'viscous friction', 'stiffness': 'presliding stiffness',
          'mass': 'link mass', 'inertia': 'link mass', 'mass_factor': 'link mass',
          'inertia_factor': 'link mass', 'motor_inertia': 'motor inertia'}
PAPER_OBSERVER_GAIN = 0.01  # k_e (paper, section 6)
# mode of the controller: how it is called in tables
CONTESTANTS = {
    'none': 'none',
    'stribeck': 'static Stribeck',
    'lugre': 'LuGre',
    'gms_paper': 'GMS as in the paper',
    'gms': 'GMS, better',
    'gms_desired': 'GMS of desired motion',
    'disturbance_observer': 'disturbance observer',
    'gms_adaptive': 'adaptive GMS'}
NOMINAL, DRAWN = 'nominal', 'drawn'


class Trial(NamedTuple):
    """The figures of one run, a list over joints each; None where it was lost."""

    lost: bool
    mse: list | None = None     # of link angle - reference [rad^2]
    peak: list | None = None    # of its size [rad]
    hold: list | None = None    # largest peak to peak of the link in the rests [rad], if any
    torque: list | None = None  # rms [N m]
    rate: list | None = None    # rms of its change over the sample [N m/s]
    limit: list | None = None   # largest torque [N m]

    @property
    def rms(self) -> np.ndarray:
        """Return the rms error of each link (n,) [rad]."""
        return np.sqrt(self.mse)


def with_delay(robot, delay) -> RobotParams:
    """Return a robot whose motors get every torque later by ``delay`` [s]."""
    if delay <= 0.0:
        return robot
    return with_effects(robot, *(EffectSpec(
        name=InputDelay.name, joint=joint, values=(float(delay),)) for joint in robot.joints))


def try_motions(robot, model, gains, timing, amplitude, seed=0) -> Iterator:
    """Yield (motion, Trial, Run) of `MOTIONS` of an amplitude (n,) [rad], ``model`` believed."""
    for motion, course in zip(MOTIONS, (builders.sinusoid(amplitude, PERIOD),
                                        builders.polynomial(amplitude, MOVE, HOLD)), strict=True):
        run = loop.run(
            with_delay(robot, timing.delay), model, gains, course,
            duration=DURATION[motion], period_ns=round(1e9 * timing.period), seed=seed,
            substeps=max(5, math.ceil(timing.period / 1e-4 - 1e-9)))
        yield motion, _figures_of(run, motion), run


def _figures_of(run, motion) -> Trial:
    error = run.true[:, 0] - run.reference[:, 0]
    if not (np.isfinite(error).all() and np.abs(error).max() < _LOST):
        return Trial(lost=True)
    period = run.time[1] - run.time[0]
    hold = None
    if motion == 'polynomial':
        rests = [slice(*np.searchsorted(run.time, [begin + _SETTLING - 1e-9, begin + HOLD - 1e-9]))
                 for begin in (HOLD + MOVE, 2 * (HOLD + MOVE))]
        hold = np.max([np.ptp(run.true[rest, 0], axis=0) for rest in rests], axis=0).tolist()
    return Trial(
        lost=False, mse=np.mean(error ** 2, axis=0).tolist(),
        peak=np.abs(error).max(axis=0).tolist(), hold=hold,
        torque=np.sqrt(np.mean(run.command ** 2, axis=0)).tolist(),
        rate=np.sqrt(np.mean((np.diff(run.command, axis=0) / period) ** 2, axis=0)).tolist(),
        limit=np.abs(run.command).max(axis=0).tolist())


class Drawn(NamedTuple):
    """One robot to be tried: an item of a batch."""

    robot: object       # RobotParams as believed
    gains: object       # ControllerParams
    timing: object      # Timing
    amplitude: object   # (n,) of the motions [rad]
    seed: int
    number: int


def draw(robot, rng) -> tuple:
    """Return a robot unlike the believed one, and factors by name (``joint1 link mass``)."""
    values = robot_values(robot)
    factors = {f'{joint} {group}': float(1.0 + spread * rng.uniform(-1.0, 1.0))
               for joint in robot.joints for group, spread in SPREADS.items()}
    for name, value in values.items():
        part, last = name.partition('.')[0], name.rpartition('.')[2]
        group = ('joint stiffness' if part == 'arm' and last == 'stiffness'
                 else GROUPS.get(last) if part in ('arm', 'friction') else None)
        if group is None:
            continue
        factor = factors[f"{name.split('.')[1]} {group}"]
        scaled = np.asarray(value) * factor
        values[name] = scaled.tolist()
    return robot_from_values(values), factors


def try_drawn(item) -> dict:
    """Draw a robot and try the controller on it, as a dict; ``item`` is a Drawn."""
    rng = np.random.default_rng([item.seed, item.number])
    robot, factors = draw(item.robot, rng)
    linear = judged(robot, item.robot, item.gains, item.timing, with_delay=False)
    trials = {motion: trial._asdict() for motion, trial, _ in try_motions(
        robot, item.robot, item.gains, item.timing, item.amplitude, seed=item.number)}
    return {'factors': factors, 'stable': linear.stable, 'trials': trials,
            'gain': [min(float(one.gain_up), 1e9) for one in linear.joints],
            'phase': [float(one.phase) for one in linear.joints]}


def summary(outcomes) -> dict:
    """
    Return the outcomes of `try_drawn`, by number, together.

    The dict has ``draws``; ``lost``, ``unstable``, numbers of those; ``rms`` by motion and
    ``hold`` [rad], dicts of ``median``, ``worst`` and ``worst_draw`` (its number), lists over
    joints; ``gain``, ``phase``, least per joint.
    """
    lost = [k for k, one in enumerate(outcomes)
            if any(trial['lost'] for trial in one['trials'].values())]
    kept = [k for k in range(len(outcomes)) if k not in lost]
    rms = {motion: _spread([np.sqrt(outcomes[k]['trials'][motion]['mse']) for k in kept], kept)
           for motion in MOTIONS}
    hold = _spread([outcomes[k]['trials']['polynomial']['hold'] for k in kept], kept)
    return {'draws': len(outcomes), 'lost': lost, 'rms': rms, 'hold': hold,
            'unstable': [k for k, one in enumerate(outcomes) if not one['stable']],
            'gain': np.min([one['gain'] for one in outcomes], axis=0).tolist(),
            'phase': np.min([one['phase'] for one in outcomes], axis=0).tolist()}


def _spread(values, numbers):
    if not numbers:
        return None
    values = np.array(values)
    return {'median': np.median(values, axis=0).tolist(), 'worst': values.max(axis=0).tolist(),
            'worst_draw': [numbers[k] for k in values.argmax(axis=0)]}


# --- every compensation under every condition ---------------------------------------------------


class PlantCondition(NamedTuple):
    """How the plant differs from what is believed, and how it is sampled."""

    name: str
    group: str              # conditions of one group make one column
    friction: float = 1.0   # times what is believed
    stiffness: float = 1.0
    mass: float = 1.0
    counts: float | None = None   # of the encoders; None: as the robot's file says
    rate: float | None = None     # [Hz]; None: as asked
    draw: int | None = None       # number of a robot drawn at random


def conditions(draws) -> list:
    """Return the conditions, ``draws`` robots with all parameters off among them."""
    found = [PlantCondition(NOMINAL, NOMINAL)]
    for group, name, spread in (('friction', 'friction', 0.3), ('K', 'stiffness', 0.2),
                                ('M', 'mass', 0.3)):
        found += [PlantCondition(f'{group} {100 * sign * spread:+.0f} %', group,
                                 **{name: 1.0 + sign * spread}) for sign in (-1.0, 1.0)]
    found += [PlantCondition(f'{counts} counts', f'{counts} counts', counts=float(counts))
              for counts in (4096, 16384, 65536)]
    found += [PlantCondition(f'{rate} Hz', f'{rate} Hz', rate=float(rate)) for rate in (200, 1000)]
    return found + [PlantCondition(f'drawn {k}', DRAWN, draw=k) for k in range(draws)]


def plant_of(robot, condition, seed) -> RobotParams:
    """Return the robot as it is under a condition; every compensation meets the same draws."""
    if condition.draw is not None:
        return draw(robot, np.random.default_rng([seed, condition.draw]))[0]
    found = scaled_robot(robot, condition.friction, condition.stiffness, condition.mass)
    if condition.counts is not None:
        found = replace(found, encoder=replace(robot.encoder, counts=condition.counts))
    return found


def gains_of(gains, mode) -> ControllerParams:
    """Return gains for a mode; the paper's observer has the paper's k_e."""
    if mode == 'gms_paper':
        gains = replace(gains, observer_gain=np.full_like(gains.observer_gain,
                                                          PAPER_OBSERVER_GAIN))
    return replace(gains, compensation=mode)


# what is left of the error where there is (next to) none to compensate
FLOOR = PlantCondition('without friction', 'without friction', friction=1e-6)


class Setting(NamedTuple):
    """What a whole comparison has in common."""

    robot: RobotParams     # as believed
    gains: ControllerParams
    amplitude: np.ndarray  # (n,) of the motions [rad]
    rate: float            # [Hz] where the condition names none
    draws: int
    seed: int


class Cell(NamedTuple):
    """One compensation under one condition: an item of a batch."""

    setting: Setting
    mode: str
    condition: PlantCondition


def cells(setting) -> dict:
    """Return the cells of a comparison, that of its floor at last, by their keys (dict)."""
    return {f'{mode} | {condition.name}': Cell(setting, mode, condition)
            for condition in conditions(setting.draws) for mode in CONTESTANTS} | {
        FLOOR.name: Cell(setting, 'none', FLOOR)}


def floor_of(outcomes) -> dict:
    """Return the Trial, a dict, of each motion of a plant without friction: what is left then."""
    return outcomes[FLOOR.name]


def runs_of(cell) -> Iterator:
    """Return an iterator over (motion, Trial, Run) of a Cell."""
    setting, condition = cell.setting, cell.condition
    plant = plant_of(setting.robot, condition, setting.seed)
    timing = Timing(1.0 / (condition.rate or setting.rate), 0.0)
    return try_motions(plant, setting.robot, gains_of(setting.gains, cell.mode), timing,
                       setting.amplitude, seed=setting.seed)


def try_cell(cell) -> dict:
    """Return a Trial of each motion of a Cell, as a dict (dict of dict)."""
    return {motion: trial._asdict() for motion, trial, _ in runs_of(cell)}


def error_of(outcome) -> float | None:
    """Return the rms error over all joints and motions of a cell [rad]; None if it was lost."""
    if any(trial['lost'] for trial in outcome.values()):
        return None
    return float(np.sqrt(np.mean([trial['mse'] for trial in outcome.values()])))


class Row(NamedTuple):
    """One compensation in the table; errors are rms over joints and motions [rad]."""

    mode: str
    name: str
    mse: dict            # motion -> list per joint [rad^2], nominal; None if lost
    hold: list | None    # largest peak to peak at rest per joint, nominal [rad]
    torque: float | None  # rms over joints and motions, nominal [N m]
    rate: float | None   # rms of its rate of change, likewise [N m/s]
    errors: dict         # group of conditions -> largest error; None if one was lost
    drawn: list          # error of every drawn robot, None where lost
    drawn_hold: float | None  # largest peak to peak at rest of any joint and drawn robot [rad]


def table(outcomes, setting) -> list:
    """Return a Row per compensation from the outcomes of `try_cell`, by the keys of `cells`."""
    return [_row(mode, name, outcomes, setting) for mode, name in CONTESTANTS.items()]


def _row(mode, name, outcomes, setting):
    errors, drawn, holds = {}, [], []
    for condition in conditions(setting.draws):
        outcome = outcomes[f'{mode} | {condition.name}']
        error = error_of(outcome)
        if condition.group == DRAWN:
            drawn.append(error)
            holds.append(None if error is None else max(outcome['polynomial']['hold']))
            continue
        before = errors.get(condition.group, 0.0)
        errors[condition.group] = None if None in (error, before) else max(error, before)
    nominal = outcomes[f'{mode} | {NOMINAL}']
    lost = error_of(nominal) is None
    return Row(
        mode, name, {motion: trial['mse'] for motion, trial in nominal.items()},
        None if lost else nominal['polynomial']['hold'],
        None if lost else rms([trial['torque'] for trial in nominal.values()]),
        None if lost else rms([trial['rate'] for trial in nominal.values()]),
        errors, drawn, None if None in holds else max(holds, default=None))
