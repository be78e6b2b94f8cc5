# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A controller tried on a simulated robot: how it tracks, what it costs, how quiet it rests."""

from dataclasses import replace
import math
from typing import NamedTuple

from gms_flex_control.effects.catalogue.input_delay import InputDelay
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.simulation import closed_loop
from gms_flex_control.trajectory import builders
import numpy as np

MOTIONS = ('sinusoid', 'polynomial')
PERIOD, MOVE, HOLD = 6.0, 5.0, 5.0  # of the paper's motions as assumed in config/ [s]
DURATION = {'sinusoid': 20.0, 'polynomial': 3 * HOLD + 2 * MOVE}  # [s]
_SETTLING = 1.0         # of a hold, before its rest is judged [s]
_SUBSTEP = 1e-4         # [s]
_LOST = 10.0            # an error beyond this is no tracking any more [rad]


class Trial(NamedTuple):
    """
    The figures of one run, a list over joints each; None where it was lost.

    ``mse`` of link angle - reference [rad^2]; ``peak`` of its size [rad]; ``hold``, largest
    peak to peak of the link in the rests [rad], None without rests; ``torque``, rms [N m];
    ``rate``, rms of its change over the sample [N m/s]; ``limit``, largest torque [N m].
    """

    lost: bool
    mse: list | None = None
    peak: list | None = None
    hold: list | None = None
    torque: list | None = None
    rate: list | None = None
    limit: list | None = None


def motion_of(name, amplitude):
    """
    Return one of the paper's motions as assumed in config/.

    Parameters
    ----------
    name : str
        One of `MOTIONS`.
    amplitude : ndarray, shape (n_joints,)
        [rad].

    Returns
    -------
    Trajectory
        Lasting `DURATION`.

    """
    if name == 'sinusoid':
        return builders.sinusoid(amplitude, PERIOD)
    return builders.polynomial(amplitude, MOVE, HOLD)


def with_delay(robot, delay):
    """Return a robot whose motors get every torque later by ``delay`` [s]."""
    if delay <= 0.0:
        return robot
    late = tuple(EffectSpec(name=InputDelay.name, joint=joint, values=(float(delay),))
                 for joint in robot.joints)
    return replace(robot, effects=(*robot.effects, *late))


def try_gains(robot, model, gains, timing, motion, amplitude, seed=0):
    """
    Simulate a motion.

    Parameters
    ----------
    robot, model : RobotParams
        The robot as it is, and as the controller believes it to be.
    gains : ControllerParams
        Of the controller.
    timing : Timing
        Sample and delay.
    motion : str
        One of `MOTIONS`.
    amplitude : ndarray, shape (n_joints,)
        [rad].
    seed : int
        Of the encoder noise.

    Returns
    -------
    trial : Trial
        Its figures.
    run : Run
        The run itself.

    """
    run = closed_loop.run(
        with_delay(robot, timing.delay), model, gains, motion_of(motion, amplitude),
        duration=DURATION[motion], period_ns=round(1e9 * timing.period), seed=seed,
        substeps=max(5, math.ceil(timing.period / _SUBSTEP - 1e-9)))
    return figures_of(run, motion), run


def figures_of(run, motion):
    """Return the Trial of a Run of a motion."""
    error = run.true[:, 0] - run.reference[:, 0]
    if not (np.isfinite(error).all() and np.abs(error).max() < _LOST):
        return Trial(lost=True)
    period = run.time[1] - run.time[0]
    hold = None
    if motion == 'polynomial':
        rests = [_rest(run, HOLD * k + MOVE * k) for k in (1, 2)]
        hold = np.max([np.ptp(run.true[rest, 0], axis=0) for rest in rests], axis=0).tolist()
    return Trial(
        lost=False, mse=np.mean(error ** 2, axis=0).tolist(),
        peak=np.abs(error).max(axis=0).tolist(), hold=hold,
        torque=np.sqrt(np.mean(run.command ** 2, axis=0)).tolist(),
        rate=np.sqrt(np.mean((np.diff(run.command, axis=0) / period) ** 2, axis=0)).tolist(),
        limit=np.abs(run.command).max(axis=0).tolist())


def _rest(run, begin):
    return slice(*np.searchsorted(run.time, [begin + _SETTLING - 1e-9, begin + HOLD - 1e-9]))
