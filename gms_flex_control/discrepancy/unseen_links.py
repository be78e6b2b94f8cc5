# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Flexible joints whose links have no encoder: where the link is, as motor and torque tell.

The motor equation gives the spring's torque, the spring's torque the twist:
``q_link = q_motor - (u - J ddq_motor) / K``, corrected for each model by what its motor equation
leaves. What remains is one equation per joint, that of link and motor together.
"""

from typing import NamedTuple

from gms_flex_control.dynamics.chain import own_inertia
from gms_flex_control.identification.smoothing import low_pass, low_pass_window, noise_of
from gms_flex_control.simulation import plant
import numpy as np

_NOISE = 0.05            # of the usual torque: what noise of the link's inertia may amount to
_BAND = (1.0, 20.0)      # of the low-pass that sees to it [Hz]


class UnseenLink(NamedTuple):
    """A link without encoder."""

    joint: int
    stiffness: float  # as believed [N m/rad]
    inertia: float    # of the motor, as believed [kg m^2]
    window: int       # of the low-pass its angle is seen through, samples


def unseen_links(recording, robot):
    """Return the flexible joints of which only the motor was recorded, tuple of UnseenLink."""
    arm, found, inertias = robot.arm, [], own_inertia(plant.constants_of(robot).chain)[0]
    for j in range(robot.n_joints):
        if (arm.rigid[j] or np.isfinite(recording.q_link[:, j]).any()
                or not np.isfinite(recording.q_motor[:, j]).any()):
            continue
        stiffness, inertia = float(arm.stiffness[j]), float(arm.motor_inertia[j])
        noise = noise_of(recording.q_motor[:, j])
        carried = inertias[j] * inertia / stiffness
        found.append(UnseenLink(j, stiffness, inertia, _window(
            recording.period, noise, carried, _usual(recording, j))))
    return tuple(found)


def _usual(recording, j):
    """Return the usual torque of a joint [N m]; its command, if that was recorded."""
    known = next((torque[np.isfinite(torque)] for torque in (
        recording.command[:, j], recording.tau_motor[:, j]) if np.isfinite(torque).any()), None)
    return 1.0 if known is None else max(float(np.std(known)), 1e-12)


def _window(period, noise, carried, torque):
    """
    Return the window of `low_pass` that keeps the noise of the link's inertia small.

    White noise of the motor angle has a density of ``2 noise^2 period``; ``carried`` [kg m^2 s^2]
    times its fourth derivative is what reaches the equation.
    """
    density = 2.0 * noise ** 2 * period * (carried * (2.0 * np.pi) ** 4) ** 2
    band = (9.0 * (_NOISE * torque) ** 2 / density) ** (1.0 / 9.0)
    return low_pass_window(np.clip(band, *_BAND), period)


def link_angle(motor, torque, bend, link):
    """
    Return where an UnseenLink is, as believed, behind its low-pass.

    Parameters
    ----------
    motor : ndarray, shape (T,)
        Motor angle as read [rad].
    torque : ndarray, shape (T,)
        Of the motor, as second differences see it (motion.held_triangle) [N m].
    bend : ndarray, shape (T,)
        Second difference of the motor angle [rad/s^2].
    link : UnseenLink
        Which.

    Returns
    -------
    ndarray, shape (T,)

    """
    return low_pass(motor - (torque - link.inertia * bend) / link.stiffness, link.window)
