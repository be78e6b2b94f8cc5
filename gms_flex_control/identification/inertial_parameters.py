# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Inertial parameters of an arm, their base parameters, and the arm nearest to these.

The torque that moves links is linear in ten numbers of each (mass, first moment, inertia about its
frame) and in the motor inertia of rigid joints. Motion determines only some combinations of them,
the base parameters: column-pivoted QR of the regressor along random motion names one number for
each, and how the others join it (Gautier 1991). The arm nearest to its URDF that has given base
parameters is a change of the Cholesky factor of each link's pseudo-inertia, so that every link
stays a body (Rucker and Wensing 2022); of a planar chain, of masses, centres of mass and inertias.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.dynamics import chain, spatial
from gms_flex_control.dynamics import vectors as vec
from gms_flex_control.params.arm import ArmParams, Body, in_space, inertia_of, POINT
import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares, nnls

SYMBOLS = ('mass', 'moment_x', 'moment_y', 'moment_z', 'inertia_xx', 'inertia_xy', 'inertia_xz',
           'inertia_yy', 'inertia_yz', 'inertia_zz')
UNITS = ('kg', *('kg m',) * 3, *('kg m^2',) * 6)
MOTOR = 'motor_inertia'
_SIZE = 0.3         # of bodies [m]
OF_BODY = np.repeat([1.0, _SIZE, _SIZE ** 2], [1, 3, 6])  # so large are ten numbers of one of 1 kg
_POSES = 200        # of random motion, more than enough for the rank
_SAME = 1e-8        # of the largest diagonal element of R: rank
_SLIGHT = 1e-6      # of a coefficient that is not worth a word
IN_PLANE = (0, 1, 9)  # of ten numbers: mass, centre of mass along the link, inertia about z
_STEP = 1e-4        # of a number, for a derivative
_DETERMINED = 0.5   # of a prior standard deviation: above it the data leave a number open
_PRIOR_SD = 0.3     # of a change of a Cholesky factor, and of the logarithm of motor inertia


@compiled_part
def _regressor(q, dq, ddq, links, out) -> None:
    """
    Write the torque of each joint per unit of ten numbers of each link into ``out`` (n, 10 n).

    At angles, rates and accelerations (n,). Of a link the numbers are mass, first moment (x, y,
    z) and inertia about its frame (xx, xy, xz, yy, yz, zz), in that frame.
    """
    n, zero = links.motor_inertia.shape[0], (0.0, 0.0, 0.0)
    frame, origin = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), zero
    omega, alpha, lift = zero, zero, vec.scale(-1.0, vec.vector(links.gravity))
    axes, places = np.empty((n, 3)), np.empty((n, 3))
    out[:] = 0.0
    for i in range(n):
        x, y, z = vec.rotation(links.rotation[i])
        shift = vec.combine(frame, vec.vector(links.position[i]))
        x, y, z = vec.combine(frame, x), vec.combine(frame, y), vec.combine(frame, z)
        angle, turn = q[i] + links.offset[i], vec.scale(dq[i], z)
        if links.revolute[i]:
            c, s = np.cos(angle), np.sin(angle)
            x, y = (vec.add(vec.scale(c, x), vec.scale(s, y)),
                    vec.subtract(vec.scale(c, y), vec.scale(s, x)))
        else:
            shift = vec.add(shift, vec.scale(angle, z))
        lift, origin = vec.add(lift, spatial.swung(omega, alpha, shift)), vec.add(origin, shift)
        if links.revolute[i]:
            alpha = vec.add(alpha, vec.add(vec.cross(omega, turn), vec.scale(ddq[i], z)))
            omega = vec.add(omega, turn)
        else:
            lift = vec.add(lift, vec.add(vec.scale(2.0, vec.cross(omega, turn)),
                                         vec.scale(ddq[i], z)))
        frame = (x, y, z)
        vec.store(axes[i], z)
        vec.store(places[i], origin)
        _add_columns(i, 10 * i, lift, zero, axes, places, links, out)
        spin = (vec.dot(x, omega), vec.dot(y, omega), vec.dot(z, omega))
        gain = (vec.dot(x, alpha), vec.dot(y, alpha), vec.dot(z, alpha))
        column = 10 * i + 4
        for a in range(3):
            axis = frame[0] if a == 0 else frame[1] if a == 1 else frame[2]
            _add_columns(i, 10 * i + 1 + a, spatial.swung(omega, alpha, axis),
                         vec.cross(axis, lift), axes, places, links, out)
            for b in range(a, 3):
                moment = vec.add(_unit_times(a, b, gain), vec.cross(spin, _unit_times(a, b, spin)))
                _add_columns(i, column, zero, vec.combine(frame, moment), axes, places, links, out)
                column += 1


