# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The controller of most robots: each joint alone, PID on the angle of its motor."""

from functools import cache

from bench.hidden_robots.kernels import compiled
from gms_flex_control import records
from gms_flex_control.records import FLOAT
import numpy as np

INTEGRAL, CUTOFF = 0.1, 60.0  # integral over proportional gain [1/s]; of the derivative [Hz]


@cache
def layout(n):
    """
    Return the dtype of state and gains.

    ``command`` (n,), its answer [N m]; ``friction_hat`` (n,), which it does not estimate: NaN;
    ``before``, ``rate``, ``integral`` (n,), of the error; ``proportional``, ``derivative``,
    ``torque_limit`` (n,), gains.
    """
    return records.layout(*((name, FLOAT, (n,)) for name in (
        'command', 'friction_hat', 'before', 'rate', 'integral', 'proportional', 'derivative',
        'torque_limit')))


def init(gains):
    """Return the controller with the motor law of ControllerParams for its gains, at rest."""
    return records.build(
        layout(len(gains.kd_motor)), friction_hat=np.nan, derivative=gains.kd_motor,
        proportional=gains.kd_motor * gains.lambda_motor, torque_limit=gains.torque_limit)


@compiled
def tick(x, measured, reference, dt):
    """
    Compute the torque that answers one measurement, ``dt`` after the one before, or 0.

    The first row of ``reference`` (k, n) is the angle of the motors.
    """
    keep = np.exp(-2.0 * np.pi * CUTOFF * dt)
    for j in range(x.command.shape[0]):
        error = reference[0, j] - measured.q_motor[j]
        if dt > 0.0:
            x.rate[j] = keep * x.rate[j] + (1.0 - keep) * (error - x.before[j]) / dt
        x.before[j] = error
        asked = x.proportional[j] * (error + x.integral[j]) + x.derivative[j] * x.rate[j]
        x.command[j] = min(max(asked, -x.torque_limit[j]), x.torque_limit[j])
        if x.command[j] == asked:
            x.integral[j] += INTEGRAL * error * dt
