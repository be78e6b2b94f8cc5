# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""First guesses of every effect: small sizes whose torques are looked for in the residual."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Scales(NamedTuple):
    """What a recording and its model set as usual sizes on one joint."""

    friction: float   # F_s [N m]
    torque: float     # largest command [N m]
    spring: float     # rms of the spring torque [N m]
    twist: float      # rms of the twist [rad]; 0 where rigid
    speed: float      # rms of the link's rate [rad/s]
    inertia: float    # J [kg m^2]
    link_inertia: float  # about the joint [kg m^2]
    lowest: float     # smallest link angle [rad]
    highest: float    # largest link angle [rad]
    turned: float     # span of the motor angle [rad]
    duration: float   # [s]
    period: float     # [s]


class Guess(NamedTuple):
    """
    One way an effect might be there: columns of a linear problem, and what its numbers mean.

    Parameters
    ----------
    probes : tuple of tuple of float
        Values of all parameters of the effect, one set per column.
    values : callable
        Coefficients -> values of all parameters.
    lowest, highest : float
        Of every coefficient.

    """

    probes: tuple
    values: Callable
    lowest: float = -np.inf
    highest: float = np.inf


def scales_of(paths, robot):
    """Return the Scales of each joint over all paths."""
    arm, found = robot.arm, []
    for j in range(robot.n_joints):
        link, rate, motor = (np.concatenate([path.motion[:, row, j] for path in paths])
                             for row in (0, 1, 3))
        torque = np.concatenate([path.command[:, j] for path in paths])
        twist = 0.0 if arm.rigid[j] else float(np.std(motor - link))
        spring = float(arm.stiffness[j] * twist) if twist > 0.0 else float(np.std(torque))
        found.append(Scales(
            float(robot.friction.forward.static[j]), float(np.abs(torque).max()), spring, twist,
            max(float(np.sqrt(np.mean(rate ** 2))), 1e-6), float(arm.motor_inertia[j]),
            float(arm.inertia[j] + arm.mass[j] * arm.com[j] ** 2), float(link.min()),
            float(link.max()), float(np.ptp(motor)),
            float(max(path.time[-1] - path.time[0] for path in paths)), paths[0].fine_period))
    return found


def linear(size, *fixed, positive=False):
    """Return the guess of an effect proportional to its first parameter."""
    return [Guess(((size, *fixed),), lambda c: (c[0] * size, *fixed),
                  0.0 if positive else -np.inf)]


def waves(size, orders):
    """Return guesses of ``size sin(order q + phase)`` for each order; None has no such number."""
    guesses = []
    for order in orders:
        fixed = () if order is None else (order,)
        guesses.append(Guess(
            ((size, *fixed, 0.0), (size, *fixed, 0.5 * np.pi)),
            lambda c, fixed=fixed: (size * np.hypot(c[0], c[1]), *fixed,
                                    float(np.arctan2(c[1], c[0])))))
    return guesses


def sizes(values, *fixed):
    """Return guesses of an effect that is not linear in its first parameter."""
    return [Guess(((value, *fixed),), lambda c, value=value: (value, *fixed), 0.0, 3.0)
            for value in values]


def shapes(size, values):
    """Return guesses linear in the first parameter for each value of the second."""
    return [Guess(((size, value),), lambda c, value=value: (c[0] * size, value), 0.0)
            for value in values]


def _orders(span, highest):
    step = np.clip(np.pi / max(span, 1e-6), 0.25, 1.0)
    return np.arange(1.0, highest + 0.5 * step, step)


