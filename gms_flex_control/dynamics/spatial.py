# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Rigid-body terms of a serial chain in space: revolute and prismatic joints, one rigid link each.

The frame of link i lies at its joint, the axis along z. ``M`` comes from composite bodies and
``C dq + g`` from a Newton-Euler recursion (Featherstone 2008, chapters 5 and 6), both in the base
frame. The controller's ``M dr + C r + g`` along a reference velocity r takes the Coriolis matrix
of the Christoffel symbols, as the planar closed form does: with twists (omega, v) of a link and
(rho, w) along r, pseudo-inertia S about the frame, first moment h and mass m, the body's
velocity-product wrench is ``S rho x omega + h x (rho x v), rho x (m v + omega x h)`` (Echeandia
and Wensing 2021, their B(I, v) w written out). Its time derivatives are those of series.
"""

from functools import cache

from gms_flex_control import records
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.dynamics import vectors as vec
from gms_flex_control.params.arm import Body, joined
from gms_flex_control.records import FLOAT
import numpy as np


@cache
def constants_layout(n) -> np.dtype:
    """
    Return the dtype of a spatial arm of n joints as kernels take it.

    ``rotation`` and ``position`` [m] of each joint frame in the link before, at angle 0;
    ``revolute``, 1 or 0 for prismatic; ``offset`` of the joint coordinate [rad or m]; ``mass``
    [kg]; ``com`` in the link's frame [m]; ``inertia`` about the centre of mass (xx, xy, xz, yy,
    yz, zz) [kg m^2]; ``gravity`` in the base frame [m/s^2]; ``motor_inertia`` J [kg m^2];
    ``flexible``, 1 or 0; ``stiffness`` K [N m/rad] and ``damping`` [N m s/rad], 0 where rigid.
    """
    vector = (n,)
    return records.layout(
        ('rotation', FLOAT, (n, 3, 3)), ('position', FLOAT, (n, 3)), ('revolute', FLOAT, vector),
        ('offset', FLOAT, vector), ('mass', FLOAT, vector), ('com', FLOAT, (n, 3)),
        ('inertia', FLOAT, (n, 6)), ('gravity', FLOAT, (3,)),
        ('motor_inertia', FLOAT, vector), ('flexible', FLOAT, vector),
        ('stiffness', FLOAT, vector), ('damping', FLOAT, vector))


def constants_of(arm) -> np.record:
    """Return an ArmParams of kind urdf as the record the kernels take."""
    rows, columns = np.triu_indices(3)
    return records.build(
        constants_layout(arm.n_joints), rotation=arm.frames.rotation,
        position=arm.frames.position, revolute=~arm.frames.prismatic, offset=arm.offset,
        mass=arm.mass, com=arm.com, inertia=arm.inertia[:, rows, columns], gravity=arm.gravity,
        motor_inertia=arm.motor_inertia, flexible=~arm.rigid,
        stiffness=np.where(arm.rigid, 0.0, arm.stiffness),
        damping=np.where(arm.rigid, 0.0, arm.damping))


def carrying(links, load: Body) -> np.record:
    """Return a copy of a record whose last link carries a body, given in that link's frame."""
    out, (rows, columns) = links.copy(), np.triu_indices(3)
    own = np.empty((3, 3))
    own[rows, columns] = own[columns, rows] = links.inertia[-1]
    out.mass[-1], out.com[-1], inertia = joined([Body(links.mass[-1], links.com[-1], own), load])
    out.inertia[-1] = inertia[rows, columns]
    return out


def work_fields(n) -> tuple:
    """Return the fields of the work space that these kernels alone need."""
    return (*((name, FLOAT, (n, 3)) for name in ('axis', 'place', 'lever', 'centre')),
            ('about_centre', FLOAT, (n, 6)), ('force_sum', FLOAT, (n, 3)),
            ('moment_sum', FLOAT, (n, 3)), ('factor', FLOAT, (n, n)),
            ('force', FLOAT, (n, 3, 3)), ('moment', FLOAT, (n, 3, 3)))


