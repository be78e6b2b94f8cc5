# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The paper's Table 4 from recordings: mean square tracking error with and without compensation.

The absolute values of the paper cannot be reproduced: it prints neither the inertias M and J,
nor the stiffness K, nor the trajectories. What can be compared is the ratio
MSE without / MSE with compensation on the same robot and trajectory.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.analysis.table4 import Table4
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import quantum
from gms_flex_control.experiment.simulated import simulate
import numpy as np

HOLD_SETTLING = 1.0   # a reference constant this long counts as holding still [s]
HOLD_WINDOW = 5.0     # and the last this much of it is judged [s]
HOLD_TOLERANCE = 1e-9  # a reference that moves less than this is constant [rad]


class Run(NamedTuple):
    """One experiment: what was asked of the robot, how friction was treated, what came."""

    trajectory: str    # 'sinusoid', 'polynomial' or any other name
    compensation: str  # 'none', 'gms_paper', 'gms' or any other name
    recording: Recording


class JointTracking(NamedTuple):
    """How one joint followed its reference; NaN where the recording does not show it."""

    joint: str
    mse: float          # mean of (q_link - reference)^2 [rad^2]
    rms: float          # [rad]
    floor: float        # rms error that the encoder's steps alone make of a reading [rad]
    max_error: float    # largest absolute error [rad]
    hold_peak_to_peak: float  # largest of all holds [rad]
    hold_start: float   # stamp at which the judged part of that hold begins [s]
    hold_duration: float  # its length [s]
    rms_torque: float   # of the torque applied, or commanded if that is not known [N m]
    samples: int        # samples with both a measurement and a reference


class RunTracking(NamedTuple):
    """The figures of one run, one entry per joint."""

    trajectory: str
    compensation: str
    source: str
    duration: float  # [s]
    joints: tuple
    unanswered: float  # share of the samples without a command; NaN where none was recorded


def link_error(recording) -> np.ndarray:
    """Return actual minus desired link angle (T, n) [rad]; NaN where there was no reference."""
    return recording.q_link - recording.reference[:, 0]


def link_rms(recording) -> np.ndarray:
    """Return the rms tracking error of each link (n,) [rad]."""
    return np.sqrt(np.nanmean(link_error(recording) ** 2, axis=0))


def track(run) -> RunTracking:
    """Return the RunTracking of a run; means are over samples, as in the paper, not over time."""
    recording = run.recording
    error = link_error(recording)
    return RunTracking(
        run.trajectory, run.compensation, recording.source,
        float(recording.time[-1] - recording.time[0]),
        tuple(_track_joint(recording, error[:, i], i) for i in range(recording.n_joints)),
        unanswered(recording))


def unanswered(recording) -> float:
    """Return which share of samples between the first and last command has none; NaN if all."""
    there = np.isfinite(recording.command).all(axis=1)
    rows = np.flatnonzero(there)
    return float(np.mean(~there[rows[0]:rows[-1] + 1])) if len(rows) else np.nan


def table4(runs) -> Table4:
    """Return the paper's Table4 for any list of Runs, repeats averaged, missing ones as '-'."""
    return Table4(tuple(track(run) for run in runs))


def hold_windows(time, q_ref) -> list[slice]:
    """
    Return where one joint is asked to stand still and has had time to settle, list of slice.

    For each part of constant reference (T,) [rad] longer than ``HOLD_SETTLING``: what follows the
    settling, at most the last ``HOLD_WINDOW`` of it.
    """
    still = np.abs(np.diff(q_ref)) <= HOLD_TOLERANCE
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    windows = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        begin = max(time[first] + HOLD_SETTLING, time[last] - HOLD_WINDOW)
        start = int(np.searchsorted(time, begin - 1e-9))
        if last > start:
            windows.append(slice(start, int(last) + 1))
    return windows


def _track_joint(recording, error, i):
    valid = error[np.isfinite(error)]
    mse = float(np.mean(valid ** 2)) if valid.size else np.nan
    peak, start, duration = _worst_hold(recording, i)
    return JointTracking(
        recording.joints[i], mse, float(np.sqrt(mse)),
        quantum(recording.q_link[:, i]) / np.sqrt(12.0),  # rounding is uniform within a step
        float(np.max(np.abs(valid))) if valid.size else np.nan,
        peak, start, duration, _rms_torque(recording, i), int(valid.size))


def _worst_hold(recording, i):
    """Return peak to peak [rad], start and duration [s] of the hold with most motion."""
    worst = (np.nan, np.nan, np.nan)
    for window in hold_windows(recording.time, recording.reference[:, 0, i]):
        angle, stamp = recording.q_link[window, i], recording.time[window]
        peak = float(np.ptp(angle[np.isfinite(angle)])) if np.isfinite(angle).any() else np.nan
        if not peak <= worst[0]:
            worst = (peak, float(stamp[0]), float(stamp[-1] - stamp[0]))
    return worst


def _rms_torque(recording, i):
    for torque in (recording.tau_motor[:, i], recording.command[:, i]):
        known = torque[np.isfinite(torque)]
        if known.size:
            return float(np.sqrt(np.mean(known ** 2)))
    return np.nan


def tracking_of_copies(plan, model, count=16, spread=1e-3, seed=0) -> np.ndarray:
    """
    Return the rms tracking errors (count, n) [rad] of robots whose friction differs a little.

    Compensated well, what is left of an error is made of single events: a link that sticks a
    moment too long. Whether one happens hangs on friction to a millionth, so one run says little;
    the median over robots that differ by less than anyone could know says what to expect.

    Parameters
    ----------
    plan : Plan
        Robot, motion and gains.
    model : RobotParams
        What the controller believes.
    count : int
        How many robots.
    spread : float
        Standard deviation of each stiffness of their blocks, relative.
    seed : int
        Of these; the same robots for every model.

    """
    rng, friction, errors = np.random.default_rng(seed), plan.robot.friction, []
    for _ in range(count):
        factor = 1.0 + spread * rng.standard_normal(friction.stiffness.shape)
        robot = replace(plan.robot, friction=replace(
            friction, stiffness=factor * friction.stiffness))
        own = replace(plan, robot=robot, model=model)
        errors.append(link_rms(simulate(own, 'copy')))
    return np.array(errors)
