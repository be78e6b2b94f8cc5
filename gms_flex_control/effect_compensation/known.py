# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which effects of its model a controller can make up for, and the model it is left with."""

from dataclasses import replace

from gms_flex_control.effects import registry
from gms_flex_control.effects.base import Change
from gms_flex_control.effects.table import with_changes
import numpy as np

# torques that follow from what is measured now, smoothly: fed forward, see feedforward.py
FED = ('constant_link_torque', 'friction_hysteresis', 'load_friction', 'low_speed_friction',
       'motor_torque_bias', 'motor_viscous', 'position_friction', 'quadratic_drag',
       'torque_ripple')
# terms that are parameters of the friction model as well
_FOLDED = ('friction_asymmetry', 'viscous_asymmetry', 'viscous_error')


def compensated(name):
    """
    Return whether a controller that knows an effect compensates it.

    Parameters
    ----------
    name : str
        Of the catalogue.

    Returns
    -------
    bool
        False for effects that cannot be undone by a torque (backlash), that follow signs of noisy
        rates (motor_coulomb), that need what a controller lacks (drifts) or that act on torque
        or encoders themselves.

    """
    return name in FED or name in _FOLDED or issubclass(registry.find(name), Change)


def as_parameters(robot):
    """
    Return a model as the cascade law can take it.

    Parameters
    ----------
    robot : RobotParams
        With any effects.

    Returns
    -------
    RobotParams
        Effects that are other values of parameters are in the parameters, asymmetric and further
        viscous friction in those of the directions; of its effects those of `FED` are left.

    """
    friction = robot.friction
    for spec in robot.effects:
        if spec.name in _FOLDED:
            at = np.arange(robot.n_joints) == robot.joints.index(spec.joint)
            friction = _folded(friction, spec.name, at * spec.values[0])
    left = tuple(spec for spec in robot.effects
                 if compensated(spec.name) and spec.name not in _FOLDED)
    return with_changes(replace(robot, friction=friction, effects=left))


def _folded(friction, name, values):
    """Return FrictionParams with asymmetric or further viscous friction ``values`` (n,)."""
    sides = {}
    for side, sign in (('forward', 1.0), ('backward', -1.0)):
        steady = getattr(friction, side)
        if name in ('viscous_asymmetry', 'viscous_error'):
            further = values if name == 'viscous_error' else sign * values
            sides[side] = replace(steady, viscous=np.maximum(steady.viscous + further, 0.0))
        else:
            factor = np.maximum(1.0 + sign * values, 0.05)  # levels stay above zero
            sides[side] = replace(steady, static=steady.static * factor,
                                  coulomb=steady.coulomb * factor,
                                  viscous=steady.viscous * factor)
    return replace(friction, **sides)