@compiled
def pose(q, links, work) -> None:
    """
    Write axes, places, centres of mass and inertias in the base frame, at angles ``q`` (n,).

    ``work.lever`` is the velocity, at the base's origin, of turning about the axis.
    """
    frame, origin = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0)
    for i in range(links.motor_inertia.shape[0]):
        x, y, z = vec.rotation(links.rotation[i])
        origin = vec.add(origin, vec.combine(frame, vec.vector(links.position[i])))
        x, y, z = vec.combine(frame, x), vec.combine(frame, y), vec.combine(frame, z)
        moved = q[i] + links.offset[i]
        if links.revolute[i]:
            c, s = np.cos(moved), np.sin(moved)
            x, y = (vec.add(vec.scale(c, x), vec.scale(s, y)),
                    vec.subtract(vec.scale(c, y), vec.scale(s, x)))
            work.cosine[i], work.sine[i] = c, s
        else:
            origin = vec.add(origin, vec.scale(moved, z))
            work.cosine[i], work.sine[i] = 1.0, moved
        frame = (x, y, z)
        vec.store(work.axis[i], z)
        vec.store(work.place[i], origin)
        vec.store(work.lever[i], vec.cross(origin, z))
        vec.store(work.centre[i], vec.add(origin, vec.combine(frame, vec.vector(links.com[i]))))
        spun = vec.rotated(vec.symmetric(links.inertia[i]), frame)
        for k in range(6):
            work.about_centre[i, k] = spun[k]


@compiled
def mass_matrix(links, work) -> None:
    """Write M (n, n) from the composite bodies beyond each joint, after `pose`."""
    n = links.motor_inertia.shape[0]
    mass, first, second = 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for j in range(n - 1, -1, -1):
        m, c, own = links.mass[j], vec.vector(work.centre[j]), work.about_centre[j]
        h = vec.scale(m, c)
        mass, first = mass + m, vec.add(first, h)
        second = (second[0] + own[0] + h[1] * c[1] + h[2] * c[2], second[1] + own[1] - h[0] * c[1],
                  second[2] + own[2] - h[0] * c[2],
                  second[3] + own[3] + h[0] * c[0] + h[2] * c[2], second[4] + own[4] - h[1] * c[2],
                  second[5] + own[5] + h[0] * c[0] + h[1] * c[1])
        z = vec.vector(work.axis[j])
        if links.revolute[j]:
            s = vec.vector(work.lever[j])
            force = vec.add(vec.scale(mass, s), vec.cross(z, first))
            moment = vec.add(vec.symmetric_times(second, z), vec.cross(first, s))
        else:
            force, moment = vec.scale(mass, z), vec.cross(first, z)
        for i in range(j + 1):
            if links.revolute[i]:
                shared = (vec.dot(vec.vector(work.axis[i]), moment)
                          + vec.dot(vec.vector(work.lever[i]), force))
            else:
                shared = vec.dot(vec.vector(work.axis[i]), force)
            work.matrix[i, j] = work.matrix[j, i] = shared
        if not links.flexible[j]:
            work.matrix[j, j] += links.motor_inertia[j]


@compiled_part
def bias_torque(dq, links, work, out) -> None:
    """Write ``C dq + g`` at rates ``dq`` (n,) into ``out`` (n,), after `pose`."""
    n = links.motor_inertia.shape[0]
    omega, alpha, origin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    lift = vec.scale(-1.0, vec.vector(links.gravity))  # acceleration of the frame's origin
    for i in range(n):
        place, z = vec.vector(work.place[i]), vec.vector(work.axis[i])
        lift = vec.add(lift, swung(omega, alpha, vec.subtract(place, origin)))
        turn = vec.scale(dq[i], z)
        if links.revolute[i]:
            alpha = vec.add(alpha, vec.cross(omega, turn))
            omega = vec.add(omega, turn)
        else:
            lift = vec.add(lift, vec.scale(2.0, vec.cross(omega, turn)))
        origin, centre = place, vec.vector(work.centre[i])
        force = vec.scale(links.mass[i],
                          vec.add(lift, swung(omega, alpha, vec.subtract(centre, place))))
        own = vec.symmetric(work.about_centre[i])
        moment = vec.add(vec.symmetric_times(own, alpha),
                         vec.cross(omega, vec.symmetric_times(own, omega)))
        vec.store(work.force_sum[i], force)
        vec.store(work.moment_sum[i], vec.add(moment, vec.cross(centre, force)))
    force, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(n - 1, -1, -1):
        force = vec.add(force, vec.vector(work.force_sum[i]))
        moment = vec.add(moment, vec.vector(work.moment_sum[i]))
        if links.revolute[i]:
            out[i] = (vec.dot(vec.vector(work.axis[i]), moment)
                      + vec.dot(vec.vector(work.lever[i]), force))
        else:
            out[i] = vec.dot(vec.vector(work.axis[i]), force)


