# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which effects of its model a controller can make up for, and the model it is left with."""

from dataclasses import replace

from gms_flex_control.effects.base import Change
from gms_flex_control.effects.registry import find
from gms_flex_control.effects.table import is_friction, with_changes, with_friction


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
        False for effects that no torque can undo (backlash), that follow signs of noisy rates
        (motor_coulomb), that need what a controller lacks (drifts) or that act on torque or
        encoders themselves.

    """
    kind = find(name)
    return kind.fed_forward or is_friction(kind) or issubclass(kind, Change)


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
        viscous friction in those of the directions; of its effects those fed forward are left.

    """
    kinds = [(find(spec.name), spec) for spec in robot.effects]
    robot = with_friction(robot)
    return with_changes(replace(robot, effects=tuple(
        spec for kind, spec in kinds if kind.fed_forward or issubclass(kind, Change))))
