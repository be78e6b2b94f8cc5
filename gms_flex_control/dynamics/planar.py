# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Rigid-body terms of a planar chain, and their time derivatives, in closed form.

With absolute link angles ``theta = T q`` the mass matrix of a planar chain is
``A_ij cos(theta_i - theta_j)`` and the Coriolis matrix of the Christoffel symbols is
``A_ij sin(theta_i - theta_j) dtheta_j``, for any number of links. ``T`` holds ones on and below
the diagonal; decoupled axes are the same formulas with ``T = I`` and a diagonal ``A``.
In joint coordinates ``M = T' M_theta T``, ``C = T' C_theta T`` and ``g = T' g_theta``. Where
joints read 0 at other angles than along the x axis, ``theta = T (q + offset)``.
"""

from functools import cache

from gms_flex_control import records
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.dynamics.vectors import (
    factorise,
    multiply,
    multiply_transposed,
    solve_factorised,
)
from gms_flex_control.params.arm import Body
from gms_flex_control.records import FLOAT
import numpy as np


@cache
def constants_layout(n) -> np.dtype:
    """
    Return the dtype of an arm of n joints as kernels take it.

    ``orientation`` T and ``inverse`` T^-1; ``length`` of the links [m]; ``offset`` of theta
    [rad]; ``coupling`` A [kg m^2];
    ``rigid_inertia``, motor inertia of rigid joints seen in theta [kg m^2]; ``moment``, mass
    moment about each joint [kg m]; ``gravity`` [m/s^2]; ``motor_inertia`` J [kg m^2];
    ``flexible``, 1 or 0; ``stiffness`` K [N m/rad] and ``damping`` [N m s/rad], 0 where rigid.
    """
    square, vector = (n, n), (n,)
    return records.layout(
        ('orientation', FLOAT, square), ('inverse', FLOAT, square), ('length', FLOAT, vector),
        ('offset', FLOAT, vector),
        ('coupling', FLOAT, square), ('rigid_inertia', FLOAT, square),
        ('moment', FLOAT, vector), ('gravity', FLOAT, (2,)),
        ('motor_inertia', FLOAT, vector), ('flexible', FLOAT, vector),
        ('stiffness', FLOAT, vector), ('damping', FLOAT, vector))


def constants_of(arm) -> np.record:
    """Return an ArmParams as the record the kernels take."""
    n = arm.n_joints
    planar = arm.kind == 'planar'
    orientation = np.tril(np.ones((n, n))) if planar else np.eye(n)
    inverse = np.linalg.inv(orientation)
    carried = np.array([arm.mass[i + 1:].sum() for i in range(n)]) if planar else np.zeros(n)
    moment = arm.mass * arm.com + carried * arm.length
    coupling = np.diag(arm.inertia + arm.mass * arm.com ** 2 + carried * arm.length ** 2)
    if planar:
        for i in range(n):
            for j in range(i + 1, n):
                coupling[i, j] = coupling[j, i] = arm.length[i] * moment[j]
    rigid_inertia = inverse.T @ np.diag(np.where(arm.rigid, arm.motor_inertia, 0.0)) @ inverse
    return records.build(
        constants_layout(n), orientation=orientation, inverse=inverse, length=arm.length,
        offset=orientation @ arm.offset, coupling=coupling,
        rigid_inertia=rigid_inertia, moment=moment, gravity=arm.gravity,
        motor_inertia=arm.motor_inertia, flexible=~arm.rigid,
        stiffness=np.where(arm.rigid, 0.0, arm.stiffness),
        damping=np.where(arm.rigid, 0.0, arm.damping))


def carrying(links, load: Body) -> np.record:
    """Return a copy of a record whose last link carries a body, given in that link's frame."""
    out, lever = links.copy(), links.length.copy()
    lever[-1] = load.com[0]
    out.moment += load.mass * lever
    out.coupling += load.mass * np.outer(lever, lever)
    out.coupling[-1, -1] += load.inertia[2, 2]
    return out


