# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Models beside each other on the same recordings: residuals, free runs, the closed loop."""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import runs
from gms_flex_control.discrepancy.fitting import retuned
from gms_flex_control.discrepancy.gap import all_known, FARTHEST, free_rms, free_runs, torque_rms
from gms_flex_control.discrepancy.likelihood import Residuals
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.nuisance import with_nuisances
from gms_flex_control.discrepancy.result import Discrepancy
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.errors import BagError
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.simulation.loop import Loop
import numpy as np

_POINTS = 12_000      # of free runs over time, about
# of the closed loop
LEAST_TIME = 1.0   # with a reference all along, shorter recordings are of no use [s]
_LONGEST = 5.5     # periods between samples of one segment
_EVEN = 0.02       # of the period: samples closer to an even grid are left as they are
_SEED, _OTHER_SEED = 991, 992  # of the encoder noise


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
    measured = Residuals([motion_of(recording, likelihood.robot) for recording in holdout],
                         likelihood.robot) if holdout else likelihood
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
    return float(model.sums.groups.sum() / len(model.whitened) - np.mean(likelihood.clean ** 2))


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


def free_runs_of(behind, holdout) -> FreeRuns:
    """Return the free runs of a search's models on the first recording held out, else fitted."""
    likelihood = behind.likelihood
    motion = motion_of(holdout[0], likelihood.robot) if holdout else likelihood.motions[0]
    errors = []
    for model in (behind.before, behind.after):
        (acted,), constants = likelihood.acted([motion], model.robot, model.x)
        starts, link, _ = free_runs(acted, constants)
        step = max(1, int(np.ceil(link.shape[1] * len(starts) / _POINTS)))
        error = -np.clip(link, -FARTHEST, FARTHEST)[:, ::step]
        error[~all_known(motion, starts)] = np.nan  # a hole in the angles
        error[:, -1] = np.nan  # lifts the pen before the next start
        errors.append(error.reshape(-1, link.shape[2]))
    time = (starts[:, None] - motion.samples.time[0]
            + motion.samples.period * np.arange(link.shape[1]))[:, ::step]
    return FreeRuns(motion, time.ravel(), *errors)


class ReferenceSegment(NamedTuple):
    """The longest part of a recording that has a reference, evenly sampled."""

    source: str
    begin: float           # in the recording's time [s]
    period_ns: int
    reference: np.ndarray  # (T, 5, n)
    measured: np.ndarray   # (T, n) link angles [rad]
    q_motor: np.ndarray    # (n,) at the beginning; NaN where unknown [rad]
    supply: np.ndarray     # (T,) voltage of the drives [V], 0 where it is not known


class ClosedLoop(NamedTuple):
    """
    Errors of the simulated closed loop: its link angles less those measured, rms (n,) [rad].

    ``before`` is the model as given, ``retuned`` with known parameters re-tuned, ``after`` with
    the effects found; ``floor`` is what two runs of the last, of other encoder noise, differ by.
    The courses are those of the first recording.
    """

    joints: tuple
    sources: tuple
    before: np.ndarray
    retuned: np.ndarray
    after: np.ndarray
    floor: np.ndarray
    time: np.ndarray            # (T,) [s]
    measured: np.ndarray        # (T, n) [rad]
    course_before: np.ndarray   # (T, n) of the model re-tuned [rad]
    course_after: np.ndarray    # (T, n) [rad]


def segment_of(recording) -> ReferenceSegment:
    """
    Return the ReferenceSegment of a Recording of a robot under the cascade controller.

    BagError if it has no reference, or no link angles with it, for `LEAST_TIME` on end.
    """
    seen = np.isfinite(recording.q_link).all(axis=1)
    if not seen.any():
        raise BagError(f'{recording.source}: does not have the angles of all links, so there is '
                       'nothing to hold a simulated closed loop against; leave --controller out')
    known = seen & np.isfinite(recording.reference).all(axis=(1, 2))
    parts = runs(known[1:] & known[:-1] & (np.diff(recording.time) <= _LONGEST * recording.period))
    rows = slice(*max(parts + [0, 1], key=np.ptp, default=(0, 0)))
    time = recording.time[rows]
    if len(time) < 2 or time[-1] - time[0] < LEAST_TIME:
        raise BagError(f'{recording.source}: has no reference of the link angles for '
                       f'{LEAST_TIME:g} s on end, so its closed loop cannot be simulated; record '
                       '/reference with the joint states, or leave --controller out')
    period = (time[-1] - time[0]) / (len(time) - 1)
    grid = time[0] + period * np.arange(len(time))
    reference, measured = recording.reference[rows], recording.q_link[rows]
    if np.abs(time - grid).max() > _EVEN * period:
        reference, measured = (_resampled(grid, time, values) for values in (reference, measured))
    return ReferenceSegment(
        recording.source, float(time[0]), round(1e9 * period), reference, measured,
        recording.q_motor[rows.start], recording.supply_at(grid))


