# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The gap between model and measurement on data held out: residual torque and free runs."""

from functools import cached_property
from typing import NamedTuple

from gms_flex_control import friction as gms
from gms_flex_control.compiled import compiled
from gms_flex_control.data.signal_analysis import FOLDS
from gms_flex_control.discrepancy.fitting import at_values, numbers_of, values_of
from gms_flex_control.discrepancy.null_simulation import STEP
from gms_flex_control.discrepancy.residuals import (
    acts,
    cleared,
    drive_torque,
    fresh_state,
    inertial_torque,
    motion_as_modelled,
    SENSOR,
)
from gms_flex_control.discrepancy.result import Gap
from gms_flex_control.discrepancy.thresholds import INERTIAL
from gms_flex_control.discrepancy.torque_noise import drawn_noise
from gms_flex_control.discrepancy.validation import steps
from gms_flex_control.effects import base as sig
from gms_flex_control.errors import SimulationError
from gms_flex_control.params.robot import with_effects
from gms_flex_control.simulation import plant
from gms_flex_control.simulation.predictor import copy_state
import numpy as np

FARTHEST = 10.0       # errors of runs and loops that run away count as so much [rad]
_SEED = 991           # of the null simulation behind the noise floor, used in no fit
HORIZON, STRIDE = 0.5, 0.5   # length of a run, and from one start to the next [s]


class Errors(NamedTuple):
    """How far a model is from data held out."""

    torque: np.ndarray  # (n,) residual torque of each joint in motion, rms [N m]
    drive: np.ndarray   # (n,) of the sum of its equations, in which its spring has no part [N m]
    free: np.ndarray    # (n,) free-run error, rms [rad]; NaN without runs
    energy: float       # by which models are compared, see `HeldOut.energy`


