# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The closed loop in plain numpy, straight from the equations: slow, short, and independent.

It shows what compilation is worth, and its agreement with the kernels is tested. Ideal
encoders, no effects, compensation ``none`` or ``gms_paper``, all joints flexible.
"""

from typing import NamedTuple

from bench.chain_matrices import matrices
from gms_flex_control.friction import stribeck_level
import numpy as np


class GmsBlocks:
    """Blocks of all joints, Eqs. (2) to (5)."""

    def __init__(self, params):
        self._p = params
        self._torque = np.zeros_like(params.weight)
        self._sticking = np.ones_like(params.weight, dtype=bool)
        self._sign = np.ones(len(params.weight))

    def advance(self, displacement, velocity, dt, pushed=0.0, smooth=None):
        """
        Move by ``displacement`` (n,).

        Of an observer: ``pushed`` (n, N), k_e s_1 / C; ``smooth`` (n,), r(v) of Eq. (20).
        """
        p = self._p
        turned = displacement * self._sign < 0
        self._sign = np.where(turned, -self._sign, self._sign)
        self._sticking |= turned[:, None]
        level = stribeck_level(np.copysign(velocity, self._sign), p)[:, None]
        sign = self._sign[:, None]
        limit = level * (sign * p.weight - pushed)  # Eq. (19)
        goal = limit if smooth is None else level * (smooth[:, None] * p.weight - pushed)
        stuck = self._torque + p.stiffness * displacement[:, None]  # Eq. (2)
        slid = goal + (self._torque - goal) * np.exp(-p.attraction[:, None] * dt / level)  # (3)
        breaks = sign * stuck >= sign * limit
        self._torque = np.where(self._sticking, np.where(breaks, limit, stuck), slid)
        self._sticking &= ~breaks

    def total(self, velocity):
        """Return the friction torque (n,), viscous part included, Eq. (5)."""
        return self._torque.sum(axis=1) + self.of_direction('viscous') * velocity

    def of_direction(self, name):
        """Return a constant of the Stribeck curve for the direction of each joint (n,)."""
        forward, backward = getattr(self._p.forward, name), getattr(self._p.backward, name)
        return np.where(self._sign > 0, forward, backward)

    def rates(self, dq, a, jerk, observer):
        """Return the first two time derivatives (2, n) of an observer's estimate."""
        p, v = self._p, dq[:, None]
        level = stribeck_level(np.copysign(dq, self._sign), p)
        slope = -2 * dq / self.of_direction('velocity') ** 2 * (
            level - self.of_direction('coulomb'))
        level, slope, c = level[:, None], slope[:, None], p.attraction[:, None]
        slip1 = c * (p.weight * observer.smooth[:, None] - self._torque / level
                     - observer.pushed)  # Eq. (20)
        slip2 = c * (p.weight * (observer.slope * a)[:, None] - slip1 / level
                     + self._torque * slope * a[:, None] / level ** 2) - observer.pushed_rate
        first = np.where(self._sticking, p.stiffness * v, slip1)
        second = np.where(self._sticking, p.stiffness * a[:, None], slip2)
        viscous = self.of_direction('viscous')
        return first.sum(axis=1) + viscous * a, second.sum(axis=1) + viscous * jerk


class NumpyPlant:
    """The robot of Eq. (1) by semi-implicit Euler steps."""

    def __init__(self, robot):
        self._arm = robot.arm
        self._blocks = GmsBlocks(robot.friction)
        self.q, self.dq, self.q_motor, self.dq_motor = np.zeros((4, robot.n_joints))

    def advance(self, command, dt, substeps):
        """Hold ``command`` (n,) for ``substeps`` of ``dt``."""
        arm, zero = self._arm, np.zeros_like(self.q)
        for _ in range(substeps):
            m = matrices(self.q, self.dq, zero, zero, arm)
            spring = (arm.stiffness * (self.q_motor - self.q)
                      + arm.damping * (self.dq_motor - self.dq))
            torque = (spring - self._blocks.total(self.dq) - m.coriolis @ self.dq - m.gravity)
            self.dq = self.dq + dt * np.linalg.solve(m.mass, torque)
            self.dq_motor = self.dq_motor + dt * (command - spring) / arm.motor_inertia
            self.q = self.q + dt * self.dq
            self.q_motor = self.q_motor + dt * self.dq_motor
            self._blocks.advance(dt * self.dq, self.dq, dt)


class Observer(NamedTuple):
    """What Eq. (20) adds to the friction model: r(v), dr/dv, and the correction with its rate."""

    smooth: np.ndarray       # (n,)
    slope: np.ndarray        # (n,) [s/rad]
    pushed: np.ndarray       # (n, N), k_e s_1 / C, limited
    pushed_rate: np.ndarray  # (n, N), d(k_e s_1)/dt where not limited [N m/s^2]


