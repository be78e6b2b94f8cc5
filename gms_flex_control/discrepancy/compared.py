# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Models of one robot beside each other on the same recordings: their errors, their free runs."""

from typing import NamedTuple

from gms_flex_control.discrepancy.fitting import retuned
from gms_flex_control.discrepancy.gap import all_known, free_rms, free_runs, torque_rms
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.nuisance import with_nuisances
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.params.robot import RobotParams
import numpy as np

_POINTS = 12_000      # of free runs over time, about
_FARTHEST = 10.0      # where a free run that runs away is drawn [rad]


class Compared(NamedTuple):
    """How far one model is from the recordings, as given and with known parameters re-tuned."""

    name: str
    torque: np.ndarray            # residual torque of each joint in motion, rms, (n,) [N m]
    torque_retuned: np.ndarray
    free_run: np.ndarray          # error of half a second of free simulation, rms, (n,) [rad]
    free_run_retuned: np.ndarray
    missing: float                # mean square of whitened residuals above that of null runs
    missing_retuned: float


def compare(result, models, holdout=()) -> list:
    """
    Return a Compared for each model, a pair of name and RobotParams, by a Discrepancy's measure.

    Torque and free run are measured on ``holdout`` (Recordings), default those of the search.
    """
    likelihood = result.behind.likelihood
    measured = Likelihood([motion_of(recording, likelihood.robot) for recording in holdout],
                          likelihood.robot, held_out=True) if holdout else likelihood
    zero, compared = np.zeros(len(likelihood.nuisances)), []
    for name, robot in models:
        likelihood.encoder_noise.forget()  # so that no model is measured by what came before it
        pair = likelihood.fitted(robot, zero), retuned(likelihood, robot, zero, PLAUSIBLE)[0]
        compared.append(Compared(
            name, *(torque_rms(measured, one) for one in pair),
            *(free_rms(measured, one) for one in pair),
            *(_missing(likelihood, one) for one in pair)))
    return compared


def _missing(likelihood, model):
    """Return the mean square of a model's whitened residuals above that of null simulations."""
    return float(model.sums.groups.sum() / len(model.rows) - np.mean(likelihood.clean ** 2))


def as_found(result) -> RobotParams:
    """Return the robot with all effects that a Discrepancy found evidence for."""
    after = result.behind.after
    return with_nuisances(after.robot, result.behind.likelihood.nuisances, after.x)


class FreeRuns(NamedTuple):
    """Simulated less measured link angles of free runs, one after another."""

    motion: object       # Motion
    time: np.ndarray     # (T,) [s]
    without: np.ndarray  # (T, n) [rad], of the model without effects; NaN before each start
    found: np.ndarray    # and of that with them


def free_runs_of(behind, holdout=()) -> FreeRuns:
    """Return the free runs of a search's models on the first recording held out, else fitted."""
    likelihood = behind.likelihood
    motion = motion_of(holdout[0], likelihood.robot) if holdout else likelihood.motions[0]
    errors = []
    for model in (behind.before, behind.after):
        starts, link, _ = free_runs(motion, likelihood.constants(model.robot, model.x))
        step = max(1, int(np.ceil(link.shape[1] * len(starts) / _POINTS)))
        error = -np.clip(link, -_FARTHEST, _FARTHEST)[:, ::step]
        error[~all_known(motion, starts)] = np.nan  # a hole in the angles
        error[:, -1] = np.nan  # lifts the pen before the next start
        errors.append(error.reshape(-1, link.shape[2]))
    time = (starts[:, None] - motion.samples.time[0]
            + motion.samples.period * np.arange(link.shape[1]))[:, ::step]
    return FreeRuns(motion, time.ravel(), *errors)
