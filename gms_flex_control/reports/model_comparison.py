# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Several models of one robot on the same recordings, by one yardstick."""

from typing import NamedTuple

from gms_flex_control.discrepancy.describe import angle_scale, torque_scale
from gms_flex_control.discrepancy.fitting import retuned
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.nuisance import with_nuisances
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.discrepancy.validation import free_rms, torque_rms
import numpy as np


class Compared(NamedTuple):
    """How far one model is from the recordings, as given and with known parameters re-tuned."""

    name: str
    torque: np.ndarray            # residual torque of each joint in motion, rms, (n,) [N m]
    torque_retuned: np.ndarray
    free_run: np.ndarray          # error of half a second of free simulation, rms, (n,) [rad]
    free_run_retuned: np.ndarray
    missing: float                # mean square of whitened residuals above that of null runs
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
        Where torque and free run are measured; default the recordings themselves.

    Returns
    -------
    list of Compared

    """
    likelihood = result.behind.likelihood
    measured = Likelihood([motion_of(recording, likelihood.robot) for recording in holdout],
                          likelihood.robot, held_out=True) if holdout else likelihood
    zero, compared = np.zeros(len(likelihood.nuisances)), []
    for name, robot in models:
        pair = likelihood.fitted(robot, zero), retuned(likelihood, robot, zero, PLAUSIBLE)[0]
        compared.append(Compared(
            name, *(torque_rms(measured, one) for one in pair),
            *(free_rms(measured, one) for one in pair),
            *(_missing(likelihood, one) for one in pair)))
    return compared


def _missing(likelihood, model):
    """Return the mean square of a model's whitened residuals above that of null simulations."""
    return float(model.sums.groups.sum() / likelihood.count.sum() - np.mean(likelihood.clean ** 2))


def as_found(result):
    """Return the robot with all effects that a Discrepancy found evidence for."""
    after = result.behind.after
    return with_nuisances(after.robot, result.behind.likelihood.nuisances, after.x)


def _scales(compared):
    """Return the scales of torques and free-run errors, as given and re-tuned."""
    torque = torque_scale([one.torque for one in compared])
    angle = angle_scale([one.free_run for one in compared])
    return torque, torque, angle, angle


def comparison_rows(compared, joints):
    """Return header and rows of a table of models, in units that suit."""
    header = ['model']
    scales = _scales(compared)
    for what, scale in zip(('torque', 're-tuned', 'free run', 're-tuned'), scales, strict=True):
        header += [f'{what} {joint} [{scale.unit}]' for joint in joints]
    header += ['missing', 're-tuned']
    rows = [[one.name, *(scale.text(value) for scale, values in zip(scales, one[1:5], strict=True)
                         for value in values),
             f'{one.missing:.3g}', f'{one.missing_retuned:.3g}'] for one in compared]
    return header, rows


def comparison_text(compared, joints):
    """Return the models as lines of text, a block for each."""
    lines, (torque, _, angle, _) = [], _scales(compared)
    for one in compared:
        lines.append(f'{one.name}: missing {one.missing:.3g}, re-tuned {one.missing_retuned:.3g}')
        for j, joint in enumerate(joints):
            lines.append(
                f'  {joint}: residual torque {torque.text(one.torque[j])} (re-tuned '
                f'{torque.text(one.torque_retuned[j])}) {torque.unit}, free run '
                f'{angle.text(one.free_run[j])} ({angle.text(one.free_run_retuned[j])}) '
                f'{angle.unit}')
    return '\n'.join([*lines, 'missing: mean square of the whitened residuals above that of null '
                      'simulations'])