class HeldOut:
    """Data that took no part in a fit: other recordings, or blocks of time left out in turn."""

    def __init__(self, likelihood, other=None, further=()):
        self._likelihood, self.other, self._made = likelihood, other, {}
        self.further = further

    @cached_property
    def of_blocks(self) -> 'HeldOut':
        """Return blocks left out of the fitted recordings, whatever other ones there are."""
        return HeldOut(self._likelihood) if self.other else self

    @property
    def _measured(self):
        return self.other or self._likelihood

    def energy(self, state) -> float:
        """
        Return the squared residual torque of a State on held-out data times that of free runs.

        In Coulomb frictions squared and in rad^2, the geometric mean of all runs: one that slips
        decides nothing.
        """
        return self.errors(state).energy

    def errors(self, state) -> Errors:
        """Return the Errors of a State."""
        return self._once('errors', state, lambda: self._errors_of(state))

    def _once(self, what, state, make):
        key = what, id(state)
        if key not in self._made:  # the State is kept, so that its id is its own
            self._made[key] = state, make()
        return self._made[key][1]

    def _errors_of(self, state):
        (torque, _, drive), squares = _torque(self._measured, self._parts(state)), _free_squares(
            self._measured, _whole(self._measured, state.model))
        runs = np.sum(squares, axis=1)
        free = np.exp(np.mean(np.log(np.maximum(runs, 1e-30)))) if len(runs) else 1.0
        return Errors(torque, drive, _rms(squares),
                      _known(np.sum((torque / self._likelihood.coulomb) ** 2) * free))

    def worsens(self, state, other, trifle=0.0) -> bool:
        """Return whether a State predicts torque or free runs worse by more than a ``trifle``."""
        one, two, scale = self.errors(state), self.errors(other), self._likelihood.coulomb
        most = (1.0 + trifle) ** 2
        return bool(any(_known(np.sum(a ** 2)) > most * _known(np.sum(b ** 2)) for a, b in (
            (one.torque / scale, two.torque / scale), (one.drive / scale, two.drive / scale),
            (one.free, two.free))))

    def torque(self, state) -> np.ndarray:
        """Return the residual torque of each joint in motion, rms (n,) [N m]."""
        return _torque(self._measured, self._parts(state))[0]

    def floor(self, state) -> np.ndarray:
        """Return the residual torque (n,) [N m] of a null simulation of a State, or NaN."""
        measured, model = self._measured, state.model
        return self._once('floor', state, lambda: _floor(
            measured, _whole(measured, model), _clean(measured, model)))

    def action(self, model, other) -> np.ndarray:
        """Return the difference of the torques of two Fitted, joints in motion, rms (n,) [N m]."""
        measured = self._measured
        squares = measured.whitener.in_motion([(one - two) ** 2 for one, two in zip(
            measured.torque(model), measured.torque(other), strict=True)])
        return np.sqrt(squares.reshape(2, -1).sum(axis=0))

    def gap(self, before, after) -> Gap:
        """Return the Gap of States: parameters re-tuned as far as plausible, effects found."""
        likelihood, measured = self._likelihood, self._measured
        given = likelihood.fitted(likelihood.robot, np.zeros(len(likelihood.nuisances)))
        parts = {'before': _whole(measured, given), 'retuned': self._parts(before),
                 'after': self._parts(after)}
        torque = {name: _torque(measured, one) for name, one in parts.items()}
        clean, whole = _clean(measured, after.model), _whole(measured, after.model)
        floor = _floor(measured, whole, clean)
        free = {name: _rms(_free_squares(measured, parts[name])) for name in ('retuned', 'after')}
        return Gap(
            joints=likelihood.robot.joints,
            **{name: one[0] for name, one in torque.items()}, floor=floor,
            rest_before=torque['retuned'][1], rest_after=torque['after'][1],
            free_before=free['retuned'], free_after=free['after'],
            free_floor=_rms(_free_squares(measured, whole, clean)) if clean else floor)

    def _parts(self, state):
        """Return what predicts which held-out moments: a State as it is, or refitted in folds."""
        return [(with_effects(robot, *self.further), x, masks)
                for robot, x, masks in self._fitted_parts(state)]

    def _fitted_parts(self, state):
        model, likelihood = state.model, self._likelihood
        if self.other is not None:
            return _whole(self.other, model)
        numbers = numbers_of(likelihood, model.robot)
        values, found = values_of(model.robot, numbers), []
        of_folds = steps(likelihood, model, state.jacobian, state.plausible)
        for k, (_, step) in enumerate(of_folds):
            robot = at_values(model.robot, numbers, values + step[len(model.x):])
            masks = [whitening.settled & (block % FOLDS == k) for whitening, block in zip(
                likelihood.whitenings, likelihood.groups.block_at, strict=True)]
            found.append((robot, model.x + step[:len(model.x)], masks))
        return found


def _known(error):
    """Return an error, infinite where it is no number: no model with it predicts better."""
    return float(error) if np.isfinite(error) else np.inf


def torque_rms(likelihood, model) -> np.ndarray:
    """Return the residual torque of each joint in motion, rms (n,) [N m], of a Fitted."""
    return _torque(likelihood, _whole(likelihood, model))[0]


def free_rms(likelihood, model) -> np.ndarray:
    """Return the free-run error of each joint, rms (n,) [rad], of a Fitted; NaN without runs."""
    return _rms(_free_squares(likelihood, _whole(likelihood, model)))


def _whole(likelihood, model):
    """Return robot, nuisance parameters and all settled moments (masks) of one model."""
    return [(model.robot, model.x, [whitening.settled for whitening in likelihood.whitenings])]


def _clean(likelihood, model):
    """Return null simulations of a model, list of Motion, or None if it runs away."""
    try:
        return likelihood.null_simulations(model.robot, model.x)(
            np.random.default_rng(_SEED) for _ in likelihood.motions)
    except SimulationError:
        return None


def _floor(likelihood, whole, clean):
    """Return residual torques (n,) of null simulations [N m], NaN where there are none."""
    return _torque(likelihood, whole, clean)[0] if clean else np.full(
        likelihood.robot.n_joints, np.nan)