@compiled_part
def swung(omega, alpha, arm) -> tuple:
    """Return the acceleration of a point at ``arm`` from a point of the same body."""
    return vec.add(vec.cross(alpha, arm), vec.cross(omega, vec.cross(omega, arm)))


@compiled
def accelerations(q, dq, links, work) -> None:
    """Write accelerations under ``work.tau`` into ``work.acceleration``; see dynamics.chain."""
    pose(q, links, work)
    mass_matrix(links, work)
    bias_torque(dq, links, work, work.right)
    for i in range(links.motor_inertia.shape[0]):
        work.acceleration[i] = work.tau[i] - work.right[i]
        for j in range(i, links.motor_inertia.shape[0]):
            work.factor[i, j] = work.matrix[i, j]
        work.factor[i, i] += work.implicit[i]
    vec.factorise(work.factor)
    vec.solve_factorised(work.factor, work.acceleration)


@compiled
def mass_times(vector, links, work, out) -> None:
    """Write M of the pose in ``work`` times ``vector`` (n,) into ``out``; see dynamics.chain."""
    n = links.motor_inertia.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += work.matrix[i, j] * vector[j]
        out[i] = total


@compiled
def mass_solve(vector, links, work, out) -> None:
    """Write the inverse of M times ``vector`` into ``out``; see dynamics.chain."""
    for i in range(links.motor_inertia.shape[0]):
        out[i] = vector[i]
    vec.solve_factorised(work.factor, out)


@compiled
def mass_between(carried, links, work, out) -> None:
    """Write the rows and columns ``carried`` (m,) of M into ``out``; see dynamics.chain."""
    for a in range(carried.shape[0]):
        for b in range(carried.shape[0]):
            out[a, b] = work.matrix[carried[a], carried[b]]
        out[a, a] += work.implicit[carried[a]]


@compiled
def rigid_body(q, dq, ddq, links, work, bias, inertial) -> None:
    """Write ``C dq + g`` into ``bias`` and ``M ddq`` into ``inertial``; see dynamics.chain."""
    pose(q, links, work)
    mass_matrix(links, work)
    bias_torque(dq, links, work, bias)
    mass_times(ddq, links, work, inertial)


@compiled
def places_along(q, links, work, out) -> None:
    """Fill ``out`` (T, n + 1, 3) with places of joints and the last link's centre of mass [m]."""
    n = q.shape[1]
    for k in range(q.shape[0]):
        pose(q[k], links, work)
        for i in range(n):
            for a in range(3):
                out[k, i, a] = work.place[i, a]
        for a in range(3):
            out[k, n, a] = work.centre[n - 1, a]


