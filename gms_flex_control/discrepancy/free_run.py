# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How far a model runs away when nothing corrects it: simulated from many measured states."""

from gms_flex_control.compiled import compiled
from gms_flex_control.discrepancy.equations import replay_friction
from gms_flex_control.discrepancy.residuals import (
    acts,
    corrected,
    drive_torque,
    fresh_state,
    motion_as_modelled,
    SENSOR,
)
from gms_flex_control.effects import signals as sig
from gms_flex_control.simulation import plant
from gms_flex_control.simulation.predictor import copy_state
import numpy as np

HORIZON, STRIDE = 0.5, 0.5   # length of a run, and from one start to the next [s]
_STEP = 4e-4                 # of the integration [s]


@compiled
def run_freely(motion, command, pushed, supply, time, period, substeps, starts, horizon, constants,
               state, replayed, work, link, motor):
    """
    Fill angles (S, horizon, n) of runs from the measured state at each of ``starts`` (S,).

    Blocks are loaded as the measured motion up to there has loaded them.
    """
    n = command.shape[1]
    at, ahead = 0, 0.5 * period / substeps
    for k in range(command.shape[0]):
        for j in range(n):
            replayed.dq_link[j] = motion[k, 1, j]
        replay_friction(k, motion, period, constants, replayed, work)
        if at < starts.shape[0] and k == starts[at]:
            copy_state(replayed.friction, motion[k, 0], motion[k, 1], state.friction,
                       state.q_link, state.dq_link)
            for j in range(n):
                state.q_motor[j], state.dq_motor[j] = motion[k, 3, j], motion[k, 4, j]
                state.q_link[j] += ahead * state.dq_link[j]
                state.q_motor[j] += ahead * state.dq_motor[j]
            for step in range(horizon):
                for j in range(n):
                    link[at, step, j] = state.q_link[j] - ahead * state.dq_link[j]
                    motor[at, step, j] = state.q_motor[j] - ahead * state.dq_motor[j]
                work.signals[:, sig.SUPPLY] = supply[k + step]
                work.outside[:] = pushed[k + step]
                plant.advance(state, command[k + step], time[k + step], period, substeps,
                              constants, work)
            at += 1


def free_runs(path, constants):
    """
    Return how far free runs of a model stray from a recording.

    Parameters
    ----------
    path : Path
        The recording.
    constants : numpy.record
        The model.

    Returns
    -------
    starts : ndarray, shape (S,)
        Times of the starts [s].
    link, motor : ndarray, shape (S, H, n)
        Measured minus simulated angles [rad]; of a link that is unseen, its motor's.

    """
    period, n = path.fine_period, len(path.joints)
    horizon = max(round(HORIZON / period), 2)
    starts = np.arange(round(STRIDE / period), len(path.fine_time) - horizon,
                       max(round(STRIDE / period), 1))
    motion, readings = path.fine_motion, path.readings
    if acts(constants, SENSOR) or path.unseen:
        motion, readings = as_modelled(path, constants)
    link, motor = np.empty((2, len(starts), horizon, n))
    pushed = np.zeros_like(path.command) if path.pushed is None else path.pushed
    run_freely(motion, path.command, pushed, path.supply, path.fine_time, period,
               max(1, round(period / _STEP)), starts, horizon, constants, fresh_state(constants),
               fresh_state(constants), plant.workspace(n), link, motor)
    rows = starts[:, None] + np.arange(horizon)
    link, motor = readings[rows, 0] - link, readings[rows, 1] - motor
    for unseen in path.unseen:
        link[..., unseen.joint] = motor[..., unseen.joint]
    return path.fine_time[starts], link, motor


def as_modelled(path, constants):
    """Return motion (T, 6, n) and readings (T, 2, n) of a recording, as the model sees them."""
    work = plant.workspace(len(path.joints))
    drive = drive_torque(path, constants, work)
    motion, second = motion_as_modelled(path, constants, work, drive)
    motion, _ = corrected(path, drive, motion, second, constants, work)
    off = path.motion - motion
    fine = np.stack([[np.interp(path.fine_time, path.time, off[:, i, j])
                      for j in range(off.shape[2])] for i in range(6)])
    fine = np.moveaxis(fine, 2, 0)
    return np.ascontiguousarray(path.fine_motion - fine), path.readings - fine[:, [0, 3]]


def all_known(path, starts):
    """Return of which runs, by their starts (S,) [s], all angles were read, bool."""
    unread = np.concatenate([[0], np.cumsum(~path.known)])
    first, last = (np.searchsorted(path.time, when) for when in (starts, starts + HORIZON))
    return unread[last] == unread[first]