class NumpyController:
    """The cascade law with compensation ``none`` or ``gms_paper``."""

    def __init__(self, gains, model):
        self._gains, self._model = gains, model
        self._blocks = GmsBlocks(model.friction)
        self._q_before = None
        self._free = np.ones(model.n_joints, dtype=bool)

    def tick(self, q, dq, q_motor, dq_motor, reference, dt):
        """Return the motor torque (n,) that answers a measurement."""
        gains, arm = self._gains, self._model.arm
        spring = arm.stiffness * (q_motor - q) + arm.damping * (dq_motor - dq)
        spring_rate = arm.stiffness * (dq_motor - dq)
        if gains.compensation == 'none':
            friction = np.zeros((3, len(q)))
            a, jerk = self._motion(q, dq, spring, spring_rate, friction)
        else:
            friction, a, jerk = self._observe(q, dq, spring, spring_rate, reference, dt)
        torque = self._elastic(q, dq, a, jerk, reference, friction)
        q_des, dq_des, ddq_des = [q, dq, a] + torque / arm.stiffness  # Eq. (9)
        rate = dq_motor - dq_des
        s2 = rate + gains.lambda_motor * (q_motor - q_des)  # Eq. (28)
        u0 = ddq_des - gains.lambda_motor * rate  # Eq. (29)
        command = arm.motor_inertia * u0 + spring - gains.kd_motor * s2  # Eq. (27)
        self._free = np.abs(command) <= gains.torque_limit
        return np.clip(command, -gains.torque_limit, gains.torque_limit)

    def _observe(self, q, dq, spring, spring_rate, reference, dt):
        """Return F_hat and two derivatives (3, n), and the link's acceleration and jerk."""
        gains, friction = self._gains, self._model.friction
        moved = q - (q if self._q_before is None else self._q_before)
        self._q_before = q
        c, gain = friction.attraction[:, None], np.where(self._free, gains.observer_gain, 0.0)
        rate_err, limit = dq - reference[1], 0.5 * friction.weight * c
        correction = (gain * (rate_err + gains.lambda_link * (q - reference[0])))[:, None]
        pushed = np.clip(correction, -limit, limit) / c
        smooth = np.tanh(gains.sign_slope * dq)
        self._blocks.advance(moved, dq, dt, pushed, smooth)
        estimate = self._blocks.total(dq)
        a = self._motion(q, dq, spring, spring_rate, [estimate, 0.0])[0]
        push_rate = gains.observer_gain * (a - reference[2] + gains.lambda_link * rate_err)
        observer = Observer(
            smooth=smooth, slope=gains.sign_slope * (1 - smooth ** 2), pushed=pushed,
            pushed_rate=np.where(np.abs(correction) < limit, push_rate[:, None], 0.0))
        first = self._blocks.rates(dq, a, np.zeros_like(a), observer)[0]
        jerk = self._motion(q, dq, spring, spring_rate, [estimate, first])[1]
        return np.array([estimate, *self._blocks.rates(dq, a, jerk, observer)]), a, jerk

    def _motion(self, q, dq, spring, spring_rate, friction):
        """Return acceleration and jerk of the link by the model."""
        arm, zero = self._model.arm, np.zeros_like(q)
        m = matrices(q, dq, zero, zero, arm)
        a = np.linalg.solve(m.mass, spring - friction[0] - m.coriolis @ dq - m.gravity)
        m = matrices(q, dq, a, zero, arm)
        return a, np.linalg.solve(m.mass, spring_rate - friction[1] - m.dmass @ a
                                  - m.dcoriolis @ dq - m.coriolis @ a - m.dgravity)

    def _elastic(self, q, dq, a, jerk, reference, friction):
        """Return u_ed and two derivatives (3, n), Eq. (11)."""
        gains = self._gains
        state = np.array([q, dq, a, jerk])
        r = reference[1:] - gains.lambda_link * (state - reference[:4])  # dq_ref and derivatives
        m = matrices(q, dq, a, jerk, self._model.arm)
        feedback = gains.kd_link * (state[1:] - r[:3])
        return friction - feedback + [
            m.mass @ r[1] + m.coriolis @ r[0] + m.gravity,
            m.dmass @ r[1] + m.mass @ r[2] + m.dcoriolis @ r[0] + m.coriolis @ r[1] + m.dgravity,
            m.ddmass @ r[1] + 2 * m.dmass @ r[2] + m.mass @ r[3] + m.ddcoriolis @ r[0]
            + 2 * m.dcoriolis @ r[1] + m.coriolis @ r[2] + m.ddgravity]


def run(robot, model, gains, reference, period, substeps):
    """
    Run the closed loop from rest at zero along ``reference`` (T, 5, n_joints).

    Return link angles [rad] at each sample and the torques that answer them [N m], (T, n_joints)
    each.
    """
    plant, controller = NumpyPlant(robot), NumpyController(gains, model)
    angles, commands = np.empty((2, len(reference), robot.n_joints))
    for k, desired in enumerate(reference):
        angles[k] = plant.q
        commands[k] = controller.tick(plant.q, plant.dq, plant.q_motor, plant.dq_motor, desired,
                                      period if k else 0.0)
        plant.advance(commands[k], period / substeps, substeps)
    return angles, commands