@compiled
def reference_torque(dq, ddq, d3q, velocity, acceleration, links, work, out) -> None:
    """Write ``M dr + C r + g`` and two derivatives into ``out`` (3, n); see dynamics.chain."""
    n, zero = links.motor_inertia.shape[0], (0.0, 0.0, 0.0)
    nothing = (zero, zero, zero)
    omega, v, rho, alpha = nothing, nothing, nothing, nothing
    a = vec.scale(-1.0, vec.vector(links.gravity)), zero, zero
    for i in range(n):
        shift, c, s = _joint_series(i, dq, ddq, links, work)
        rate = dq[i], ddq[i], 0.5 * d3q[i]
        r = velocity[0, i], velocity[1, i], 0.5 * velocity[2, i]
        dr = acceleration[0, i], acceleration[1, i], 0.5 * acceleration[2, i]
        frame = vec.rotation(links.rotation[i])
        v = _inward(frame, c, s, vec.add_series(v, vec.cross_series(omega, shift)))
        a = _inward(frame, c, s, vec.add_series(a, vec.cross_series(alpha, shift)))
        omega, rho, alpha = (_inward(frame, c, s, omega), _inward(frame, c, s, rho),
                             _inward(frame, c, s, alpha))
        if links.revolute[i]:
            omega, rho = _along_z(omega, rate), _along_z(rho, r)
            alpha = vec.add_series(_along_z(alpha, dr), _cross_z(omega, r))
            a = vec.add_series(a, _cross_z(v, r))
        else:
            v = _along_z(v, rate)
            a = vec.add_series(_along_z(a, dr), _cross_z(omega, r))
        m, com = links.mass[i], vec.vector(links.com[i])
        h, about, pseudo = _about_frame(m, com, vec.symmetric(links.inertia[i]))
        at = vec.add_series(a, vec.cross_series(rho, v))
        swing = vec.cross_series(rho, vec.constant_cross(vec.scale(-1.0, h), omega))
        force = vec.add_series(vec.add_series(vec.scale_series(m, at), swing),
                               vec.constant_cross(vec.scale(-1.0, h), alpha))
        moment = vec.add_series(
            vec.add_series(vec.symmetric_times_series(about, alpha), vec.constant_cross(h, at)),
            vec.cross_series(vec.symmetric_times_series(pseudo, rho), omega))
        vec.store_series(work.force[i], force)
        vec.store_series(work.moment[i], moment)
    force, moment = nothing, nothing
    for i in range(n - 1, -1, -1):
        force = vec.add_series(force, vec.load_series(work.force[i]))
        moment = vec.add_series(moment, vec.load_series(work.moment[i]))
        along = moment if links.revolute[i] else force
        out[0, i], out[1, i], out[2, i] = along[0][2], along[1][2], 2.0 * along[2][2]
        if not links.flexible[i]:
            for k in range(3):
                out[k, i] += links.motor_inertia[i] * acceleration[k, i]
        shift, c, s = _joint_series(i, dq, ddq, links, work)
        frame = vec.rotation(links.rotation[i])
        force, moment = _outward(frame, c, s, force), _outward(frame, c, s, moment)
        moment = vec.add_series(moment, vec.cross_series(shift, force))


@compiled_part
def _joint_series(i, dq, ddq, links, work):
    """Return where joint ``i`` shifts its link's frame, and cosine and sine of its angle."""
    position = vec.vector(links.position[i])
    if links.revolute[i]:
        c, s, w = work.cosine[i], work.sine[i], dq[i]
        return ((position, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
                (c, -s * w, -0.5 * (c * w * w + s * ddq[i])),
                (s, c * w, 0.5 * (c * ddq[i] - s * w * w)))
    z = vec.rotation(links.rotation[i])[2]
    return ((vec.add(position, vec.scale(work.sine[i], z)), vec.scale(dq[i], z),
             vec.scale(0.5 * ddq[i], z)), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@compiled_part
def _inward(frame, c, s, a):
    """Return a series given in the frame before a joint in the frame of its link."""
    return vec.turned_back(c, s, (vec.project(frame, a[0]), vec.project(frame, a[1]),
                                  vec.project(frame, a[2])))


@compiled_part
def _outward(frame, c, s, a):
    """Return a series given in a link's frame in the frame before its joint."""
    a = vec.turned(c, s, a)
    return vec.combine(frame, a[0]), vec.combine(frame, a[1]), vec.combine(frame, a[2])


@compiled_part
def _along_z(a, x):
    """Return a series of vectors plus one of numbers along z."""
    return ((a[0][0], a[0][1], a[0][2] + x[0]), (a[1][0], a[1][1], a[1][2] + x[1]),
            (a[2][0], a[2][1], a[2][2] + x[2]))


@compiled_part
def _cross_z(a, x):
    """Return the vector product of a series with one of numbers along z."""
    u = vec.product((a[0][1], a[1][1], a[2][1]), x)
    v = vec.product((a[0][0], a[1][0], a[2][0]), x)
    return (u[0], -v[0], 0.0), (u[1], -v[1], 0.0), (u[2], -v[2], 0.0)


@compiled_part
def _about_frame(m, c, own):
    """Return first moment, inertia and pseudo-inertia of a link about its frame."""
    h = vec.scale(m, c)
    about = (own[0] + h[1] * c[1] + h[2] * c[2], own[1] - h[0] * c[1], own[2] - h[0] * c[2],
             own[3] + h[0] * c[0] + h[2] * c[2], own[4] - h[1] * c[2],
             own[5] + h[0] * c[0] + h[1] * c[1])
    half = 0.5 * (about[0] + about[3] + about[5])
    return h, about, (half - about[0], -about[1], -about[2], half - about[3], -about[4],
                      half - about[5])