@compiled_part
def _unit_times(a, b, vector):
    """Return the symmetric matrix with ones at (a, b) and (b, a) alone, times a vector."""
    va = vector[0] if a == 0 else vector[1] if a == 1 else vector[2]
    vb = vector[0] if b == 0 else vector[1] if b == 1 else vector[2]
    other = 0.0 if a == b else va
    return ((vb if a == 0 else 0.0) + (other if b == 0 else 0.0),
            (vb if a == 1 else 0.0) + (other if b == 1 else 0.0),
            (vb if a == 2 else 0.0) + (other if b == 2 else 0.0))


@compiled_part
def _add_columns(i, column, force, moment, axes, places, links, out):
    """Write the torques of a force and a moment at the frame of link ``i`` on all joints."""
    place = vec.vector(places[i])
    for j in range(i + 1):
        z = vec.vector(axes[j])
        if links.revolute[j]:
            lever = vec.subtract(place, vec.vector(places[j]))
            out[j, column] = vec.dot(z, vec.add(moment, vec.cross(lever, force)))
        else:
            out[j, column] = vec.dot(z, force)


@compiled
def _regressor_along(q, dq, ddq, links, out) -> None:
    """Fill `_regressor` (T, n, 10 n) along a motion, angles, rates and accelerations (T, n)."""
    for k in range(q.shape[0]):
        _regressor(q[k], dq[k], ddq[k], links, out[k])


def link_regressors(angle, rate, acceleration, arm: ArmParams, coupling=None) -> np.ndarray:
    """
    Return the torque (S, n, P) of each joint per unit of each inertial parameter.

    Along angles, rates and accelerations (S, n). P are the ten numbers of each link, as
    `inertial_parameters` orders them, and the motor inertia of each rigid joint; ``coupling``
    (n, n) is that of a Recording.
    """
    n = arm.n_joints
    motion = [np.ascontiguousarray(one, dtype=float) for one in (angle, rate, acceleration)]
    columns = np.empty((len(motion[0]), n, 10 * n))
    _regressor_along(*motion, spatial.constants_of(arm), columns)
    coupling = np.eye(n) if coupling is None else coupling
    motors = (motion[2] @ coupling.T)[:, None, arm.rigid] * coupling.T[:, arm.rigid]
    return np.concatenate([columns, motors], axis=2)


def inertial_parameters(arm: ArmParams) -> np.ndarray:
    """Return the `ten_numbers` of each link (10 n,)."""
    return np.concatenate([ten_numbers(Body(*link)) for link in zip(
        arm.mass, arm.com, arm.inertia, strict=True)])


def ten_numbers(body: Body) -> np.ndarray:
    """Return mass, first moment, inertia (xx, xy, .. zz) of a body about its frame (10,)."""
    mass, com, inertia = body
    about = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.concatenate([[mass], mass * com, about[np.triu_indices(3)]])


class Base(NamedTuple):
    """Base parameters of an arm."""

    lead: np.ndarray         # (B,), which parameter leads each
    combination: np.ndarray  # (B, P), their change per unit of each parameter


def base_of(arm: ArmParams, coupling=None, numbers: Sequence[int] = range(10)) -> Base:
    """Return the base parameters that motion determines, of the ``numbers`` that may change."""
    rng, shape = np.random.default_rng(0), (_POSES, arm.n_joints)
    regressor = link_regressors(chain.configurations(arm, _POSES), rng.standard_normal(shape),
                                3.0 * rng.standard_normal(shape), arm, coupling)
    table = regressor.reshape(-1, regressor.shape[2])
    size = np.linalg.norm(table, axis=0)
    size[:10 * arm.n_joints] *= np.tile(np.isin(np.arange(10), numbers), arm.n_joints)
    scaled = table / np.where(size > _SAME * size.max(), size, np.inf)
    upper, order = qr(scaled, mode='r', pivoting=True)
    rank = int(np.sum(np.abs(np.diag(upper)) > _SAME * abs(upper[0, 0])))
    lead = np.sort(order[:rank])
    combination = np.linalg.lstsq(scaled[:, lead], scaled, rcond=None)[0]
    combination *= size / size[lead][:, None]
    combination[np.abs(combination) < _SLIGHT] = 0.0
    return Base(lead, combination)


