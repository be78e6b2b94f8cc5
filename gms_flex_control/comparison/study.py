# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Every compensation under every condition: one cell of the table each, and the table."""

from typing import NamedTuple

from gms_flex_control.comparison.contestants import (
    Condition,
    conditions,
    CONTESTANTS,
    DRAWN,
    gains_of,
    NOMINAL,
    plant_of,
)
from gms_flex_control.tuning.linear_loop import Timing
from gms_flex_control.tuning.trial import MOTIONS, try_gains
import numpy as np

# what is left of the error where there is (next to) none to compensate
FLOOR = Condition('without friction', 'without friction', friction=1e-6)


class Setting(NamedTuple):
    """What a whole comparison has in common."""

    robot: object       # RobotParams as believed
    gains: object       # ControllerParams
    amplitude: object   # (n,) of the motions [rad]
    rate: float         # [Hz] where the condition names none
    draws: int
    seed: int


class Cell(NamedTuple):
    """One compensation under one condition: an item of a batch."""

    setting: Setting
    mode: str
    condition: object   # Condition


def cells(setting):
    """Return the cells of a comparison, that of its floor at last, by their keys (dict)."""
    return {f'{mode} | {condition.name}': Cell(setting, mode, condition)
            for condition in conditions(setting.draws) for mode in CONTESTANTS} | {
        FLOOR.name: Cell(setting, 'none', FLOOR)}


def floor_of(outcomes):
    """Return the Trial, a dict, of each motion of a plant without friction: what is left then."""
    return outcomes[FLOOR.name]


def runs_of(cell):
    """Yield (motion, Trial, Run) of a Cell."""
    setting, condition = cell.setting, cell.condition
    plant = plant_of(setting.robot, condition, setting.seed)
    timing = Timing(1.0 / (condition.rate or setting.rate), 0.0)
    model = setting.robot
    for motion in MOTIONS:
        yield motion, *try_gains(plant, model, gains_of(setting.gains, cell.mode), timing, motion,
                                 setting.amplitude, seed=setting.seed)


def try_cell(cell):
    """
    Simulate the motions of a cell.

    Parameters
    ----------
    cell : Cell
        Which one.

    Returns
    -------
    dict
        A Trial as a dict for each of `tuning.trial.MOTIONS`.

    """
    return {motion: trial._asdict() for motion, trial, _ in runs_of(cell)}


def error_of(outcome):
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


def table(outcomes, setting):
    """
    Return what the cells say, a row per compensation.

    Parameters
    ----------
    outcomes : dict of str to dict
        Of `try_cell`, by the keys of `cells`.
    setting : Setting
        Of the comparison.

    Returns
    -------
    list of Row

    """
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
        None if lost else _rms([trial['torque'] for trial in nominal.values()]),
        None if lost else _rms([trial['rate'] for trial in nominal.values()]),
        errors, drawn, None if None in holds else max(holds, default=None))


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))
