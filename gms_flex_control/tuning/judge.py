# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Gains judged on the whole arm: margins in many poses, noise, conditions, against demands."""

from typing import NamedTuple

from gms_flex_control.control import gain_conditions
from gms_flex_control.tuning.linear_loop import compliance, linear_loop
from gms_flex_control.tuning.margins import (
    delay_margin,
    Jitter,
    jitter,
    joint_margins,
    JointMargins,
    poses,
)
import numpy as np


class Judgement(NamedTuple):
    """What the theory and the linear loop say of gains; margins are the worst of all poses."""

    conditions: gain_conditions.GainReport
    joints: tuple            # of JointMargins
    delay: float             # further delay borne by all joints [s]; infinite if not asked for
    stable: bool
    jitter: Jitter           # worst of all poses
    ringing: float           # slowest decay of the loop while all blocks stick [1/s]; below 0
    #                          it grows until blocks slip
    held: np.ndarray         # (n,) error static friction of all joints can hold without any
    #                          compensation [rad]; NaN if not asked for


def judged(robot, model, gains, timing, *, with_delay=True):
    """
    Judge gains.

    Parameters
    ----------
    robot, model : RobotParams
        The robot as it is, and as the controller believes it to be.
    gains : ControllerParams
        The gains.
    timing : Timing
        Sample and delay.
    with_delay : bool
        Whether the delay margin and the ringing are sought as well.

    Returns
    -------
    Judgement

    """
    found, noises, delays, decays, held = [], [], [], [], []
    levels = np.maximum(robot.friction.forward.static, robot.friction.backward.static)
    for pose in poses(robot.arm):
        loop = linear_loop(robot, model, gains, timing, pose)
        if not loop.stable:
            return _unstable(robot, model, gains)
        found.append([joint_margins(loop, j) for j in range(robot.n_joints)])
        noises.append(jitter(loop, robot.encoder))
        if with_delay:
            delays.append(delay_margin(robot, model, gains, timing, pose))
            held.append(np.abs(compliance(robot, model, gains, timing, pose)) @ levels)
            stuck = linear_loop(robot, model, gains, timing, pose, stuck=True)
            decays.append(-np.log(np.abs(np.linalg.eigvals(stuck.closed)).max()) / timing.period)
    return Judgement(
        conditions=gain_conditions.check(gains, model),
        joints=tuple(_worst(column) for column in zip(*found, strict=True)),
        delay=min(delays, default=np.inf), stable=True,
        jitter=Jitter(*(np.max(values, axis=0) for values in zip(*noises, strict=True))),
        ringing=float(min(decays, default=np.nan)),
        held=np.max(held, axis=0) if held else np.full(robot.n_joints, np.nan))


def _unstable(robot, model, gains):
    nothing = JointMargins(1.0, 1.0, 0.0, 0.0, np.nan)
    unbounded = np.full(robot.n_joints, np.inf)
    return Judgement(gain_conditions.check(gains, model), (nothing,) * robot.n_joints, 0.0, False,
                     Jitter(unbounded, unbounded), np.nan, unbounded)


def _worst(found):
    """Return the worst of several JointMargins, number by number."""
    return JointMargins(
        gain_up=min(one.gain_up for one in found), gain_down=max(one.gain_down for one in found),
        phase=min(one.phase for one in found), distance=min(one.distance for one in found),
        crossover=max(one.crossover for one in found))


def demands_missed(judgement, demands, robot):
    """
    Return what a judgement lacks.

    Parameters
    ----------
    judgement : Judgement
        From `judged`.
    demands : Demands
        What is asked.
    robot : RobotParams
        Names the joints.

    Returns
    -------
    sentences : list of str
        Empty where all is met.
    too_fast : list of int
        Joints for which a slower loop may help.

    """
    sentences, too_fast = [], []
    for j, joint in enumerate(robot.joints):
        missed = [f'{joint}: {text}' for text in _joint_missed(judgement, demands, j)]
        sentences += missed
        too_fast += [j] if missed else []
    if judgement.delay < demands.delay:
        sentences.append(f'only {1e3 * judgement.delay:.3g} ms of further delay are borne, asked '
                         f'{1e3 * demands.delay:.3g}')
        too_fast = list(range(robot.n_joints))
    broken = [one for one in judgement.conditions.conditions
              if one.kind == gain_conditions.EXACT and not one.met]
    sentences += [f'{one.joint}: {one.condition} does not hold, {one.value:.4g} against '
                  f'{one.limit:.4g}' for one in broken]
    return sentences, too_fast


def _joint_missed(judgement, demands, j):
    one = judgement.joints[j]
    if not judgement.stable:
        yield 'the sampled loop is unstable'
        return
    if one.gain_up < demands.gain or one.gain_down > 1.0 / demands.gain:
        yield (f'gain margin {one.gain_down:.3g} to {one.gain_up:.3g} times, asked '
               f'{1.0 / demands.gain:.3g} to {demands.gain:.3g}')
    if one.phase < demands.phase:
        yield (f'phase margin {np.degrees(one.phase):.3g} degrees, asked '
               f'{np.degrees(demands.phase):.3g}')
    noise, allowed = judgement.jitter.torque[j], demands.noise * demands.torque_limit[j]
    if noise > allowed:
        yield f'encoders cause {noise:.3g} N m rms of torque, asked at most {allowed:.3g}'
