# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Margins of the sampled loop, what encoder noise does in it, and gains judged by both."""

from itertools import product
from typing import NamedTuple

from gms_flex_control.control import gain_conditions
from gms_flex_control.dynamics import chain
from gms_flex_control.tuning.linear_loop import compliance, law_of, linear_loop
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

UNSTABLE = 'the sampled loop is unstable; lower --bandwidth or --delay, or raise --rate'
_GRID = 400              # frequencies up to half the sample rate
_LOWEST = 0.05           # of them [rad/s]
_MOST_SAMPLES = 50.0     # of delay that are looked at
_HALVINGS = 12
_MOST_POSES = 27
_POSES_IN_SPACE = 6  # each takes seconds with seven joints


class JointMargins(NamedTuple):
    """How much one joint's loop bears, the others closed."""

    gain_up: float    # factor on the torque at which the loop gets unstable; infinite if none
    gain_down: float  # and the one below 1; 0 if none
    phase: float      # least turn of the loop at which it does [rad]
    distance: float   # least abs(1 + L)
    crossover: float  # highest frequency at which abs(L) = 1 [rad/s]


class Jitter(NamedTuple):
    """What encoders leave at rest, standard deviations (n,): torque [N m] and angle [rad]."""

    torque: np.ndarray
    angle: np.ndarray


def poses(arm) -> list:
    """
    Return where an arm is examined, a list of angles (n,) [rad].

    A coarse grid from stretched to folded; where there is gravity the first joint turns too.
    Decoupled axes without gravity have one pose, chains in space a few spread over the ranges of
    their joints.
    """
    n = arm.n_joints
    if arm.kind == 'urdf':
        return list(chain.configurations(arm, _POSES_IN_SPACE))
    turning = [arm.kind == 'planar'] * n
    turning[0] = False
    if np.any(arm.gravity != 0.0):
        turning = [True] * n
    count = sum(turning)
    if not count:
        return [np.zeros(n)]
    angles = np.linspace(0.0, np.pi, 5 if count == 1 else 3)
    if np.any(arm.gravity != 0.0):
        angles = np.append(angles, -np.pi / 2.0)
    grid = product(*(angles if turns else [0.0] for turns in turning))
    return [np.array(pose) for pose, _ in zip(grid, range(_MOST_POSES), strict=False)]


def open_loop(loop, joint, frequencies) -> np.ndarray:
    """Return the response L (F,) of one joint's loop to ``frequencies`` [rad/s], others closed."""
    others = [i for i in range(loop.b.shape[1]) if i != joint]
    a = loop.a + loop.b[:, others] @ loop.c[others]
    points = np.exp(1j * np.asarray(frequencies) * loop.period)
    matrices = points[:, None, None] * np.eye(len(a)) - a
    right = np.broadcast_to(loop.b[:, [joint]].astype(complex), (len(points), len(a), 1))
    return -(np.linalg.solve(matrices, right)[..., 0] @ loop.c[joint])


def joint_margins(loop, joint) -> JointMargins:
    """Return the margins of one joint's loop, stable when closed."""
    highest = np.pi / loop.period
    grid = np.geomspace(_LOWEST, highest, _GRID)
    grid[-1] = highest
    response = open_loop(loop, joint, grid)
    real = _crossings(loop, joint, grid, response, lambda values: values.imag)
    factors = [-1.0 / value for value in [*real[1].real, response[-1].real] if value < 0.0]
    unit = _crossings(loop, joint, grid, response, lambda values: np.abs(values) - 1.0)
    return JointMargins(
        gain_up=min((factor for factor in factors if factor > 1.0), default=np.inf),
        gain_down=max((factor for factor in factors if factor < 1.0), default=0.0),
        phase=float(np.abs(np.angle(-unit[1])).min(initial=np.pi)),
        distance=float(np.abs(1.0 + response).min()),
        crossover=float(unit[0].max(initial=0.0)))


def _crossings(loop, joint, grid, response, measure):
    """Return frequencies and responses where ``measure`` of the response is zero."""
    values = measure(response)
    places = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    low, high, left = grid[places], grid[places + 1], values[places]
    for _ in range(_HALVINGS if len(places) else 0):
        middle = np.sqrt(low * high)
        found = measure(open_loop(loop, joint, middle))
        same = found * left > 0.0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    middle = np.sqrt(low * high)
    return middle, open_loop(loop, joint, middle) if len(places) else np.zeros(0, complex)


