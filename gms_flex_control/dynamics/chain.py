# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Rigid-body terms of a planar chain, and their time derivatives, in closed form.

With absolute link angles ``theta = T q`` the mass matrix of a planar chain is
``A_ij cos(theta_i - theta_j)`` and the Coriolis matrix of the Christoffel symbols is
``A_ij sin(theta_i - theta_j) dtheta_j``, for any number of links. ``T`` holds ones on and below
the diagonal; decoupled axes are the same formulas with ``T = I`` and a diagonal ``A``.
In joint coordinates ``M = T' M_theta T``, ``C = T' C_theta T`` and ``g = T' g_theta``. Where
joints read 0 at other angles than along the x axis, ``theta = T (q + offset)``.
"""

from functools import cache, lru_cache
from typing import NamedTuple

from gms_flex_control import records
from gms_flex_control.compiled import compiled
from gms_flex_control.records import FLOAT
import numpy as np


@cache
def constants_layout(n):
    """
    Return the dtype of an arm of n joints as kernels take it.

    ``orientation`` T and ``inverse`` T^-1; ``offset`` of theta [rad]; ``coupling`` A [kg m^2];
    ``rigid_inertia``, motor inertia of rigid joints seen in theta [kg m^2]; ``moment``, mass
    moment about each joint [kg m]; ``gravity`` [m/s^2]; ``motor_inertia`` J [kg m^2];
    ``flexible``, 1 or 0; ``stiffness`` K [N m/rad] and ``damping`` [N m s/rad], 0 where rigid.
    """
    square, vector = (n, n), (n,)
    return records.layout(
        ('orientation', FLOAT, square), ('inverse', FLOAT, square), ('offset', FLOAT, vector),
        ('coupling', FLOAT, square), ('rigid_inertia', FLOAT, square),
        ('moment', FLOAT, vector), ('gravity', FLOAT, (2,)),
        ('motor_inertia', FLOAT, vector), ('flexible', FLOAT, vector),
        ('stiffness', FLOAT, vector), ('damping', FLOAT, vector))


class ChainMatrices(NamedTuple):
    """
    M, C, g and their first and second time derivatives in joint coordinates.

    Parameters
    ----------
    mass, dmass, ddmass : ndarray, shape (n_joints, n_joints)
        M(q1) [kg m^2] and its time derivatives.
    coriolis, dcoriolis, ddcoriolis : ndarray, shape (n_joints, n_joints)
        C(q1, dq1) of the Christoffel symbols, so that dM/dt - 2 C is skew.
    gravity, dgravity, ddgravity : ndarray, shape (n_joints,)
        g(q1) [N m] and its time derivatives.

    """

    mass: np.ndarray
    dmass: np.ndarray
    ddmass: np.ndarray
    coriolis: np.ndarray
    dcoriolis: np.ndarray
    ddcoriolis: np.ndarray
    gravity: np.ndarray
    dgravity: np.ndarray
    ddgravity: np.ndarray


@lru_cache(maxsize=256)
def constants_of(arm):
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
        constants_layout(n), orientation=orientation, inverse=inverse,
        offset=orientation @ arm.offset, coupling=coupling,
        rigid_inertia=rigid_inertia, moment=moment, gravity=arm.gravity,
        motor_inertia=arm.motor_inertia, flexible=~arm.rigid,
        stiffness=np.where(arm.rigid, 0.0, arm.stiffness),
        damping=np.where(arm.rigid, 0.0, arm.damping))


@compiled
def multiply(matrix, vector, out):
    """Write ``matrix`` (n, n) times ``vector`` (n,) into ``out`` (n,)."""
    n = matrix.shape[0]
    for i in range(n):
        total = 0.0  # a local sum: the compiler cannot keep out[i] in a register
        for j in range(n):
            total += matrix[i, j] * vector[j]
        out[i] = total


@compiled
def multiply_transposed(matrix, vector, out):
    """Write the transpose of ``matrix`` (n, n) times ``vector`` (n,) into ``out`` (n,)."""
    n = matrix.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += matrix[j, i] * vector[j]
        out[i] = total


@compiled
def solve_in_place(matrix, vector):
    """Solve a symmetric positive definite system given by its upper triangle, in place."""
    n = matrix.shape[0]
    for i in range(n):
        reciprocal = 1.0 / matrix[i, i]
        for k in range(i + 1, n):
            factor = matrix[i, k] * reciprocal
            for j in range(k, n):
                matrix[k, j] -= factor * matrix[i, j]
            vector[k] -= factor * vector[i]
        matrix[i, i] = reciprocal
    for i in range(n - 1, -1, -1):
        total = vector[i]
        for j in range(i + 1, n):
            total -= matrix[i, j] * vector[j]
        vector[i] = total * matrix[i, i]


@cache
def work_layout(n):
    """Return the dtype of the work space of `accelerations`."""
    return records.layout(
        *((name, FLOAT, (n,)) for name in ('tau', 'acceleration', 'omega', 'cosine', 'sine',
                                           'right')),
        ('matrix', FLOAT, (n, n)))


@compiled
def mass_matrix(chain, work):
    """Write the upper triangle of M in absolute angles, from the work's cosines and sines."""
    cosine, sine = work.cosine, work.sine
    for i in range(chain.moment.shape[0]):
        for j in range(i + 1):
            cos_ij = cosine[i] * cosine[j] + sine[i] * sine[j]
            work.matrix[j, i] = chain.coupling[i, j] * cos_ij + chain.rigid_inertia[i, j]


