# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Errors on data that had no part in a fit, beside Coulomb and viscous friction alone.

Measured and predicted torque pass through one zero-phase low-pass, below the frequencies at
which the smoothing of the acceleration shows: the error then is the model's, not the filter's.
What the model leaves may go with the motion of other axes: then a sentence says so.
"""

from collections.abc import Callable, Sequence

from gms_flex_control.data.signal_analysis import low_pass, low_pass_bandwidth, rms, runs
from gms_flex_control.dynamics.chain import inverse_dynamics
from gms_flex_control.identification.coordinates import Coordinates
from gms_flex_control.identification.objective import Objective, torque_memory
from gms_flex_control.identification.outcome import HeldOutErrors, PreslidingLoop, Trace
from gms_flex_control.identification.segments import Segment, standing
import numpy as np
from scipy.optimize import lsq_linear

HORIZON = 0.5       # of a free simulation [s]
PRESLIDING = 'presliding'
FEWEST_WAVES = 6.0  # of a ripple in the range of angles: fewer may be gravity or friction
_STRIDE = 1.0       # from one start to the next [s]
_LEAST_ONE = np.array([1e-4, 1e-4, 0.0, 0.0])  # friction, of the torque: logarithms stay finite
_DIRECTIONS_SD = 0.3  # by which directions differ, of all friction; priors, with the next two
_VISCOUS_SD = 1.0    # of the viscous part at usual speed, of all friction
_FURTHER_SD = 10.0   # of corrections of further torques, of their units: next to nothing
_SMALL, _FAST = 1e-3, 10.0  # least friction, of the other way; speed [rad/s]
_LONGEST_TRACE = 20_000
_MOST_LOOPS, _LONGEST_LOOP = 6, 4000
_SHORTEST = 1.0       # of a loop that is shown [s]
_LOADED = 0.98        # of F_s: presliding is what stays below
_SHARE = 0.25         # of what is left, on data held out, that others must account for
_WORTH = 0.02         # of the drive torque that must be left
_FEWEST = 100         # samples to fit and to judge by
_OWN, _SLOW = 6, 0.05  # columns of the axis itself; speed, of the usual, where its sign is clear
_NO_LINKS = (
    'the axes act on each other (inertia, gravity), which a model of single axes lacks, so '
    'inertia, gravity and friction hold for this motion only; move one axis at a time, or '
    'describe the links as a planar arm or by a URDF whose masses are right')
_WRONG_LINKS = (
    'the links are not as this model has them, so friction holds for this motion only; estimate '
    'them (--estimate all) from motion in which joints do not all turn at once, as gms_flex plan '
    'writes it, and state loads in recording.yaml')


def coulomb_viscous(objective: Objective, step: float, chosen: Callable) -> np.ndarray:
    """
    Fit Coulomb and viscous friction alone, each direction its own, by least squares.

    Returns Coulomb forward and backward [N m], viscous forward and backward [N m s/rad], and the
    R coefficients of further torques (4 + R,), from the ``chosen`` samples, Segment -> bool (T,),
    that move; ``step`` is the encoder step or noise [rad].
    """
    joint, bundle, rows, targets = objective.joint, objective.bundle, [], []
    for segment in bundle.segments:
        rate = segment.rate[:, joint]
        keep = chosen(segment) & (np.abs(rate) > standing(step)) & segment.tested[:, joint]
        columns = np.concatenate([simple_friction(segment, joint), -objective.extra(segment)],
                                 axis=1)
        rows.append(low_pass(columns, segment.window)[keep])
        targets.append(low_pass(objective.measured(segment), segment.window)[keep])
    columns, target = np.concatenate(rows), np.concatenate(targets)
    if columns.shape[1] == len(_LEAST_ONE):
        return np.linalg.lstsq(columns, target, rcond=None)[0]
    return _beside_further(columns, target, torque_memory(
        bundle.period, [segment.window for segment in bundle.segments]))


def simple_friction(segment: Segment, joint: int) -> np.ndarray:
    """Return Coulomb and viscous friction of each direction per unit of its number (T, 4)."""
    rate = segment.rate[:, joint]
    forward, backward = rate > 0.0, rate < 0.0
    return segment.factor[:, [joint]] * np.stack(
        [forward, -1.0 * backward, forward * rate, backward * rate], axis=1)


def _beside_further(columns, target, memory):
    """
    Return least squares of a torque (S,) in columns of friction and, after four, further torques.

    Of ``memory`` samples one counts. A constant torque is the same as friction that differs
    between the directions, over part of a turn gravity nearly so, and viscous friction as much at
    one speed: so friction is never negative, its directions are weakly alike, and its viscous part
    and the further torques weakly absent.
    """
    further = columns.shape[1] - len(_LEAST_ONE)
    least = np.append(max(rms(target), 1e-300) * _LEAST_ONE, np.full(further, -np.inf))
    root = np.linalg.qr(np.column_stack([columns, target]), mode='r')

    def bounded(columns, target):
        return lsq_linear(columns, target, (least, np.inf), method='bvls').x
    found = bounded(root[:, :-1], root[:, -1])
    noise = np.sqrt(memory / len(target)) * np.linalg.norm(root @ np.append(found, -1.0))
    usual = np.sqrt([np.sum(columns[:, 2 + way] ** 2) / max(np.sum(columns[:, way] ** 2), 1.0)
                     for way in (0, 1)])
    level = np.mean(found[:2] + usual * found[2:4])
    prior = np.zeros((3 + further, columns.shape[1]))
    prior[0, :2] = np.array([0.5, -0.5]) / (_DIRECTIONS_SD * level)
    prior[1:3, 2:4] = np.diag(usual) / (_VISCOUS_SD * level)
    prior[3:, 4:] = np.eye(further) / _FURTHER_SD
    return bounded(np.concatenate([root[:, :-1], noise * prior]),
                   np.append(root[:, -1], np.zeros(len(prior))))


def simple_free(fit: np.ndarray, displacement: float) -> tuple[Coordinates, np.ndarray]:
    """Return `coulomb_viscous` as a block that yields at ``displacement`` [rad]."""
    coulomb = np.maximum(fit[:2], _SMALL * np.abs(fit[:2]).max())
    viscous = np.maximum(fit[2:4], 1e-3 * coulomb / _FAST)
    coordinates = Coordinates(1, n_extra=len(fit) - 4)
    free = coordinates.pack(coulomb * 1.001, coulomb, np.full(2, 1e-3), viscous,
                            coulomb.mean() / 0.01, [displacement], extra=fit[4:])
    return coordinates, free


def free_run_error(objective: Objective, theta: np.ndarray, chosen: Callable) -> float:
    """Return the rms error of free simulations of HORIZON of chosen samples [rad]; NaN if none."""
    squares = free_run_squares(objective, theta, chosen)
    return float(np.sqrt(np.mean(squares))) if len(squares) else np.nan


def free_run_squares(objective: Objective, theta: np.ndarray, chosen: Callable) -> np.ndarray:
    """Return mean squared errors of free simulations of HORIZON of chosen samples (R,) [rad^2]."""
    period, joint, squares = objective.bundle.period, objective.joint, []
    horizon, stride = round(HORIZON / period), round(_STRIDE / period)
    for segment in objective.bundle.segments:
        starts = max((len(segment.angle) - 1 - horizon - stride) // stride + 1, 0)
        keep = chosen(segment) & segment.tested[:, joint]
        if not starts or not keep.any():
            continue
        predicted = objective.simulate_freely(segment, theta, stride, stride, horizon, starts)
        for start in range(starts):
            rows = slice((start + 1) * stride, (start + 1) * stride + horizon)
            measured = segment.angle[rows, joint]
            known = np.isfinite(measured) & keep[rows]
            if known.all():
                squares.append(np.mean((predicted[start] - measured) ** 2))
    return np.array(squares)


def held_out_errors(objective: Objective, theta: np.ndarray, simple: np.ndarray,
                    chosen: Callable, step: float, repeatability: float) -> HeldOutErrors:
    """
    Return the HeldOutErrors of one joint.

    ``theta`` and ``simple`` (Coulomb and viscous friction with one stiff block) are fitted
    without the samples that are ``chosen``; ``step`` is the encoder step or noise [rad],
    ``repeatability`` that of the torque [N m].
    """
    bundle, joint = objective.bundle, objective.joint
    off, plain, torque, noise, innovations = [], [], [], [], []
    for segment in bundle.segments:
        keep = chosen(segment) & segment.tested[:, joint]
        if not keep.any():
            continue
        window = segment.window
        innovations.append(objective.predict(segment, theta)[1][keep])
        keep &= bundle.judged(segment, joint, step)
        measured = objective.measured(segment)
        for errors, parameters in ((off, theta), (plain, simple)):
            errors.append(low_pass(measured - objective.resistance(segment, parameters),
                                   window)[keep])
        drive = segment.torque + segment.taken
        torque.append(low_pass(drive[:, joint], window)[keep])
        noise.append(_torque_noise(segment.torque[:, joint], window)[keep])
    off, plain, torque, noise, innovations = (
        np.concatenate(part) for part in (off, plain, torque, noise, innovations))
    usual = rms(torque)
    return HeldOutErrors(
        torque_rms=rms(off), relative=rms(off) / usual, coulomb_viscous=rms(plain) / usual,
        free_run_rms=free_run_error(objective, theta, chosen),
        free_run_coulomb_viscous=free_run_error(objective, simple, chosen),
        horizon=HORIZON, innovation_rms=rms(innovations), noise_floor=rms(noise),
        repeatability=repeatability, bandwidth=low_pass_bandwidth(
            max(segment.window for segment in bundle.segments), bundle.period))


def _torque_noise(torque, window):
    """Return white noise of a torque (T,) like its own, behind the low-pass [N m]."""
    rough = np.diff(torque, 2, prepend=torque[:1], append=torque[-1:]) / np.sqrt(6.0)
    usual = rough[np.abs(rough) <= np.quantile(np.abs(rough), 0.99)]  # no jumps of the torque
    level = rms(usual)
    pulse = np.zeros(4 * window + 1)
    pulse[2 * window] = 1.0
    gain = np.sqrt(np.sum(low_pass(pulse, window) ** 2))
    return np.full(len(torque), level * gain)


def traces_of(objective: Objective, theta: np.ndarray, chosen: Callable) -> tuple:
    """Return a Trace of each segment in which the joint is tested, thinned for drawing."""
    traces = []
    for segment in objective.bundle.segments:
        keep = np.flatnonzero(segment.tested[:, objective.joint])
        if not len(keep):
            continue
        thin = keep[::max(1, len(keep) // _LONGEST_TRACE)]
        model = low_pass(objective.resistance(segment, theta), segment.window)
        measured = low_pass(objective.measured(segment), segment.window)
        traces.append(Trace(
            segment.begin + objective.bundle.period * thin, segment.rate[thin, objective.joint],
            measured[thin], model[thin],
            chosen(segment)[thin], segment.source))
    return tuple(traces)


def _presliding(objective, theta):
    """
    Yield each segment with the torque friction holds at rest (T,) [N m], and slices of presliding.

    By the phases or, unnamed, friction below break-away for a while.
    """
    joint, period = objective.joint, objective.bundle.period
    for segment in objective.bundle.segments:
        still = np.zeros_like(segment.rate)  # counts hide acceleration
        torque = (segment.torque - inverse_dynamics(np.nan_to_num(
            segment.angle), still, still, objective.bundle.arm))[:, joint]
        if (segment.phase != '').any():
            inside = (segment.phase == PRESLIDING) & segment.tested[:, joint]
        else:
            width = max(round(_SHORTEST / period), 1)
            loaded = np.abs(torque) > _LOADED * min(theta[[0, 4]])
            inside = np.convolve(loaded, np.ones(width), 'same') <= 0.5
        yield segment, torque, [slice(begin, end) for begin, end in runs(inside)
                                if (end - begin) * period >= _SHORTEST]


def presliding_reach(objective: Objective, theta: np.ndarray) -> float:
    """Return how far the joint went in one part of presliding, at most [rad]."""
    angles = [segment.angle[rows, objective.joint]
              for segment, _, parts in _presliding(objective, theta) for rows in parts]
    return max((float(np.nanmax(one) - np.nanmin(one)) for one in angles), default=0.0)


def loops_of(objective: Objective, theta: np.ndarray) -> tuple:
    """Return at most six PreslidingLoops (Fig. 4) of the joint, of the largest torque."""
    joint, loops = objective.joint, []
    for segment, torque, parts in _presliding(objective, theta):
        predicted = objective.predict(segment, theta)[0] if parts else None
        for rows in parts:
            thin = slice(rows.start, rows.stop, max(1, (rows.stop - rows.start) // _LONGEST_LOOP))
            origin = np.nanmean(segment.angle[rows, joint])
            loops.append(PreslidingLoop(
                segment.angle[thin, joint] - origin, torque[thin], predicted[thin] - origin,
                f'{segment.source}, {segment.begin + rows.start * objective.bundle.period:.1f} s'))
    loops.sort(key=lambda loop: -np.nanmax(np.abs(loop.torque)))
    return tuple(loops[:_MOST_LOOPS])


def coupling_sentences(objective: Objective, theta: np.ndarray, names: Sequence[str],
                       chosen: Callable, apart=(), in_space: bool = False) -> tuple:
    """
    Return a sentence if other axes account for what the model leaves of a joint's torque, or none.

    ``in_space``: links of a URDF have been taken off the torque.

    Of decoupled axes only: least squares of the residual on the axis' own motion (what the others
    do had its share in what was fitted) and on the accelerations of the others, alone or with what
    their angles do to inertia; the share they account for is that of data they were not fitted to,
    the ``chosen`` samples or the segments ``apart``. Gravity of a chain would need many more
    columns, which short recordings do not separate.
    """
    bundle, joint = objective.bundle, objective.joint
    others = [k for k in range(len(names)) if k != joint]
    if bundle.arm.kind != 'decoupled' or not others:
        return ()
    parts = [_left(objective, theta, segment, others, out) for segment, out in (
        *((one, chosen(one) & (not apart)) for one in bundle.segments),
        *((one, np.ones(len(one.angle), dtype=bool)) for one in apart))]
    left, columns, torque, out = (np.concatenate(part) for part in zip(*parts, strict=True))
    if min(out.sum(), (~out).sum()) < _FEWEST:
        return ()
    share = max(_share(left, columns[:, :width], out)
                for width in (_OWN + len(others), columns.shape[1]))
    if share < _SHARE or rms(left[out]) < _WORTH * rms(torque[out]):
        return ()
    return (f'{100 * share:.0f} % of what this model leaves of the torque of {names[joint]} goes '
            f'with the motion of {", ".join(names[k] for k in others)}: '
            f'{_WRONG_LINKS if in_space else _NO_LINKS}',)


def _left(objective, theta, segment, others, out):
    """Return what is left of the torque (T,), columns of the others, it and ``out`` (T,)."""
    joint = objective.joint
    residual = objective.measured(segment) - objective.resistance(segment, theta)
    bend, cosine = segment.acceleration, np.cos(np.nan_to_num(segment.angle[:, others]))
    rate, angle = segment.rate[:, joint], np.nan_to_num(segment.angle[:, joint])
    own = [np.ones(len(rate)), bend[:, joint], rate, np.tanh(rate / (_SLOW * rms(rate) + 1e-12)),
           np.cos(angle), np.sin(angle)]
    columns = np.concatenate([np.stack(own, axis=1), bend[:, others], bend[:, others] * cosine,
                              bend[:, [joint]] * cosine], axis=1)
    keep = segment.tested[:, joint] & np.isfinite(segment.angle).all(axis=1)
    return tuple(part[keep] for part in (
        low_pass(residual, segment.window), low_pass(columns, segment.window),
        segment.torque[:, joint], out))


def _share(left, columns, out):
    """Return how much of the square of ``left`` others account for, beyond the axis itself."""
    rests = []
    for width in (0, _OWN, columns.shape[1]):
        part = columns[:, :width]
        fit = np.linalg.lstsq(part[~out], left[~out], rcond=1e-9)[0]
        rests.append(rms(left[out] - part[out] @ fit))
    return 1.0 - (rests[2] / max(min(rests[:2]), 1e-300)) ** 2
