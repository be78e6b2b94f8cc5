# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Generalized Maxwell-Slip friction, Eqs. (2) to (5), written anew for the hidden robots.

A step is a path at constant acceleration: where the motion turns within it, the blocks first go
on to the turning point and then back from there.
"""

from bench.hidden_robots.kernels import compiled
import numpy as np


@compiled
def level(j, direction, speed, f):
    """Return s(v) of joint ``j`` moving in ``direction``, Eq. (4)."""
    side = 0 if direction > 0.0 else 1
    x = speed / f.velocity[side, j]
    return f.coulomb[side, j] + (f.static[side, j] - f.coulomb[side, j]) * np.exp(-x * x)


@compiled
def slide(j, displacement, speed, dt, torque, sticking, direction, f):
    """Move the blocks of joint ``j`` one way by ``displacement`` in ``dt`` at ``speed``."""
    if displacement == 0.0:
        return
    way = 1.0 if displacement > 0.0 else -1.0
    if way != direction[j]:
        direction[j] = way
        sticking[j] = 1
    s = level(j, way, speed, f)
    forget = np.exp(-f.attraction[j] * dt / s)
    for i in range(torque.shape[1]):
        share = f.weight[j, i] * s
        if sticking[j, i]:
            # Eq. (2), the motion's direction counted positive
            carried = way * torque[j, i] + f.stiffness[j, i] * way * displacement
            if carried >= share:
                sticking[j, i] = 0
                carried = share
            torque[j, i] = way * carried
        else:
            torque[j, i] = way * share * (1.0 - forget) + torque[j, i] * forget  # Eq. (3)


@compiled
def move(j, v, a, dt, torque, sticking, direction, f):
    """Move the blocks of joint ``j`` for ``dt`` from velocity ``v`` at acceleration ``a``."""
    end = v + a * dt
    if v * end < 0.0:
        turn = -v / a
        slide(j, 0.5 * v * turn, 0.5 * abs(v), turn, torque, sticking, direction, f)
        slide(j, 0.5 * end * (dt - turn), 0.5 * abs(end), dt - turn, torque, sticking, direction,
              f)
    else:
        slide(j, 0.5 * (v + end) * dt, 0.5 * abs(v + end), dt, torque, sticking, direction, f)


@compiled
def friction_torque(j, v, torque, direction, f):
    """Return the friction torque of joint ``j``, viscous part included, Eq. (5)."""
    total = f.viscous[0 if direction[j] > 0.0 else 1, j] * v
    for i in range(torque.shape[1]):
        total += torque[j, i]
    return total
