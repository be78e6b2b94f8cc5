# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The closed loop linearised at rest, sample by sample as it runs.

Arm, springs and motors are integrated exactly between samples under a held torque that comes
late by the computation delay; velocities are the low-passed differences of the encoders; the
controller is the derivative of its own code, control.cascade.tick. Counts of the encoders and
the torque limit are not linear and not in it.
"""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

from gms_flex_control.control import cascade
from gms_flex_control.dynamics import chain
from gms_flex_control.effects import table as effect_table
import numpy as np
from scipy.linalg import expm

_STEP = 1e-6  # of the central differences: the law is linear there but for rounding


class Timing(NamedTuple):
    """When the controller acts: sample period and delay from measurement to torque [s]."""

    period: float
    delay: float


class LinearLoop(NamedTuple):
    """The loop cut open at the torques: ``z+ = a z + b u_in``, ``u_out = c z``."""

    a: np.ndarray        # (N, N)
    b: np.ndarray        # (N, n)
    c: np.ndarray        # (n, N)
    noise: np.ndarray    # (N, 2n) how angles added to what the encoders see enter z+ ...
    through: np.ndarray  # (n, 2n) ... and u_out; links, then motors
    period: float        # [s]

    @property
    def closed(self) -> np.ndarray:
        """Return the matrix (N, N) of the closed loop."""
        return self.a + self.b @ self.c

    @property
    def stable(self) -> bool:
        """Return whether all poles lie within the unit circle."""
        return bool(np.abs(np.linalg.eigvals(self.closed)).max() < 1.0)


def _arm_equations(robot, pose, *, stuck=False):
    """
    Return the continuous equations (a, b) of the arm at rest in a pose (n,) [rad].

    The states (4n) are q_link, dq_link, q_motor, dq_motor, those of a rigid joint's motor side
    idle; inputs are the motor torques. Effects count that only change parameters. If ``stuck``,
    all friction blocks stick and are a spring on each link; else there is no friction, which is
    what a right compensation leaves.
    """
    robot = effect_table.with_changes(robot)
    n, rigid = robot.n_joints, robot.arm.rigid
    mass, pull = _mass_and_pull(robot.arm, pose)
    stiffness = np.diag(np.where(rigid, 0.0, robot.arm.stiffness))
    damping = np.diag(np.where(rigid, 0.0, robot.arm.damping))
    held = np.zeros((n, n))
    viscous = np.zeros((n, n))
    if stuck:
        held = np.diag(robot.friction.stiffness.sum(axis=1))
        viscous = np.diag(np.minimum(robot.friction.forward.viscous,
                                     robot.friction.backward.viscous))
    links = np.linalg.solve(mass, np.hstack([
        -stiffness - pull - held, -damping - viscous, stiffness, damping, np.diag(1.0 * rigid)]))
    inertia = np.where(rigid, 1.0, robot.arm.motor_inertia)[:, None]
    motors = np.hstack([stiffness, damping, -stiffness, -damping, np.diag(1.0 * ~rigid)]) / inertia
    zero, one = np.zeros((n, n)), np.eye(n)
    a = np.block([[zero, one, zero, zero], [links[:, :4 * n]],
                  [zero, zero, zero, np.diag(1.0 * ~rigid)], [motors[:, :4 * n]]])
    idle = np.flatnonzero(np.tile(rigid, 2)) + 2 * n
    a[idle, idle] = -1.0  # nothing reads them; at 0 they would count as not stable
    return a, np.vstack([zero, links[:, 4 * n:], zero, motors[:, 4 * n:]])


def _mass_and_pull(arm, pose):
    """Return M(q) and the derivative of the gravity torque there, each (n, n)."""
    steps = _STEP * np.eye(arm.n_joints)
    above, below = (chain.inverse_dynamics(pose + side * steps, 0.0, 0.0, arm)
                    for side in (1.0, -1.0))
    return chain.mass_matrices(pose[None], arm)[0], (above - below).T / (2.0 * _STEP)


def _controller_law(gains, model, pose, period):
    """Return the derivative (3n, 7n) of the controller at rest, with ``none`` or ``gms``."""
    n = model.n_joints
    constants, work = cascade.constants_of(gains, model), cascade.workspace(n)
    reference = np.vstack([pose, np.zeros((4, n))])
    held = chain.inverse_dynamics(pose, 0.0, 0.0, model.arm)  # gravity's torque
    motor = pose + np.where(model.arm.rigid, 0.0, held / model.arm.stiffness)
    middle = np.concatenate([pose, np.zeros(n), motor, np.zeros(n), held, np.zeros(2 * n)])

    def answer(values):
        state, measured = cascade.init(model), cascade.measurement(n)
        for name, value in zip(('q_link', 'dq_link', 'q_motor', 'dq_motor'),
                               values[:4 * n].reshape(4, n), strict=True):
            measured[name][:] = value
        state.command[:] = values[4 * n:5 * n]
        state.observer.filtered[:] = values[5 * n:].reshape(2, n)
        cascade.tick(state, measured, reference, period, constants, work)
        return np.concatenate([state.command, *state.observer.filtered])

    law = np.stack([(answer(middle + step) - answer(middle - step)) / (2.0 * _STEP)
                    for step in _STEP * np.eye(7 * n)], axis=1)
    if gains.compensation == 'none':
        law[n:] = 0.0  # the filter stands still
    return law


def linear_loop(robot, model, gains, timing, pose, *, stuck=False, law=None) -> LinearLoop:
    """
    Return the sampled loop, linearised at rest in a pose (n,) [rad].

    ``robot`` is the robot as it is, ``model`` what the controller believes. Compensation counts
    only if ``stuck`` (see `_arm_equations`). ``law`` is that of `law_of`, where several delays
    need it.
    """
    n, period = robot.n_joints, timing.period
    if law is None:
        law = law_of(model, gains, timing, pose, stuck=stuck)
    phi, gammas = _sampled_arm(robot, tuple(pose), timing, stuck)
    seen, memory = _encoders(robot, period)
    late = len(gammas) * n
    # z: arm 4n, angles of the sample before 2n, velocities 2n, torques under way, law 3n
    starts = np.cumsum([0, 4 * n, 2 * n, 2 * n, late, 3 * n])
    arm, angles, rates, line, past = (slice(i, j) for i, j in zip(
        starts[:-1], starts[1:], strict=True))
    size = starts[-1]
    measured = np.zeros((4 * n, size))
    measured[:, :starts[3]] = seen
    a, b, noise = np.zeros((size, size)), np.zeros((size, n)), np.zeros((size, 2 * n))
    a[arm, arm], b[arm] = phi, gammas[0]
    for k, gamma in enumerate(gammas[1:]):
        a[arm, line][:, k * n:(k + 1) * n] = gamma
    a[angles], noise[angles] = measured[memory.angles], np.eye(2 * n)
    a[rates] = measured[memory.rates]
    b[line][:n] = np.eye(n)
    a[line, line][n:, :-n] = np.eye(late - n)
    entering = law[:, :4 * n] @ memory.noise
    a[past] = law[:, :4 * n] @ measured
    a[past, past] += law[:, 4 * n:]
    noise[past], noise[rates] = entering, memory.noise[memory.rates]
    return LinearLoop(a, b, a[past][:n].copy(), noise, entering[:n], period)


@lru_cache(maxsize=256)
def _sampled_arm(robot, pose, timing, stuck):
    return held_input(*_arm_equations(robot, np.array(pose), stuck=stuck), timing)


def law_of(model, gains, timing, pose, *, stuck=False) -> np.ndarray:
    """Return `_controller_law` as it counts in `linear_loop`: no torque limit, see there."""
    mode = gains.compensation if stuck else 'none'
    chosen = replace(gains, torque_limit=np.full(model.n_joints, 1e300), compensation=mode)
    return _controller_law(chosen, model, pose, timing.period)


def compliance(robot, model, gains, timing, pose) -> np.ndarray:
    """
    Return the link angles (n, n) that a constant unknown torque on each link leaves [rad/(N m)].

    More than ``1 / (K_D1 Lambda_1)``: the law takes acceleration and jerk from the model, which
    believes such a torque to accelerate the links.
    """
    n, loop = robot.n_joints, linear_loop(robot, model, gains, timing, pose)
    arm, _ = _arm_equations(robot, pose)
    mass, _ = _mass_and_pull(effect_table.with_changes(robot).arm, pose)
    pushed = np.vstack([np.zeros((n, n)), np.linalg.inv(mass), np.zeros((2 * n, n))])
    entering = np.zeros((len(loop.a), n))
    entering[:4 * n] = _integral(arm, pushed, timing.period)[1]
    return np.linalg.solve(np.eye(len(loop.a)) - loop.closed, entering)[:n]


class _Memory(NamedTuple):
    angles: list        # rows of the measured values that are angles
    rates: list         # and that are rates
    noise: np.ndarray   # (4n, 2n) how noise on the angles enters all of them


def _encoders(robot, period):
    """Return measured values (4n, 8n) of arm, angles before and rates before, and _Memory."""
    n = robot.n_joints
    angles = [*range(n), *range(2 * n, 3 * n)]
    rates = [*range(n, 2 * n), *range(3 * n, 4 * n)]
    arm = np.eye(4 * n)
    rigid = np.flatnonzero(robot.arm.rigid)
    arm[2 * n + rigid], arm[3 * n + rigid] = arm[rigid], arm[n + rigid]
    seen, noise = np.hstack([arm, np.zeros((4 * n, 4 * n))]), np.zeros((4 * n, 2 * n))
    noise[angles] = np.eye(2 * n)
    cutoff = float(robot.encoder.velocity_cutoff)
    if cutoff > 0.0:
        gain = 1.0 - np.exp(-2.0 * np.pi * cutoff * period)
        seen[rates] = np.hstack([gain / period * arm[angles], -gain / period * np.eye(2 * n),
                                 (1.0 - gain) * np.eye(2 * n)])
        noise[rates] = gain / period * np.eye(2 * n)
    return seen, _Memory(angles, rates, noise)


def held_input(a, b, timing) -> tuple:
    """Return a system (a, b) over one sample of late input: phi (N, N), two gammas or more."""
    late, rest = divmod(timing.delay, timing.period)
    if timing.period - rest < 1e-9 * timing.period:
        late, rest = late + 1.0, 0.0
    phi_after, new = _integral(a, b, timing.period - rest)
    phi_before, old = _integral(a, b, rest)
    nothing = [np.zeros_like(b)] * int(late)
    return phi_after @ phi_before, [*nothing, new, phi_after @ old]


def _integral(a, b, time):
    n, m = b.shape
    whole = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * time)
    return whole[:n, :n], whole[:n, n:]
