# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Several models of one robot on the same recordings, by one yardstick."""

from typing import NamedTuple

from gms_flex_control.discrepancy.gap import free_rms, torque_rms
from gms_flex_control.discrepancy.path import path_of
from gms_flex_control.discrepancy.workflow import missing
import numpy as np


class Compared(NamedTuple):
    """How far one model is from the recordings, on data that took no part in any fit."""

    name: str
    torque: np.ndarray            # residual torque of each joint, rms, shape (n,) [N m]
    torque_retuned: np.ndarray    # likewise, known parameters re-tuned
    free_run: np.ndarray          # stray of half a second of free simulation, (n,) [rad]
    free_run_retuned: np.ndarray
    missing: float                # squared residual above that of a clean run, in units of it
    missing_retuned: float


class Rows(NamedTuple):
    """What `missing` wants of a model."""

    rows: np.ndarray
    x: np.ndarray


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
    problem, _ = result.found
    measured = problem
    if holdout:
        measured = problem.of_others([path_of(recording, problem.robot)
                                      for recording in holdout])
    zero, compared = np.zeros(len(problem.knobs)), []
    for name, robot in models:
        rows = problem.rows(robot, zero)
        x, tuned, _ = problem.retuned(robot, zero)
        compared.append(Compared(
            name, torque_rms(measured, robot, zero), torque_rms(measured, robot, x),
            free_rms(measured, robot, zero), free_rms(measured, robot, x),
            missing(problem, Rows(rows, zero)), missing(problem, Rows(tuned, x))))
    return compared


def comparison_rows(compared, joints):
    """Return header and rows of a table of models, torques in mN m and strays in mrad."""
    header = ['model']
    for what, unit in (('torque', 'mN m'), ('re-tuned', 'mN m'), ('free run', 'mrad'),
                       ('re-tuned', 'mrad')):
        header += [f'{what} {joint} [{unit}]' for joint in joints]
    header += ['missing', 're-tuned']
    rows = [[one.name, *(f'{1e3 * value:.3g}' for values in one[1:5] for value in values),
             f'{one.missing:.3g}', f'{one.missing_retuned:.3g}'] for one in compared]
    return header, rows


def comparison_text(compared, joints):
    """Return the models as lines of text, a block for each."""
    lines = []
    for one in compared:
        lines.append(f'{one.name}: missing {one.missing:.3g}, re-tuned {one.missing_retuned:.3g} '
                     'times what a clean run shows')
        for j, joint in enumerate(joints):
            lines.append(
                f'  {joint}: held-out torque {1e3 * one.torque[j]:.3g} (re-tuned '
                f'{1e3 * one.torque_retuned[j]:.3g}) mN m, free run {1e3 * one.free_run[j]:.3g} '
                f'({1e3 * one.free_run_retuned[j]:.3g}) mrad')
    return '\n'.join(lines)
