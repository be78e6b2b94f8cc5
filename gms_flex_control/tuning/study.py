# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Every compensation under every condition: the conditions, one cell of the table, the table."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import rms
from gms_flex_control.experiment.simulated import scaled_robot
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.tuning.linear_loop import Timing
from gms_flex_control.tuning.trial import draw, try_motions
import numpy as np

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