def delay_margin(robot, model, gains, timing, pose, most=np.inf) -> float:
    """
    Return the least further delay [s] of all torques at which the loop is unstable.

    It is not sought beyond ``most``: inf then.
    """
    law = law_of(model, gains, timing, pose)

    def stable(extra):
        late = timing._replace(delay=timing.delay + extra)
        return linear_loop(robot, model, gains, late, pose, law=law).stable

    low, high = 0.0, 0.25 * timing.period
    while stable(high):
        low, high = high, high + min(0.5 * timing.period + 0.1 * high, 5.0 * timing.period)
        if low > min(most, _MOST_SAMPLES * timing.period):
            return np.inf
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def jitter(loop, encoder) -> Jitter:
    """
    Return what the encoders' noise and counts do to torque and links at rest.

    Counts are noise here, equally spread within one and new at each sample.
    """
    n = loop.b.shape[1]
    count = 2.0 * np.pi / float(encoder.counts) if encoder.counts > 0 else 0.0
    variance = float(encoder.noise) ** 2 + count ** 2 / 12.0
    entering = loop.noise + loop.b @ loop.through
    spread = solve_discrete_lyapunov(loop.closed, variance * entering @ entering.T)
    torque = np.einsum('ij,jk,ik->i', loop.c, spread, loop.c) + variance * np.sum(
        loop.through ** 2, axis=1)
    return Jitter(np.sqrt(torque), np.sqrt(np.diag(spread)[:n]))


class Judgement(NamedTuple):
    """What the theory and the linear loop say of gains; margins are the worst of all poses."""

    conditions: gain_conditions.GainReport
    joints: tuple            # of JointMargins
    delay: float             # further one all joints tolerate [s]; infinite if not required for
    stable: bool
    jitter: Jitter           # worst of all poses
    ringing: float           # slowest decay of the loop while all blocks stick [1/s]; below 0
    #                          it grows until blocks slip
    held: np.ndarray         # (n,) error static friction of all joints can hold without any
    #                          compensation [rad]; NaN if not required for


def judged(robot, model, gains, timing, *, with_delay=True) -> Judgement:
    """Judge gains of a ``robot`` by a believed ``model``; delay and rest ``with_delay`` only."""
    found, noises, delays, decays, held = [], [], [], [], []
    levels = np.maximum(robot.friction.forward.static, robot.friction.backward.static)
    for pose in poses(robot.arm):
        loop = linear_loop(robot, model, gains, timing, pose)
        if not loop.stable:
            unbounded = np.full(robot.n_joints, np.inf)
            return Judgement(
                gain_conditions.check(gains, model),
                (JointMargins(1.0, 1.0, 0.0, 0.0, np.nan),) * robot.n_joints, 0.0, False,
                Jitter(unbounded, unbounded), np.nan, unbounded)
        found.append([joint_margins(loop, j) for j in range(robot.n_joints)])
        noises.append(jitter(loop, robot.encoder))
        if with_delay:
            delays.append(delay_margin(robot, model, gains, timing, pose,
                                       min(delays, default=np.inf)))
            held.append(np.abs(compliance(robot, model, gains, timing, pose)) @ levels)
            stuck = linear_loop(robot, model, gains, timing, pose, stuck=True)
            decays.append(-np.log(np.abs(np.linalg.eigvals(stuck.closed)).max()) / timing.period)
    return Judgement(
        conditions=gain_conditions.check(gains, model),
        joints=tuple(JointMargins(*(worst(figures) for worst, figures in zip(
            (min, max, min, min, max), zip(*column, strict=True), strict=True)))
            for column in zip(*found, strict=True)),
        delay=min(delays, default=np.inf), stable=True,
        jitter=Jitter(*(np.max(values, axis=0) for values in zip(*noises, strict=True))),
        ringing=float(min(decays, default=np.nan)),
        held=np.max(held, axis=0) if held else np.full(robot.n_joints, np.nan))


def demands_missed(judgement, demands, robot) -> tuple:
    """Return the missed Demands as sentences, and the joints a slower loop may help."""
    sentences, too_fast = [], []
    for j, joint in enumerate(robot.joints):
        missed = [f'{joint}: {text}' for text in _joint_missed(judgement, demands, j)]
        sentences += missed
        too_fast += [j] if missed else []
    if judgement.stable and judgement.delay < demands.delay:
        sentences.append(f'the loop tolerates {1e3 * judgement.delay:.3g} ms of further delay, '
                         f'{1e3 * demands.delay:.3g} ms required')
        too_fast = list(range(robot.n_joints))
    broken = [one for one in judgement.conditions.conditions
              if one.kind == gain_conditions.EXACT and not one.met]
    sentences += [f'{one.joint}: {one.condition} does not hold, {one.value:.4g} against '
                  f'{one.limit:.4g}' for one in broken]
    return sentences, too_fast


def _joint_missed(judgement, demands, j):
    one = judgement.joints[j]
    if not judgement.stable:
        yield UNSTABLE
        return
    if one.gain_up < demands.gain or one.gain_down > 1.0 / demands.gain:
        yield (f'gain margin {one.gain_down:.3g} to {one.gain_up:.3g} times, required '
               f'{1.0 / demands.gain:.3g} to {demands.gain:.3g}')
    if one.phase < demands.phase:
        yield (f'phase margin {np.degrees(one.phase):.3g} degrees, required '
               f'{np.degrees(demands.phase):.3g}')
    noise, allowed = judgement.jitter.torque[j], demands.noise * demands.torque_limit[j]
    if noise > allowed:
        yield f'encoders cause {noise:.3g} N m rms of torque, at most {allowed:.3g}'
