# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Known parameters as they were re-tuned, put back into the robot's parameters."""

from dataclasses import replace

from gms_flex_control.discrepancy.known import tuned
from gms_flex_control.simulation import plant
import numpy as np

_CARRIED = ('coupling', 'moment')  # of links
_PROBE = 0.01                      # relative change that tells what effects make of them


def with_knobs(robot, knobs, x):
    """
    Return a robot whose own parameters are what its knobs say.

    Parameters
    ----------
    robot : RobotParams
        With effects.
    knobs : sequence of Knob
        Of discrepancy.known.
    x : ndarray, shape (P,)
        Their values.

    Returns
    -------
    RobotParams
        Its record is that of `tuned`.

    """
    asked = tuned(plant.constants_of(robot), knobs, x).chain
    record = tuned(plant.constants_of(replace(robot, effects=())), knobs, x)
    # a knob scales what a link carries with all that effects make of it, such as a payload's
    # share; what they make of it is affine in what it is without them
    whole, other = _carried(robot, record), record.copy()
    for name in _CARRIED:
        getattr(other.chain, name)[...] *= 1.0 + _PROBE
    for name, one, two in zip(_CARRIED, whole, _carried(robot, other), strict=True):
        own = getattr(record.chain, name)
        slope = np.divide(two - one, _PROBE * own, out=np.ones_like(own), where=own != 0.0)
        own += (getattr(asked, name) - one) / slope
    return _with_record(robot, record)


def _carried(robot, record):
    """Return what links carry with the effects of a robot whose own parameters are a record's."""
    chain = plant.constants_of(_with_record(robot, record)).chain
    return [np.array(getattr(chain, name)) for name in _CARRIED]


def _with_record(robot, record):
    """Return a robot whose parameters, effects left out, are those of a kernels' record."""
    friction, links = record.friction, record.chain
    sides = {}
    for row, side in enumerate(('forward', 'backward')):
        steady = getattr(robot.friction, side)
        coulomb = np.array(friction.coulomb[row])
        sides[side] = replace(steady, coulomb=coulomb,
                              static=np.maximum(friction.static[row], coulomb),
                              velocity=np.array(friction.velocity[row]),
                              viscous=np.array(friction.viscous[row]))
    arm = with_base(robot.arm, links)
    arm = replace(
        arm, stiffness=np.where(robot.arm.rigid, robot.arm.stiffness, links.stiffness),
        damping=np.where(robot.arm.rigid, robot.arm.damping, links.damping),
        motor_inertia=np.array(links.motor_inertia))
    return replace(robot, arm=arm, friction=replace(
        robot.friction, **sides, stiffness=np.array(friction.stiffness),
        attraction=np.array(friction.attraction)))


def with_base(arm, links):
    """Return an arm whose links have the inertia and moments of the kernels' record."""
    mass, com, inertia = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
    planar = arm.kind == 'planar'
    for i in range(arm.n_joints - 1, -1, -1):
        carried = mass[i + 1:].sum() if planar else 0.0
        moment = links.moment[i]
        if planar and i > 0 and arm.length[i - 1] > 0.0:
            moment = links.coupling[i - 1, i] / arm.length[i - 1]
        own = moment - carried * arm.length[i]
        about = links.coupling[i, i] - carried * arm.length[i] ** 2
        if mass[i] > 0.0:
            if own ** 2 > mass[i] * about > 0.0:  # with that mass no link turns so easily
                mass[i] = own ** 2 / about
            com[i] = own / mass[i]
        inertia[i] = max(about - mass[i] * com[i] ** 2, 0.0)
    return replace(arm, mass=mass, com=com, inertia=inertia)
