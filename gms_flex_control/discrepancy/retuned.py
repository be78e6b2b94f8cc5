# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Known parameters as they were re-tuned, put back into the robot's parameters."""

from dataclasses import replace

from gms_flex_control.discrepancy.known import tuned
from gms_flex_control.simulation import plant
import numpy as np

_CARRIED = ('coupling', 'moment')  # of links
_ROUNDS = 30  # at most, until they are what they should be


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
    made = _with_record(robot, record)
    # a knob scales what a link carries with all that effects add to it, as a payload does
    for _ in range(_ROUNDS):
        got = plant.constants_of(made).chain
        if all(np.allclose(getattr(got, name), getattr(asked, name), rtol=1e-13, atol=0.0)
               for name in _CARRIED):
            break
        for name in _CARRIED:
            own, whole = getattr(record.chain, name), getattr(got, name)
            own *= np.where(whole != 0.0, getattr(asked, name) / np.where(whole, whole, 1.0), 1.0)
        made = _with_record(robot, record)
    return made


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
        motor_inertia=np.where(robot.arm.rigid, robot.arm.motor_inertia, links.motor_inertia))
    return replace(robot, arm=arm, friction=replace(
        robot.friction, **sides, stiffness=np.array(friction.stiffness),
        attraction=np.array(friction.attraction)))


def with_base(arm, links):
    """Return an arm whose links have the inertia and moments of the kernels' record."""
    com, inertia = arm.com.copy(), arm.inertia.copy()
    n = arm.n_joints
    for i in range(n - 1, -1, -1):
        moment = arm.mass[i] * arm.com[i]
        if arm.kind == 'planar' and i > 0 and arm.length[i - 1] > 0.0 and arm.mass[i] > 0.0:
            whole = links.coupling[i - 1, i] / arm.length[i - 1]
            carried = arm.mass[i + 1:].sum() * arm.length[i]
            com[i] = (whole - carried) / arm.mass[i]
        elif moment != 0.0 and np.any(links.gravity != 0.0):
            carried = arm.mass[i + 1:].sum() * arm.length[i] if arm.kind == 'planar' else 0.0
            com[i] = (links.moment[i] - carried) / arm.mass[i]
        carried = (arm.mass[i + 1:].sum() * arm.length[i] ** 2 if arm.kind == 'planar' else 0.0)
        inertia[i] = max(links.coupling[i, i] - carried - arm.mass[i] * com[i] ** 2, 0.0)
    return replace(arm, com=com, inertia=inertia)