@compiled
def accelerations(q, dq, chain, work):
    """
    Write the joint accelerations under the torques ``work.tau`` into ``work.acceleration``.

    ``M ddq + C dq + g = tau`` at angles and rates ``q``, ``dq`` (n,), solved in absolute angles.
    """
    n = chain.moment.shape[0]  # known when compiled, as every shape in a record
    omega, cosine, sine, right = work.omega, work.cosine, work.sine, work.right
    multiply(chain.orientation, q, omega)
    for i in range(n):
        theta = omega[i] + chain.offset[i]
        cosine[i], sine[i] = np.cos(theta), np.sin(theta)
    multiply(chain.orientation, dq, omega)
    multiply_transposed(chain.inverse, work.tau, right)
    for i in range(n):
        right[i] -= chain.moment[i] * (chain.gravity[0] * sine[i] - chain.gravity[1] * cosine[i])
        for j in range(i):
            moved = chain.coupling[i, j] * (sine[i] * cosine[j] - cosine[i] * sine[j])
            right[i] -= moved * omega[j] * omega[j]
            right[j] += moved * omega[i] * omega[i]
    mass_matrix(chain, work)
    solve_in_place(work.matrix, right)
    multiply(chain.inverse, right, work.acceleration)


def matrices(q, dq, ddq, d3q, arm):
    """
    Return M, C, g and their time derivatives along a motion.

    Parameters
    ----------
    q, dq, ddq, d3q : ndarray, shape (n_joints,)
        Link angle and its first three time derivatives.
    arm : ArmParams
        The arm; motor inertia of rigid joints is part of M.

    Returns
    -------
    ChainMatrices
        In joint coordinates.

    Notes
    -----
    Left side of the link equation (1); derivatives by the product rule on the closed form.

    """
    chain = constants_of(arm)
    transform = chain.orientation
    theta, omega, alpha, jerk = (transform @ np.asarray(x, dtype=float)
                                 for x in (q, dq, ddq, d3q))
    theta = theta + chain.offset
    phi, dphi, ddphi = (x[:, None] - x[None, :] for x in (theta, omega, alpha))
    a, cos, sin = chain.coupling, np.cos(phi), np.sin(phi)
    rate = dphi * cos  # d/dt sin(phi)
    squares = (
        a * cos + chain.rigid_inertia, -a * sin * dphi, -a * (rate * dphi + sin * ddphi),
        a * sin * omega, a * (rate * omega + sin * alpha),
        a * ((cos * ddphi - sin * dphi ** 2) * omega + 2 * rate * alpha + sin * jerk))
    gx, gy = chain.gravity
    pull = chain.moment * (gx * np.sin(theta) - gy * np.cos(theta))
    slope = chain.moment * (gx * np.cos(theta) + gy * np.sin(theta))
    vectors = (pull, slope * omega, slope * alpha - pull * omega ** 2)
    return ChainMatrices(*(transform.T @ square @ transform for square in squares),
                         *(transform.T @ vector for vector in vectors))


def inverse_dynamics(q, dq, ddq, arm):
    """
    Return the torque on the links that a motion takes without friction.

    Parameters
    ----------
    q, dq, ddq : ndarray, shape (..., n_joints)
        Link angles and their derivatives.
    arm : ArmParams
        The arm; motor inertia of rigid joints is part of M.

    Returns
    -------
    ndarray, shape (..., n_joints)
        ``M ddq + C dq + g`` [N m].

    Notes
    -----
    Left side of the link equation (1), in absolute angles.

    """
    chain = constants_of(arm)
    turn = chain.orientation.T
    theta, omega, alpha = (np.asarray(x, dtype=float) @ turn for x in (q, dq, ddq))
    theta = theta + chain.offset
    between = theta[..., :, None] - theta[..., None, :]
    inertia = chain.coupling * np.cos(between) + chain.rigid_inertia
    gx, gy = chain.gravity
    torque = (np.einsum('...ij,...j->...i', inertia, alpha)
              + np.einsum('...ij,...j->...i', chain.coupling * np.sin(between), omega ** 2)
              + chain.moment * (gx * np.sin(theta) - gy * np.cos(theta)))
    return torque @ chain.orientation


def energy(q_link, dq_link, q_motor, dq_motor, arm):
    """
    Return the mechanical energy of links, motors, springs and gravity.

    Parameters
    ----------
    q_link, dq_link, q_motor, dq_motor : ndarray, shape (n_joints,)
        State; the motor side of a rigid joint is not used.
    arm : ArmParams
        The arm.

    Returns
    -------
    float
        Energy [J]; gravity counts from the height of the first joint.

    """
    chain = constants_of(arm)
    theta = chain.orientation @ q_link + chain.offset
    omega = chain.orientation @ dq_link
    mass = chain.coupling * np.cos(theta[:, None] - theta[None, :]) + chain.rigid_inertia
    height = np.stack([np.cos(theta), np.sin(theta)])
    flexible = ~arm.rigid
    twist = (q_motor - q_link)[flexible]
    motors = arm.motor_inertia[flexible] * np.asarray(dq_motor)[flexible] ** 2
    return float(0.5 * omega @ mass @ omega - chain.gravity @ height @ chain.moment
                 + 0.5 * np.sum(motors) + 0.5 * np.sum(arm.stiffness[flexible] * twist ** 2))