def work_fields(n) -> tuple:
    """Return the fields of the work space that these kernels alone need, in absolute angles."""
    return (*((name, FLOAT, (n,)) for name in ('omega', 'alpha', 'jerk')),
            ('velocity', FLOAT, (3, n)), ('change', FLOAT, (3, n)))


@compiled
def pose(q, links, work) -> None:
    """Write cosines and sines of the absolute angles at joint angles ``q`` (n,)."""
    multiply(links.orientation, q, work.omega)
    for i in range(q.shape[0]):
        theta = work.omega[i] + links.offset[i]
        work.cosine[i], work.sine[i] = np.cos(theta), np.sin(theta)


@compiled
def mass_matrix(links, work) -> None:
    """Write the upper triangle of M in absolute angles, after `pose`."""
    cosine, sine = work.cosine, work.sine
    for i in range(links.moment.shape[0]):
        for j in range(i + 1):
            cos_ij = cosine[i] * cosine[j] + sine[i] * sine[j]
            work.matrix[j, i] = links.coupling[i, j] * cos_ij + links.rigid_inertia[i, j]


@compiled
def accelerations(q, dq, links, work) -> None:
    """Write accelerations under ``work.tau`` into ``work.acceleration``; see dynamics.chain."""
    n = links.moment.shape[0]  # known when compiled, as every shape in a record
    omega, cosine, sine, right = work.omega, work.cosine, work.sine, work.right
    pose(q, links, work)
    multiply(links.orientation, dq, omega)
    multiply_transposed(links.inverse, work.tau, right)
    for i in range(n):
        right[i] -= links.moment[i] * (links.gravity[0] * sine[i] - links.gravity[1] * cosine[i])
        for j in range(i):
            moved = links.coupling[i, j] * (sine[i] * cosine[j] - cosine[i] * sine[j])
            right[i] -= moved * omega[j] * omega[j]
            right[j] += moved * omega[i] * omega[i]
    mass_matrix(links, work)
    for k in range(n):
        if work.implicit[k] != 0.0:
            for i in range(n):
                for j in range(i + 1):
                    work.matrix[j, i] += (links.inverse[k, i] * work.implicit[k]
                                          * links.inverse[k, j])
    factorise(work.matrix)
    solve_factorised(work.matrix, right)
    multiply(links.inverse, right, work.acceleration)


@compiled
def mass_times(vector, links, work, out) -> None:
    """Write M of the pose in ``work`` times ``vector`` (n,) into ``out``; see dynamics.chain."""
    n = links.moment.shape[0]
    multiply(links.orientation, vector, work.alpha)
    for i in range(n):
        total = 0.0
        for j in range(n):
            cosine = work.cosine[i] * work.cosine[j] + work.sine[i] * work.sine[j]
            total += (links.coupling[i, j] * cosine + links.rigid_inertia[i, j]) * work.alpha[j]
        work.right[i] = total
    multiply_transposed(links.orientation, work.right, out)


@compiled
def mass_solve(vector, links, work, out) -> None:
    """Write the inverse of M times ``vector`` into ``out``; see dynamics.chain."""
    multiply_transposed(links.inverse, vector, work.right)
    solve_factorised(work.matrix, work.right)
    multiply(links.inverse, work.right, out)


@compiled
def mass_between(carried, links, work, out) -> None:
    """Write the rows and columns ``carried`` (m,) of M into ``out``; see dynamics.chain."""
    m, n = carried.shape[0], links.moment.shape[0]
    for a in range(m):
        for b in range(m):
            out[a, b] = 0.0
            for i in range(n):
                for k in range(n):
                    part = links.orientation[i, carried[a]] * links.orientation[k, carried[b]]
                    if part != 0.0:
                        cos_ik = (work.cosine[i] * work.cosine[k] + work.sine[i] * work.sine[k])
                        out[a, b] += part * (links.coupling[i, k] * cos_ik
                                             + links.rigid_inertia[i, k])
        out[a, a] += work.implicit[carried[a]]