def _torque(likelihood, parts, motions=None):
    """Return residual torques (n,) in motion, at rest, and of drives in motion, rms [N m]."""
    n = likelihood.robot.n_joints
    squares, counts, drive = np.zeros((2, n)), np.zeros((2, n)), np.zeros(n)
    for robot, x, masks in parts:
        if motions:  # simulated, none of which is particular
            x = likelihood.as_robot(x)
        residuals = likelihood.residuals(motions or likelihood.motions, robot, x)
        for m, (residual, mask) in enumerate(zip(residuals, masks, strict=True)):
            whitening = likelihood.whitenings[m]
            if motions:
                residual = residual + drawn_noise(likelihood, m, np.random.default_rng(_SEED))
            torque, still = whitening.low_passed(residual), likelihood.groups.at_rest[m]
            link, motor = torque[:, :n], torque[:, n:]
            for side, where in enumerate((~still & mask[:, None], still & mask[:, None])):
                squares[side] += np.sum((link ** 2 + motor ** 2) * where, axis=0)
                counts[side] += where.sum(axis=0)
            drive += np.sum((link + motor) ** 2 * (~still & mask[:, None]), axis=0)
    moving, still = np.sqrt(squares / np.maximum(counts, 1))
    return (np.where(counts[0] > 0, moving, still), np.where(counts[1] > 0, still, np.nan),
            np.sqrt(drive / np.maximum(counts[0], 1)))


def _rms(squares):
    """Return the root of the mean of squares of runs (S, n), NaN without any."""
    return np.sqrt(np.sum(squares, axis=0) / (len(squares) or np.nan))


def _free_squares(likelihood, parts, motions=None):
    """Return the mean squares of the errors of free runs (S, n) [rad^2]."""
    if not _runs_inform(likelihood):
        return np.empty((0, likelihood.robot.n_joints))
    jobs = []
    for robot, x, masks in parts:
        acted, constants = likelihood.acted(
            motions or likelihood.recorded(likelihood.motions, x), robot, x)
        jobs += [(constants, *one) for one in zip(
            acted, likelihood.whitenings, masks, strict=True)]
    return np.concatenate(list(likelihood.pool.map(_squares_of_runs, jobs)))


def _squares_of_runs(job):
    """Return the mean squares of errors of the free runs (S, n) that start in a mask [rad^2]."""
    constants, motion, whitening, mask = job
    starts = starts_of(motion)
    time = motion.samples.time[starts]
    at = np.clip(np.searchsorted(whitening.time, time - motion.samples.time[0]), 0, len(mask) - 1)
    _, link, motor = free_runs(motion, constants, starts[mask[at] & all_known(motion, time)])
    link, motor = (np.clip(np.nan_to_num(one, nan=FARTHEST), -FARTHEST, FARTHEST)
                   for one in (link, motor))
    return np.mean(link ** 2 + motor ** 2, axis=1) / 2.0


def _runs_inform(likelihood):
    """
    Return whether free runs say anything about a model.

    Not where acceleration takes next to nothing of the torque that the model as believed leaves:
    an angle that follows from errors of the torque alone is anywhere. Of flexible joints both
    equations are added, in which springs have no part.
    """
    n, x = likelihood.robot.n_joints, np.zeros(len(likelihood.nuisances))
    constants, work = likelihood.constants(likelihood.robot, x), plant.workspace(n)
    taken, left, chain = np.zeros(n), np.zeros(n), constants.chain
    for motion, whitening, residual in zip(
            likelihood.motions, likelihood.whitenings,
            likelihood.residuals(likelihood.motions, likelihood.robot, x), strict=True):
        inertial = (inertial_torque(motion.states, constants, work)
                    + chain.flexible * chain.motor_inertia * motion.states[:, 5])
        taken += np.mean(inertial ** 2, axis=0)
        left += np.mean(whitening.low_passed(residual[:, :n] + residual[:, n:]) ** 2, axis=0)
    return bool(np.any(taken > INERTIAL ** 2 * left))


# --- free runs ----------------------------------------------------------------------------------


