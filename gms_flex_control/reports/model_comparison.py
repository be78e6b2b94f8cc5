# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Several models of one robot on the same recordings, by one yardstick."""

from typing import NamedTuple

from gms_flex_control.discrepancy.fit import Fitted
from gms_flex_control.discrepancy.gap import free_rms, torque_rms
from gms_flex_control.discrepancy.path import path_of
from gms_flex_control.discrepancy.retuned import with_knobs
from gms_flex_control.discrepancy.units import angle_scale, torque_scale
import numpy as np


class Compared(NamedTuple):
    """How far one model is from the recordings, on data that took no part in any fit."""

    name: str
    torque: np.ndarray            # residual torque of each joint, rms, shape (n,) [N m]
    torque_retuned: np.ndarray    # likewise, known parameters re-tuned
    free_run: np.ndarray          # stray of half a second of free simulation, (n,) [rad]
    free_run_retuned: np.ndarray
    missing: float                # squared residual above a clean run's, see Problem.missing
    missing_retuned: float


def compare(result, models, holdout=()):
    """
    Compare models by the yardstick of a Discrepancy.

    Parameters
    ----------
    result : Discrepancy
        Its search holds the recordings, and what shows in them where nothing is missing.
    models : sequence of (str, RobotParams)
        Name and model; same joints as the robot of the search.
    holdout : sequence of Recording
        Where torque and free run are measured; default the blocks of time held out.

    Returns
    -------
    list of Compared

    """
    problem = result.behind.problem
    measured = problem
    if holdout:
        measured = problem.of_others([path_of(recording, problem.robot)
                                      for recording in holdout])
    zero, compared = np.zeros(len(problem.knobs)), []
    for name, robot in models:
        given = Fitted.of(problem, robot, zero)
        x, _, _ = problem.retuned(robot, zero)
        compared.append(Compared(
            name, torque_rms(measured, robot, zero), torque_rms(measured, robot, x),
            free_rms(measured, robot, zero), free_rms(measured, robot, x),
            problem.missing(given), problem.missing(Fitted.of(problem, robot, x))))
    return compared


def as_found(result):
    """Return the robot with all findings of a Discrepancy, also those that are withheld."""
    problem, model = result.behind.problem, result.behind.found.model
    return with_knobs(model.robot, problem.knobs, model.x)


def _scales(compared):
    """Return the scales of torques and strays, as given and re-tuned."""
    torque = torque_scale([one.torque for one in compared])
    angle = angle_scale([one.free_run for one in compared])
    return torque, torque, angle, angle


def comparison_rows(compared, joints):
    """Return header and rows of a table of models, torques and strays in units that suit."""
    header = ['model']
    scales = _scales(compared)
    for what, scale in zip(('torque', 're-tuned', 'free run', 're-tuned'), scales, strict=True):
        header += [f'{what} {joint} [{scale.unit}]' for joint in joints]
    header += ['missing', 're-tuned']
    rows = [[one.name, *(scale.told(value) for scale, values in zip(scales, one[1:5], strict=True)
                         for value in values),
             f'{one.missing:.3g}', f'{one.missing_retuned:.3g}'] for one in compared]
    return header, rows


def comparison_text(compared, joints):
    """Return the models as lines of text, a block for each."""
    lines, (torque, _, angle, _) = [], _scales(compared)
    for one in compared:
        lines.append(f'{one.name}: missing {one.missing:.3g}, re-tuned {one.missing_retuned:.3g} '
                     'times what noise and what does not matter make')
        for j, joint in enumerate(joints):
            lines.append(
                f'  {joint}: held-out torque {torque.told(one.torque[j])} (re-tuned '
                f'{torque.told(one.torque_retuned[j])}) {torque.unit}, free run '
                f'{angle.told(one.free_run[j])} ({angle.told(one.free_run_retuned[j])}) '
                f'{angle.unit}')
    return '\n'.join(lines)
