# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Inverse dynamics along a reference velocity, with first and second time derivative.

In absolute angles ``theta`` (dynamics/chain.py) the torque that moves the chain along a
reference velocity ``r`` while it really moves with ``omega`` is
``y_i = sum_j A_ij (cos(phi_ij) dr_j + sin(phi_ij) omega_j r_j)``, with
``phi_ij = theta_i - theta_j``; both derivatives follow by the product rule, without a difference
quotient.
"""

from functools import cache

from gms_flex_control import records
from gms_flex_control.compiled import compiled
from gms_flex_control.records import FLOAT


@cache
def layout(n):
    """
    Return the dtype of the work space of `inverse_dynamics`, all in absolute angles.

    ``cosine``, ``sine`` of theta; ``omega``, ``alpha``, ``jerk``, its rates; ``ref`` (4, n),
    reference velocity and its derivatives 1 to 3; ``torque`` (3, n), the result with its two
    derivatives.
    """
    return records.layout(
        *((name, FLOAT, (n,)) for name in ('cosine', 'sine', 'omega', 'alpha', 'jerk')),
        ('ref', FLOAT, (4, n)), ('torque', FLOAT, (3, n)))


@compiled
def pull(i, chain, motion, out):
    """Start the torques of row ``i`` with gravity and with what does not depend on angles."""
    gx, gy = chain.gravity[0], chain.gravity[1]
    weight = chain.moment[i] * (gx * motion.sine[i] - gy * motion.cosine[i])
    slope = chain.moment[i] * (gx * motion.cosine[i] + gy * motion.sine[i])
    out[0, i] = weight
    out[1, i] = slope * motion.omega[i]
    out[2, i] = slope * motion.alpha[i] - weight * motion.omega[i] ** 2


@compiled
def inverse_dynamics(chain, motion):
    """Write ``M dr + C r + g`` and its first and second derivative into ``motion.torque``."""
    n = chain.moment.shape[0]
    out, ref = motion.torque, motion.ref
    for i in range(n):
        pull(i, chain, motion, out)
        y, dy, ddy = out[0, i], out[1, i], out[2, i]
        for j in range(n):
            a, b = chain.coupling[i, j], chain.rigid_inertia[i, j]
            c = motion.cosine[i] * motion.cosine[j] + motion.sine[i] * motion.sine[j]
            s = motion.sine[i] * motion.cosine[j] - motion.cosine[i] * motion.sine[j]
            rate = motion.omega[i] - motion.omega[j]
            rate2 = motion.alpha[i] - motion.alpha[j]
            r, r1, r2, r3 = ref[0, j], ref[1, j], ref[2, j], ref[3, j]
            w, w1, w2 = motion.omega[j], motion.alpha[j], motion.jerk[j]
            product, product1 = w * r, w1 * r + w * r1
            product2 = w2 * r + 2.0 * w1 * r1 + w * r2
            dc, ds = -s * rate, c * rate
            ddc, dds = -c * rate * rate - s * rate2, -s * rate * rate + c * rate2
            y += a * (c * r1 + s * product) + b * r1
            dy += a * (dc * r1 + c * r2 + ds * product + s * product1) + b * r2
            ddy += a * (ddc * r1 + 2.0 * dc * r2 + c * r3
                        + dds * product + 2.0 * ds * product1 + s * product2) + b * r3
        out[0, i], out[1, i], out[2, i] = y, dy, ddy