@compiled
def run_freely(states, base, command, pushed, supply, time, period, substeps, starts, horizon,
               constants, state, replayed, work, link, motor) -> None:
    """
    Fill angles (S, horizon, n) of runs from the measured state at each of ``starts`` (S,).

    Blocks are loaded, and effects remember, as the measured motion up to there makes them.
    """
    n, terms = command.shape[1], constants.effects.stage_start[-1]
    joints = states[:, :2] - base
    at, ahead = 0, 0.5 * period / substeps
    for k in range(command.shape[0]):
        if at == starts.shape[0]:
            break
        for j in range(n):
            replayed.dq_link[j] = joints[k, 1, j]
            work.displacement[j] = joints[k, 0, j] - joints[max(k - 1, 0), 0, j]
        if k > 0:
            gms.advance(replayed.friction, work.displacement, replayed.dq_link, period,
                        constants.friction)
        if k == starts[at]:
            plant.take_place(k, states, command[k], time[k], state, work)
            state.memory[:] = replayed.memory
            copy_state(replayed.friction, states[k, 0], states[k, 1], state.friction,
                       state.q_link, state.dq_link)
            for j in range(n):
                state.q_link[j] += ahead * state.dq_link[j]
                state.q_motor[j] += ahead * state.dq_motor[j]
            for step in range(horizon):
                for j in range(n):
                    link[at, step, j] = state.q_link[j] - ahead * state.dq_link[j]
                    motor[at, step, j] = state.q_motor[j] - ahead * state.dq_motor[j]
                    work.signals[j, sig.SUPPLY] = supply[k + step]
                    work.outside[j] = pushed[k + step, j]
                    state.base_rate[j] = base[k + step, 1, j]
                plant.advance(state, command[k + step], time[k + step], period, substeps,
                              constants, work)
            at += 1
        if terms > 0:
            plant.take_place(k, states, command[k], time[k], replayed, work)
            for j in range(n):
                work.signals[j, sig.SUPPLY] = supply[k]
            plant.torques(replayed, period, constants, work)


def starts_of(motion) -> np.ndarray:
    """Return the samples of a recording at which free runs start, one after another (S,)."""
    period = motion.samples.period
    every = max(round(STRIDE / period), 1)
    return np.arange(every, len(motion.samples.time) - _horizon(period), every)


def _horizon(period):
    return max(round(HORIZON / period), 2)


def free_runs(motion, constants, starts=None) -> tuple:
    """Return when free runs start, (S,) [s], and measured minus simulated angles [rad]."""
    samples, constants = motion.samples, motion.carrying(constants)
    period, n = samples.period, len(samples.joints)
    horizon, starts = _horizon(period), starts_of(motion) if starts is None else starts
    states, readings, base = _as_modelled(motion, constants)
    link, motor = np.empty((2, len(starts), horizon, n))
    pushed = np.zeros_like(samples.command) if samples.pushed is None else samples.pushed
    run_freely(states, base, samples.command, pushed, samples.supply, samples.time, period,
               max(1, round(period / STEP)), starts, horizon, constants, fresh_state(constants),
               fresh_state(constants), plant.workspace(n), link, motor)
    rows = starts[:, None] + np.arange(horizon)
    link, motor = readings[rows, 0] - link, readings[rows, 1] - motor
    for unseen in samples.unseen:
        link[..., unseen.joint] = motor[..., unseen.joint]
    return samples.time[starts], link, motor


def _as_modelled(motion, constants):
    """Return motion (T, 6, n), readings and bases (T, 2, n) as a model sees them, cleared."""
    samples = motion.samples
    if not (acts(constants, SENSOR) or samples.unseen):
        return samples.states, samples.readings, np.zeros_like(samples.readings)
    drive = drive_torque(motion, constants)
    states, second = motion_as_modelled(motion, constants, drive)
    true, _, base = cleared(motion, drive, states, second, constants)
    errors = np.concatenate([motion.states - true, base], axis=1)
    fine = np.stack([np.interp(samples.time, motion.time, one)
                     for one in errors.reshape(len(errors), -1).T], axis=1).reshape(
        len(samples.time), *errors.shape[1:])
    return (samples.states - fine[:, :6], samples.readings - fine[:, [0, 3]],
            np.ascontiguousarray(fine[:, 6:]))  # as kernels are compiled for


def all_known(motion, starts) -> np.ndarray:
    """Return for each run, by its start (S,) [s], whether all angles were read, bool."""
    unread = np.concatenate([[0], np.cumsum(~motion.known)])
    first, last = (np.searchsorted(motion.time, when) for when in (starts, starts + HORIZON))
    return unread[last] == unread[first]
