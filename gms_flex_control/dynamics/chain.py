# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Rigid-body terms of an arm: ``M(q) ddq + C(q, dq) dq + g(q)``, and their time derivatives.

Two kinds of arm share this interface. Chains in a plane and decoupled axes have a closed form
(dynamics.planar), which is faster than the recursion for chains in space (dynamics.spatial). A
kernel is compiled for the kind whose record it gets. The pose is the one of the last
`accelerations`, in the work space.
"""

from functools import cache, lru_cache

from gms_flex_control import records
from gms_flex_control.compiled import compiled, compiled_choice
from gms_flex_control.dynamics import planar, spatial
from gms_flex_control.params.arm import Body
from gms_flex_control.records import FLOAT
from numba import types
import numpy as np

_SLIDE = 0.5  # [m]


@lru_cache(maxsize=256)
def constants_of(arm) -> np.record:
    """Return an ArmParams as the record the kernels take."""
    return spatial.constants_of(arm) if arm.frames is not None else planar.constants_of(arm)


def carrying(links, load: Body) -> np.record:
    """Return a copy of a record whose last link carries a body, given in that link's frame."""
    return _kernels(links, 'carrying')(links, load)


@cache
def work_layout(n) -> np.dtype:
    """
    Return the dtype of the kernels' work space, of any kind of arm with n joints.

    ``tau`` (n,), torques on the links [N m], and ``acceleration`` (n,), what they cause
    [rad/s^2]; ``implicit`` (n,) stands on the diagonal of M where `accelerations`, `mass_solve`
    and `mass_between` take it, so that viscous friction of an implicit step may act [kg m^2];
    the rest is the kernels' own.
    """
    return records.layout(
        *((name, FLOAT, (n,)) for name in ('tau', 'acceleration', 'implicit', 'cosine', 'sine',
                                           'right')),
        ('matrix', FLOAT, (n, n)), *planar.work_fields(n), *spatial.work_fields(n))


def _kernels(links, name):
    """Return the kernel ``name`` for a record, or for the type of one (numba.types.Record)."""
    fields = links.fields if isinstance(links, types.Record) else links.dtype.names
    return getattr(spatial if 'rotation' in fields else planar, name)


@compiled_choice
def accelerations(q, dq, links, work) -> None:
    """Write joint accelerations under ``work.tau``, ``M ddq + C dq + g = tau``, into ``work``."""
    return _kernels(links, 'accelerations')


@compiled_choice
def mass_times(vector, links, work, out) -> None:
    """Write M of the pose in ``work`` times ``vector`` (n,) into ``out`` (n,)."""
    return _kernels(links, 'mass_times')


@compiled_choice
def mass_solve(vector, links, work, out) -> None:
    """Write the inverse of M, at the pose of `accelerations`, times ``vector`` into ``out``."""
    return _kernels(links, 'mass_solve')


@compiled_choice
def mass_between(carried, links, work, out) -> None:
    """Write the rows and columns ``carried`` (m,) of M at the pose in ``work`` into ``out``."""
    return _kernels(links, 'mass_between')


@compiled_choice
def rigid_body(q, dq, ddq, links, work, bias, inertial) -> None:
    """Write ``C dq + g`` into ``bias`` and ``M ddq`` into ``inertial``, both (n,) [N m]."""
    return _kernels(links, 'rigid_body')


@compiled_choice
def reference_torque(dq, ddq, d3q, velocity, acceleration, links, work, out) -> None:
    """
    Write ``M dr + C r + g`` and its first and second time derivative into ``out`` (3, n) [N m].

    ``dq`` to ``d3q`` (n,) are the true motion, the angles those of the pose in ``work``;
    ``velocity`` and ``acceleration`` (3, n) are r and dr, each with two time derivatives.
    """
    return _kernels(links, 'reference_torque')


@compiled
def rigid_body_along(states, second, links, work, bias, inertial) -> None:
    """Fill ``C dq + g`` and ``M second``, (T, n) each [N m], along a motion (T, >= 2, n)."""
    for k in range(states.shape[0]):
        rigid_body(states[k, 0], states[k, 1], second[k], links, work, bias[k], inertial[k])


def inverse_dynamics(q, dq, ddq, arm) -> np.ndarray:
    """Return ``M ddq + C dq + g`` (..., n) [N m], Eq. (1) left, motors of rigid joints in M."""
    q, dq, ddq = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (q, dq, ddq)))
    shape, n = q.shape, arm.n_joints
    states = np.stack([q.reshape(-1, n), dq.reshape(-1, n)], axis=1)
    bias, inertial = np.empty((2, len(states), n))
    rigid_body_along(states, ddq.reshape(-1, n).copy(), constants_of(arm),
                     records.build(work_layout(n)), bias, inertial)
    return (bias + inertial).reshape(shape)


def mass_matrices(q, arm) -> np.ndarray:
    """Return M (m, n_joints, n_joints) at poses ``q`` (m, n_joints) of ArmParams [kg m^2]."""
    q = np.asarray(q, dtype=float)
    m, n = q.shape
    states = np.repeat(np.stack([q, np.zeros((m, n))], axis=1), n, axis=0)
    bias, columns = np.empty((2, m * n, n))
    rigid_body_along(states, np.tile(np.eye(n), (m, 1)), constants_of(arm),
                     records.build(work_layout(n)), bias, columns)
    return columns.reshape(m, n, n).swapaxes(1, 2)


def own_inertia(links) -> np.ndarray:
    """
    Return the inertia about each joint of all it carries, and that of its motor where rigid.

    (2, n_joints) [kg m^2] of a record of `constants_of`; a planar chain is folded around each
    joint, one in space has all joints at 0.
    """
    if 'coupling' in links.dtype.names:
        return np.stack([np.diag(links.coupling), np.diag(links.rigid_inertia)])
    n = len(links.motor_inertia)
    work, motors = records.build(work_layout(n)), links.motor_inertia * (1.0 - links.flexible)
    spatial.pose(np.zeros(n), links, work)
    spatial.mass_matrix(links, work)
    return np.stack([np.diag(work.matrix) - motors, motors])


def configurations(arm, count) -> np.ndarray:
    """Return poses (count, n_joints) spread evenly over the joint ranges, the first at 0."""
    n, frames = arm.n_joints, arm.frames
    wide = np.where(frames.prismatic, _SLIDE, np.pi)
    lower, upper = np.maximum(frames.lower, -wide), np.minimum(frames.upper, wide)
    root = 2.0
    for _ in range(50):  # of x^(n + 1) = x + 1
        root = (1.0 + root) ** (1.0 / (n + 1))
    steps = np.arange(1, count)[:, None] * root ** -np.arange(1.0, n + 1.0)
    spread = lower + (upper - lower) * ((0.5 + steps) % 1.0)
    return np.concatenate([np.zeros((1, n)), spread])