def all_parameters(arm: ArmParams) -> np.ndarray:
    """Return what `link_regressors` is per unit of (P,)."""
    return np.concatenate([inertial_parameters(arm), arm.motor_inertia[arm.rigid]])


def sizes_of_body(arm: ArmParams) -> np.ndarray:
    """Return how large inertial parameters (P,) of a body as heavy as the whole arm are."""
    body = arm.mass.sum() * OF_BODY
    return np.append(np.tile(body, arm.n_joints), np.full(arm.n_joints, body[-1]))


def names_of(joints: Sequence[str], rigid: np.ndarray) -> list:
    """Return the names of what `link_regressors` is per unit of (P,)."""
    return [*(f'{joint}.{symbol}' for joint in joints for symbol in SYMBOLS),
            *(f'{joint}.{MOTOR}' for joint, alone in zip(joints, rigid, strict=True) if alone)]


def meaning_of(row: np.ndarray, names: Sequence[str]) -> str:
    """Return a base parameter as the sum it stands for."""
    text = ''
    for k in np.flatnonzero(row):
        size = '' if abs(abs(row[k]) - 1.0) < _SLIGHT else f'{abs(row[k]):.4g} '
        text += f"{' - ' if row[k] < 0.0 else ' + ' if text else ''}{size}{names[k]}"
    return text


def nearest_arm(described: ArmParams, arm: ArmParams, combination, values, normal, covariance
                ) -> tuple[ArmParams, np.ndarray]:
    """
    Return the arm nearest to the described one that has base parameters ``values`` (B,).

    And relative standard deviations (3, n) of `sizes_of` it and of motors that drive rigid
    joints, infinite where the data leave them open: marginal ones, beside all others.
    Its links are bodies; a planar chain stays one. ``combination`` (B, P) is that of `base_of`
    for ``arm``, which is ``described`` in space with joints rigid that their motor drives;
    ``normal`` (B, B) is the curvature of the cost by values, ``covariance`` (B, B) theirs. That is
    not its inverse, and no weight: few blocks know of directions that nothing determines only
    how these values scatter there, and a bent metric would trade them for what is determined.
    A motor without inertia in the file begins with what links leave to it.
    """
    rigid = arm.rigid
    root = np.linalg.cholesky(normal + 1e-12 * np.diag(np.diag(normal))).T
    size, links, changed = (_of_plane if described.frames is None else _of_bodies)(described, arm)
    stated, at = arm.motor_inertia[rigid], 10 * arm.n_joints
    if np.any(stated == 0.0):
        left = values - combination @ all_parameters(arm)
        needed, _ = nnls(root @ combination[:, at:] * (stated == 0.0), root @ left)
        stated = np.where(stated == 0.0, needed, stated)

    def motors(x):
        return stated * np.exp(x[size:])

    def residual(x):
        off = combination @ np.concatenate([links(x[:size]).ravel(), motors(x)]) - values
        return np.concatenate([root @ off, x / _PRIOR_SD])
    found = least_squares(residual, np.zeros(size + rigid.sum()), x_scale=_PRIOR_SD)
    x, inverse = found.x, np.linalg.inv(found.jac.T @ found.jac)
    weighted = found.jac[:len(values)].T @ root
    covariance = inverse @ (weighted @ covariance @ weighted.T
                            + np.eye(len(x)) / _PRIOR_SD ** 2) @ inverse
    slopes = np.stack([_slope(lambda at: sizes_of(changed(at)), x[:size], k)
                       for k in range(size)], axis=-1)
    spread = np.full((3, arm.n_joints), np.inf)
    square = np.einsum('ija,ab,ijb->ij', slopes, covariance[:size, :size], slopes)
    spread[:2] = np.sqrt(np.nan_to_num(square, nan=np.inf))
    of_motors = np.sqrt(np.diag(covariance)[size:])
    spread[2, rigid] = np.where(of_motors < _DETERMINED * _PRIOR_SD, of_motors, np.inf)
    motor = described.motor_inertia.copy()
    motor[rigid] = motors(x)
    return replace(changed(x[:size]), motor_inertia=motor), spread


