# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Inertial parameters of an arm of a URDF by weighted least squares on the regressor.

The torque that moves links is linear in ten numbers of each (mass, first moment, inertia about its
frame) and in the motor inertia of rigid joints. Motion determines only some combinations of them,
the base parameters: column-pivoted QR of the regressor along random motion names one number for
each, and how the others join it (Gautier 1991). Every joint counts by its own noise,
robustly; friction, each direction for itself, is eliminated joint by joint. Regressor and torque
pass through one low-pass. The robot is then the one nearest to its URDF that has these base
parameters: a change of the Cholesky factor of each link's pseudo-inertia, so that every link stays
a body (Rucker and Wensing 2022).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control import records
from gms_flex_control.dynamics import chain
from gms_flex_control.identification.axis_fit import friction_regressors
from gms_flex_control.identification.base_parameters import regress
from gms_flex_control.identification.objective import BLOCK_TIME
from gms_flex_control.identification.result import (
    CONFIDENT,
    Estimate,
    Interval,
    NO_INTERVAL,
    NOT_IDENTIFIABLE,
)
from gms_flex_control.identification.segments import (
    drive_sides,
    filled,
    rigid_where,
    segments_of,
    torque_at_samples,
)
from gms_flex_control.identification.smoothing import low_pass
from gms_flex_control.identification.uncertainty import block_sums, clustered, inverse_of
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import RobotParams
import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares

SYMBOLS = ('mass', 'moment_x', 'moment_y', 'moment_z', 'inertia_xx', 'inertia_xy', 'inertia_xz',
           'inertia_yy', 'inertia_yz', 'inertia_zz')
UNITS = ('kg', *('kg m',) * 3, *('kg m^2',) * 6)
MOTOR = 'motor_inertia'
_POSES = 200        # of random motion, more than enough for the rank
_SAME = 1e-8        # of the largest diagonal element of R: rank
_SLIGHT = 1e-6      # of a coefficient that is not worth a word
_THINNING = 8       # samples of a smoothing window that are enough
_MEMORY = 4.0       # samples that the low-pass makes alike
_PRIOR_SD = 0.3     # of a change of a Cholesky factor, and of the logarithm of motor inertia
_WIDE = 0.5         # half an interval this large a part of the value tells nothing
_NOT_MOVED = 'this motion hardly moves it: faster motion of all joints together tells it'


class BaseFit(NamedTuple):
    """Base parameters of an arm from recordings."""

    names: tuple             # (B,), of the number that leads each, such as 'joint2.inertia_zz'
    units: tuple             # (B,)
    meanings: tuple          # (B,), the sum it stands for
    values: np.ndarray       # (B,)
    described: np.ndarray    # (B,), of the URDF
    covariance: np.ndarray   # (B, B)
    condition: float         # of the regressor, columns scaled
    offset: np.ndarray       # (n,), half of what forward and backward friction differ by [N m]
    arm: ArmParams           # nearest to the URDF

    @property
    def error(self):
        """Return the standard deviations (B,)."""
        return np.sqrt(np.diag(self.covariance))


def link_regressors(angle, rate, acceleration, arm: ArmParams) -> np.ndarray:
    """
    Return the torque (S, n, P) of each joint per unit of each inertial parameter.

    Along angles, rates and accelerations (S, n). P are the ten numbers of each link, as
    `inertial_parameters` orders them, and the motor inertia of each rigid joint.
    """
    links, n = chain.constants_of(arm).copy(), arm.n_joints
    states, second = np.stack([angle, rate], axis=1), np.ascontiguousarray(acceleration)
    work = records.build(chain.work_layout(n))

    def torque(link, mass=0.0, com=(0.0, 0.0, 0.0), inertia=(0.0,) * 6):
        for name in ('mass', 'com', 'inertia', 'motor_inertia'):
            links[name][:] = 0.0
        links.mass[link], links.com[link], links.inertia[link] = mass, com, inertia
        bias, inertial = np.empty((2, *second.shape))
        chain.rigid_body_along(states, second, links, work, bias, inertial)
        return bias + inertial
    columns = []
    for link in range(n):
        columns.append(torque(link, 1.0))
        for axis in np.eye(3):  # a mass at the end of the axis, less what is no first moment of it
            about = -(np.eye(3) - np.outer(axis, axis))[np.triu_indices(3)]
            columns.append(torque(link, 1.0, axis, about) - columns[10 * link])
        columns += [torque(link, inertia=one) for one in np.eye(6)]
    columns += [acceleration * (np.arange(n) == j) for j in np.flatnonzero(arm.rigid)]
    return np.stack(columns, axis=2)