@compiled
def rigid_body(q, dq, ddq, links, work, bias, inertial) -> None:
    """Write ``C dq + g`` into ``bias`` and ``M ddq`` into ``inertial``; see dynamics.chain."""
    n = q.shape[0]
    pose(q, links, work)
    multiply(links.orientation, dq, work.omega)
    multiply(links.orientation, ddq, work.right)
    for i in range(n):
        held = links.moment[i] * (links.gravity[0] * work.sine[i]
                                  - links.gravity[1] * work.cosine[i])
        moved = 0.0
        for k in range(n):
            cosine = work.cosine[i] * work.cosine[k] + work.sine[i] * work.sine[k]
            sine = work.sine[i] * work.cosine[k] - work.cosine[i] * work.sine[k]
            held += links.coupling[i, k] * sine * work.omega[k] * work.omega[k]
            moved += (links.coupling[i, k] * cosine + links.rigid_inertia[i, k]) * work.right[k]
        work.tau[i], work.acceleration[i] = held, moved
    multiply_transposed(links.orientation, work.tau, bias)
    multiply_transposed(links.orientation, work.acceleration, inertial)


@compiled
def reference_torque(dq, ddq, d3q, velocity, acceleration, links, work, out) -> None:
    """
    Write ``M dr + C r + g`` and two derivatives into ``out`` (3, n); see dynamics.chain.

    In absolute angles it is ``y_i = sum_j A_ij (cos(phi_ij) dr_j + sin(phi_ij) omega_j r_j)``
    and gravity, with ``phi_ij = theta_i - theta_j``; both derivatives follow by the product rule.
    """
    n = links.moment.shape[0]
    multiply(links.orientation, dq, work.omega)
    multiply(links.orientation, ddq, work.alpha)
    multiply(links.orientation, d3q, work.jerk)
    for k in range(3):
        multiply(links.orientation, velocity[k], work.velocity[k])
        multiply(links.orientation, acceleration[k], work.change[k])
    for i in range(n):
        y, dy, ddy = _pull(i, links, work)
        for j in range(n):
            a, b = links.coupling[i, j], links.rigid_inertia[i, j]
            c = work.cosine[i] * work.cosine[j] + work.sine[i] * work.sine[j]
            s = work.sine[i] * work.cosine[j] - work.cosine[i] * work.sine[j]
            rate = work.omega[i] - work.omega[j]
            rate2 = work.alpha[i] - work.alpha[j]
            r, r1, r2 = work.velocity[0, j], work.velocity[1, j], work.velocity[2, j]
            u, u1, u2 = work.change[0, j], work.change[1, j], work.change[2, j]
            w, w1, w2 = work.omega[j], work.alpha[j], work.jerk[j]
            product, product1 = w * r, w1 * r + w * r1
            product2 = w2 * r + 2.0 * w1 * r1 + w * r2
            dc, ds = -s * rate, c * rate
            ddc, dds = -c * rate * rate - s * rate2, -s * rate * rate + c * rate2
            y += a * (c * u + s * product) + b * u
            dy += a * (dc * u + c * u1 + ds * product + s * product1) + b * u1
            ddy += a * (ddc * u + 2.0 * dc * u1 + c * u2
                        + dds * product + 2.0 * ds * product1 + s * product2) + b * u2
        work.right[i], work.tau[i], work.acceleration[i] = y, dy, ddy
    multiply_transposed(links.orientation, work.right, out[0])
    multiply_transposed(links.orientation, work.tau, out[1])
    multiply_transposed(links.orientation, work.acceleration, out[2])


@compiled_part
def _pull(i, links, work):
    """Return the torque of gravity on link ``i`` in absolute angles, with two derivatives."""
    gx, gy = links.gravity[0], links.gravity[1]
    weight = links.moment[i] * (gx * work.sine[i] - gy * work.cosine[i])
    slope = links.moment[i] * (gx * work.cosine[i] + gy * work.sine[i])
    return (weight, slope * work.omega[i], slope * work.alpha[i] - weight * work.omega[i] ** 2)