def sizes_of(arm: ArmParams) -> np.ndarray:
    """
    Return what weighs, and what turns, of each link (2, n).

    Of links in space mass, and inertia about the centre of mass; of a planar chain first moment
    and inertia about the joint, with all that is carried.
    """
    links = chain.constants_of(arm)
    if arm.frames is None:
        return np.stack([links.moment, np.diagonal(links.coupling)])
    return np.stack([links.mass, links.inertia[:, [0, 3, 5]].sum(axis=1)])


def _slope(function, x, k):
    """Return the derivative of the logarithm of a function by the k-th number."""
    low, high = (function(x + sign * _STEP * (np.arange(len(x)) == k)) for sign in (-1.0, 1.0))
    size = 0.5 * np.abs(low + high)
    return np.divide(high - low, 2.0 * _STEP * size, out=np.full(size.shape, np.inf),
                     where=size > 0.0)


def _of_bodies(described, arm):
    """Return how many numbers change links in space; links (n, 10) and arm as functions of x."""
    n = arm.n_joints
    factors = [np.linalg.cholesky(_pseudo_inertia(one)) for one in
               inertial_parameters(arm).reshape(n, 10)]
    lower = np.tril_indices(4)

    def links(x):
        found = []
        for factor, change in zip(factors, x.reshape(n, 10), strict=True):
            step = np.zeros((4, 4))
            step[lower] = change
            step[np.diag_indices(4)] = np.exp(np.diag(step))
            found.append(_parameters(factor @ step @ step.T @ factor.T))
        return np.array(found)
    return 10 * n, links, lambda x: with_parameters(described, links(x))


def _of_plane(described, arm):
    """Return the same of links whose centres of mass lie on the way to the next joint."""
    reach = np.maximum(described.length, np.abs(described.com))

    def changed(x):
        mass, com, inertia = x.reshape(3, arm.n_joints)
        return replace(described, mass=described.mass * np.exp(mass),
                       com=described.com + reach * com,
                       inertia=described.inertia * np.exp(inertia))
    return 3 * arm.n_joints, lambda x: inertial_parameters(in_space(changed(x))), changed


def with_parameters(arm: ArmParams, links: np.ndarray) -> ArmParams:
    """Return an arm with inertial parameters (n, 10) of its links."""
    mass, com = links[:, 0], links[:, 1:4] / links[:, :1]
    rows, columns = np.triu_indices(3)
    about = np.empty((len(links), 3, 3))
    about[:, rows, columns] = about[:, columns, rows] = links[:, 4:]
    square = np.einsum('ia,ib->iab', com, com)
    inertia = about - mass[:, None, None] * (
        np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3) - square)
    return replace(arm, mass=mass, com=com, inertia=inertia)


def body_of(parameters: np.ndarray) -> Body:
    """Return the body nearest to ten numbers: mass and centre kept, second moments feasible."""
    mass, com = parameters[0], parameters[1:4] / parameters[0]
    second = _pseudo_inertia(parameters)[:3, :3] - mass * np.outer(com, com)
    return Body(float(mass), com, inertia_of(second, POINT * mass))


def _pseudo_inertia(parameters):
    """Return the pseudo-inertia (4, 4) of ten numbers; of a flat body next to singular."""
    about = np.empty((3, 3))
    rows, columns = np.triu_indices(3)
    about[rows, columns] = about[columns, rows] = parameters[4:]
    out = np.empty((4, 4))
    out[:3, :3] = 0.5 * np.trace(about) * np.eye(3) - about
    out[:3, 3] = out[3, :3] = parameters[1:4]
    out[3, 3] = parameters[0]
    return out + 1e-9 * np.diag([*np.full(3, np.trace(about)), 0.0])


def _parameters(pseudo):
    """Return the ten numbers of a pseudo-inertia (4, 4)."""
    about = np.trace(pseudo[:3, :3]) * np.eye(3) - pseudo[:3, :3]
    return np.concatenate([pseudo[3:, 3], pseudo[:3, 3], about[np.triu_indices(3)]])