GUESSES = {
    'actuator_deadzone': lambda s: sizes(s.friction * np.geomspace(0.02, 1.0, 10)),
    'actuator_lag': lambda s: sizes((0.001, 0.003, 0.006, 0.012, 0.02)),
    'actuator_saturation': lambda s: sizes(s.torque * np.linspace(0.2, 0.95, 16)),
    'backlash': lambda s: sizes(s.twist * np.geomspace(0.01, 0.6, 12)),
    'constant_link_torque': lambda s: linear(0.1 * s.friction),
    'friction_asymmetry': lambda s: linear(0.1),
    'friction_drift': lambda s: linear(0.1, s.duration),
    'kinematic_error': lambda s: waves(0.02 * s.twist, [None]),
    'link_encoder_eccentricity': lambda s: waves(0.02 * s.twist, [None]),
    'load_friction': lambda s: linear(0.1, s.spring, positive=True),
    'motor_coulomb': lambda s: linear(0.1 * s.friction, positive=True),
    'motor_inertia_error': lambda s: linear(0.1),
    'motor_torque_bias': lambda s: linear(0.1 * s.friction),
    'motor_viscous': lambda s: linear(0.1 * s.friction / s.speed, positive=True),
    'position_friction': lambda s: [Guess(
        ((0.1, order, 0.0), (0.1, order, -0.5 * np.pi)),
        lambda c, order=order: (0.1 * np.hypot(c[0], c[1]), order,
                                float(np.arctan2(-c[1], c[0]))))
        for order in _orders(s.highest - s.lowest, 6.0)],
    'quadratic_drag': lambda s: linear(0.1 * s.friction / s.speed ** 2, positive=True),
    'spring_cubic': lambda s: linear(0.1 * s.spring / s.twist ** 3),
    'spring_damping': lambda s: linear(0.003, positive=True),
    'spring_hysteresis': lambda s: shapes(0.1 * s.friction, s.twist * np.geomspace(0.02, 2.0, 8)),
    'spring_offset': lambda s: linear(0.05 * s.twist),
    'stiffness_drift': lambda s: linear(0.1, s.duration),
    'stiffness_error': lambda s: linear(0.1),
    'torque_gain': lambda s: linear(0.1),
    'torque_ripple': lambda s: waves(0.05 * s.friction, _orders(s.turned, 48.0)),
    'end_stop': lambda s: [Guess(((angle, s.friction / 0.05),),
                                 lambda c, angle=angle: (angle, c[0] * s.friction / 0.05), 0.0)
                           for angle in _stops(s)],
}
GUESSES |= {
    'input_delay': lambda s: sizes((0.001, 0.003, 0.006, 0.012, 0.02)),
    'coulomb_error': lambda s: linear(0.1),
    'viscous_error': lambda s: linear(0.1 * s.friction / s.speed),
    'stribeck_error': lambda s: linear(0.1),
    'presliding_error': lambda s: [Guess(((-0.3, 0.0),), lambda c: (max(-0.3 * c[0], -0.9), 0.0))],
    'link_inertia_error': lambda s: linear(0.1),
    'motor_inertia_coupling': lambda s: linear(0.3 * s.inertia),
    'base_flexibility': lambda s: [
        Guess(((frequency, 5.0 * s.link_inertia, 0.05),),
              lambda c, frequency=frequency: (
                  frequency, 5.0 * s.link_inertia / np.clip(c[0], 0.02, 20.0), 0.05), 0.0)
        for frequency in np.geomspace(3.0, 15.0, 9)],
    'encoder_skew': lambda s: linear(0.0005),
}
WHOLE = {
    'gravity_tilt': lambda s: [Guess(
        ((0.002, 0.0), (0.002, 0.5 * np.pi)),
        lambda c: (0.002 * np.hypot(c[0], c[1]), float(np.arctan2(c[1], c[0]))))],
    'tip_payload': lambda s: linear(0.05, positive=True),
}


def _stops(s):
    span = s.highest - s.lowest
    inner = np.concatenate([s.highest - span * np.array([0.02, 0.05, 0.1, 0.18]),
                            s.lowest + span * np.array([0.02, 0.05, 0.1, 0.18])])
    sides = np.array([1.0] * 4 + [-1.0] * 4)
    return inner[inner * sides > 0.0]