def inertial_parameters(arm: ArmParams) -> np.ndarray:
    """Return mass, first moment, inertia (xx, xy, .. zz) about the frame of each link (10 n,)."""
    square = np.einsum('ia,ib->iab', arm.com, arm.com)
    about = arm.inertia + arm.mass[:, None, None] * (
        np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3) - square)
    rows, columns = np.triu_indices(3)
    return np.concatenate([arm.mass[:, None], arm.mass[:, None] * arm.com,
                           about[:, rows, columns]], axis=1).ravel()


def base_of(arm: ArmParams) -> tuple[np.ndarray, np.ndarray]:
    """
    Return which parameters lead base parameters (B,), and these per unit of each (B, P).

    By the regressor along random motion in the ranges of the joints.
    """
    rng, shape = np.random.default_rng(0), (_POSES, arm.n_joints)
    regressor = link_regressors(chain.configurations(arm, _POSES), rng.standard_normal(shape),
                                3.0 * rng.standard_normal(shape), arm)
    table = regressor.reshape(-1, regressor.shape[2])
    size = np.linalg.norm(table, axis=0)
    scaled = table / np.where(size > _SAME * size.max(), size, np.inf)
    upper, order = qr(scaled, mode='r', pivoting=True)
    rank = int(np.sum(np.abs(np.diag(upper)) > _SAME * abs(upper[0, 0])))
    lead = np.sort(order[:rank])
    combination = np.linalg.lstsq(scaled[:, lead], scaled, rcond=None)[0]
    combination *= size / size[lead][:, None]
    combination[np.abs(combination) < _SLIGHT] = 0.0
    return lead, combination


def fit_base_parameters(recordings: Sequence, robot: RobotParams) -> BaseFit:
    """Estimate the base parameters of a robot of kind urdf, joints in its order."""
    sides = drive_sides(recordings[0], robot)
    arm, n = rigid_where(robot, sides).arm, robot.n_joints
    lead, combination = base_of(arm)
    rows = [_rows(segment, arm, lead, recording.period) for recording in recordings
            for segment in segments_of(recording, robot, sides)]
    used = np.cumsum([0, *(part[4][-1] + 1 for part in rows)])
    regressor, torque, friction, rate, block = (np.concatenate(part) for part in zip(
        *((*part[:4], part[4] + first) for part, first in zip(rows, used, strict=False)),
        strict=True))
    values, normal, pieces = regress(regressor, torque, rate, block,
                                     lambda j, chosen: friction[chosen, j])
    scores = sum(_scores(*piece, values, used[-1]) for piece in pieces)
    covariance = clustered(inverse_of(normal), scores, _MEMORY)
    size = 1.0 / np.sqrt(np.diag(normal))
    start = _all_parameters(arm)
    offset = np.empty(n)
    for j in range(n):
        left = torque[:, j] - regressor[:, j] @ values
        found = np.linalg.lstsq(friction[:, j], left, rcond=None)[0]
        offset[j] = 0.5 * (found[0] - found[4])
    names = _names(robot.joints, arm.rigid)
    return BaseFit(
        tuple(names[k] for k in lead),
        tuple((UNITS * n)[k] if k < 10 * n else 'kg m^2' for k in lead),
        tuple(_meaning(row, names) for row in combination), values, combination @ start,
        covariance, float(np.sqrt(np.linalg.cond(normal * np.outer(size, size)))), offset,
        _nearest(robot.arm, arm, combination, values, normal, covariance))


def _scores(scaled, target, block, values, count):
    sums = block_sums(scaled * (target - scaled @ values)[:, None], block)
    return np.pad(sums, ((0, count - len(sums)), (0, 0)))