def _resampled(grid, time, values):
    """Return values (T, ...) at other times, linearly between the samples."""
    flat = values.reshape(len(values), -1)
    columns = [np.interp(grid, time, flat[:, i]) for i in range(flat.shape[1])]
    return np.stack(columns, axis=1).reshape(values.shape)


def simulated(robot, believed, gains, segment, seed=_SEED) -> np.ndarray:
    """Return the link angles (T, n) [rad] of the closed loop whose controller had ``believed``."""
    loop = Loop(robot, believed, period_ns=segment.period_ns, seed=seed,
                q_link=segment.measured[0], begin=segment.begin)
    q_motor = np.where(np.isfinite(segment.q_motor), segment.q_motor, segment.measured[0])
    state = loop.plant_state
    state.q_motor[:] = np.where(robot.arm.rigid, segment.measured[0], q_motor)
    state.dq_link[:] = state.dq_motor[:] = segment.reference[0, 1]
    return loop.run(segment.reference, gains, supply=segment.supply).measured[:, 0]


def closed_loop_of(behind, recordings, gains) -> ClosedLoop:
    """Return the ClosedLoop of recordings whose controller believed what the search began with."""
    given, nuisances = behind.likelihood.robot, behind.likelihood.nuisances
    segments = [segment_of(recording.of_joints(given.joints)) for recording in recordings]
    retuned, after = (with_nuisances(one.robot, nuisances, one.x)
                      for one in (behind.before, behind.written))
    angles = {name: [simulated(robot, given, gains, segment, seed) for segment in segments]
              for name, robot, seed in (('before', given, _SEED), ('retuned', retuned, _SEED),
                                        ('after', after, _SEED), ('again', after, _OTHER_SEED))}
    measured, first = [segment.measured for segment in segments], segments[0]
    return ClosedLoop(
        joints=given.joints, sources=tuple(segment.source for segment in segments),
        **{name: _rms(angles[name], measured) for name in ('before', 'retuned', 'after')},
        floor=_rms(angles['again'], angles['after']),
        time=first.begin + 1e-9 * first.period_ns * np.arange(len(first.measured)),
        measured=first.measured, course_before=angles['retuned'][0],
        course_after=angles['after'][0])


def _rms(runs, others):
    """Return the rms difference of angles (T, n) over all recordings (n,)."""
    squares = [np.clip(np.nan_to_num(run - other, nan=FARTHEST), -FARTHEST, FARTHEST) ** 2
               for run, other in zip(runs, others, strict=True)]
    return np.sqrt(np.concatenate(squares).mean(axis=0))


def with_closed_loop(result, recordings, gains) -> Discrepancy:
    """Return a Discrepancy of which gap and words have the closed loop, too."""
    if result.gap is None:
        return result
    again = closed_loop_of(result.behind, recordings, gains)
    return replace(result.saying(sentence_of(again)), gap=replace(result.gap, closed_loop=again))


def sentence_of(again) -> str:
    """Return a ClosedLoop in words."""
    errors = ', '.join(
        f'{1e3 * before:.3g} -> {1e3 * after:.3g} mrad ({joint}, noise floor '
        f'{1e3 * floor:.3g})'
        for joint, before, after, floor in zip(again.joints, again.before, again.after,
                                               again.floor, strict=True))
    return ('Errors of the closed loop, simulated anew along the recorded reference and compared '
            f'with the link angles measured, are {errors}.')
