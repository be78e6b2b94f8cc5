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
def run_freely(states, command, pushed, supply, time, period, substeps, starts, horizon, constants,
               state, replayed, work, link, motor):
    """
    Fill angles (S, horizon, n) of runs from the measured state at each of ``starts`` (S,).

    Blocks are loaded as the measured motion up to there has loaded them.
    """
    n = command.shape[1]
    at, ahead = 0, 0.5 * period / substeps
    for k in range(command.shape[0]):
        for j in range(n):
            replayed.dq_link[j] = states[k, 1, j]
        replay_friction(k, states, period, constants, replayed, work)
        if at < starts.shape[0] and k == starts[at]:
            copy_state(replayed.friction, states[k, 0], states[k, 1], state.friction,
                       state.q_link, state.dq_link)
            for j in range(n):
                state.q_motor[j], state.dq_motor[j] = states[k, 3, j], states[k, 4, j]
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


def free_runs(motion, constants):
    """
    Return how far free runs of a model stray from a recording.

    Parameters
    ----------
    motion : Motion
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
    period, n = motion.fine_period, len(motion.joints)
    horizon = max(round(HORIZON / period), 2)
    starts = np.arange(round(STRIDE / period), len(motion.fine_time) - horizon,
                       max(round(STRIDE / period), 1))
    states, readings = motion.fine_states, motion.readings
    if acts(constants, SENSOR) or motion.unseen:
        states, readings = as_modelled(motion, constants)
    link, motor = np.empty((2, len(starts), horizon, n))
    pushed = np.zeros_like(motion.command) if motion.pushed is None else motion.pushed
    run_freely(states, motion.command, pushed, motion.supply, motion.fine_time, period,
               max(1, round(period / _STEP)), starts, horizon, constants, fresh_state(constants),
               fresh_state(constants), plant.workspace(n), link, motor)
    rows = starts[:, None] + np.arange(horizon)
    link, motor = readings[rows, 0] - link, readings[rows, 1] - motor
    for unseen in motion.unseen:
        link[..., unseen.joint] = motor[..., unseen.joint]
    return motion.fine_time[starts], link, motor


def as_modelled(motion, constants):
    """Return motion (T, 6, n) and readings (T, 2, n) of a recording, as the model sees them."""
    work = plant.workspace(len(motion.joints))
    drive = drive_torque(motion, constants, work)
    states, second = motion_as_modelled(motion, constants, work, drive)
    states, _ = corrected(motion, drive, states, second, constants, work)
    off = motion.states - states
    fine = np.stack([[np.interp(motion.fine_time, motion.time, off[:, i, j])
                      for j in range(off.shape[2])] for i in range(6)])
    fine = np.moveaxis(fine, 2, 0)
    return np.ascontiguousarray(motion.fine_states - fine), motion.readings - fine[:, [0, 3]]


def all_known(motion, starts):
    """Return of which runs, by their starts (S,) [s], all angles were read, bool."""
    unread = np.concatenate([[0], np.cumsum(~motion.known)])
    first, last = (np.searchsorted(motion.time, when) for when in (starts, starts + HORIZON))
    return unread[last] == unread[first]