def _rows(segment, arm, lead, period):
    """Return regressor (S, n, B), torque (S, n), friction (S, n, 8), rate (S, n), block (S,)."""
    every = max(segment.window // _THINNING, 1)
    angle, rate, acceleration = (values[::every] for values in (
        filled(segment.angle), segment.rate, segment.acceleration))
    torque = low_pass(torque_at_samples(segment), segment.window)[::every]
    window = max(segment.window // every, 1)
    regressor = low_pass(link_regressors(angle, rate, acceleration, arm)[:, :, lead], window)
    friction = low_pass(np.stack([friction_regressors(column) for column in rate.T], axis=1),
                        window)
    block = (every * np.arange(len(rate)) * period / BLOCK_TIME).astype(int)
    inner = slice(2 * window, -2 * window, max(window // 2, 1))
    return tuple(part[inner] for part in (regressor, torque, friction, rate, block))


def _all_parameters(arm):
    """Return what `link_regressors` is per unit of (P,)."""
    return np.concatenate([inertial_parameters(arm), arm.motor_inertia[arm.rigid]])


def _names(joints, rigid):
    return [*(f'{joint}.{symbol}' for joint in joints for symbol in SYMBOLS),
            *(f'{joint}.{MOTOR}' for joint, alone in zip(joints, rigid, strict=True) if alone)]


def _meaning(row, names):
    """Return a base parameter as the sum it stands for."""
    text = ''
    for k in np.flatnonzero(row):
        size = '' if abs(abs(row[k]) - 1.0) < _SLIGHT else f'{abs(row[k]):.4g} '
        text += f"{' - ' if row[k] < 0.0 else ' + ' if text else ''}{size}{names[k]}"
    return text


def _nearest(described, arm, combination, values, normal, covariance):
    """Return the ArmParams nearest to its URDF that has base parameters, all links bodies."""
    n, rigid = arm.n_joints, arm.rigid
    wider = np.sqrt(np.diag(covariance) / np.diag(inverse_of(normal)))
    root = np.linalg.cholesky(normal / np.outer(wider, wider)
                              + 1e-12 * np.diag(np.diag(normal))).T
    factors = [np.linalg.cholesky(_pseudo_inertia(one)) for one in
               inertial_parameters(arm).reshape(n, 10)]
    lower = np.tril_indices(4)

    def links(x):
        found = []
        for factor, change in zip(factors, x[:10 * n].reshape(n, 10), strict=True):
            step = np.zeros((4, 4))
            step[lower] = change
            step[np.diag_indices(4)] = np.exp(np.diag(step))
            found.append(_parameters(factor @ step @ step.T @ factor.T))
        return np.array(found)

    def motors(x):
        return arm.motor_inertia[rigid] * np.exp(x[10 * n:])

    def residual(x):
        off = combination @ np.concatenate([links(x).ravel(), motors(x)]) - values
        return np.concatenate([root @ off, x / _PRIOR_SD])
    x = least_squares(residual, np.zeros(10 * n + rigid.sum()), x_scale=_PRIOR_SD).x
    return with_parameters(described, links(x), motors(x), rigid)


def with_parameters(arm: ArmParams, links: np.ndarray, motors=(), rigid=None) -> ArmParams:
    """Return an arm with inertial parameters (n, 10) of its links, ``motors`` of rigid joints."""
    mass, com = links[:, 0], links[:, 1:4] / links[:, :1]
    rows, columns = np.triu_indices(3)
    about = np.empty((len(links), 3, 3))
    about[:, rows, columns] = about[:, columns, rows] = links[:, 4:]
    square = np.einsum('ia,ib->iab', com, com)
    inertia = about - mass[:, None, None] * (
        np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3) - square)
    motor = arm.motor_inertia.copy()
    if rigid is not None:
        motor[rigid] = motors
    return replace(arm, mass=mass, com=com, inertia=inertia, motor_inertia=motor)


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


def base_estimates(fit: BaseFit, joints: Sequence[str]) -> list:
    """Return the Estimates of a BaseFit, a tuple per joint, the arm's with the first."""
    rows = {joint: [] for joint in joints}
    for name, unit, meaning, value, described, error in zip(
            fit.names, fit.units, fit.meanings, fit.values, fit.described, fit.error, strict=True):
        half = CONFIDENT * float(error)
        told = half < _WIDE * abs(value)
        note = f'base parameter {meaning}, {described:.4g} by the URDF'
        rows[name.split('.')[0]].append(Estimate(
            f'arm.{name}', unit, float(value), Interval(value - half, value + half) if told
            else NO_INTERVAL, () if told else (NOT_IDENTIFIABLE,),
            note if told else f'{note}; {_NOT_MOVED}'))
    for joint, offset in zip(joints, fit.offset, strict=True):
        rows[joint].append(Estimate(
            f'arm.{joint}.torque_offset', 'N m', float(offset), NO_INTERVAL, (),
            'a constant torque, or half of what friction differs by between the directions, '
            'where it stays'))
    rows[joints[0]].insert(0, Estimate(
        'arm.condition_number', '1', fit.condition, NO_INTERVAL, (),
        'of the regressor of base parameters, columns scaled: the smaller the better is the '
        'motion'))
    return [tuple(rows[joint]) for joint in joints]
