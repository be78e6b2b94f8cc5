# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Targets of one number each: friction in URDF and in ROS parameters, all of a robot in CSV."""

import csv
import io

from gms_flex_control.effects.catalogue.viscous_error import ViscousError
from gms_flex_control.effects.table import with_friction
from gms_flex_control.exports.target import Target
from gms_flex_control.params.arm import in_units
from gms_flex_control.params.robot import RobotParams, WHOLE_ARM
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.keys import known_keys
from gms_flex_control.schema.urdf import robot_urdf
from ruamel.yaml import YAML

_DRY = ('presliding', 'stribeck', 'direction')
_HEADER = """\
# Friction of each joint, in the order of joints: torque = viscous * velocity + coulomb * sign.
# viscous: N m s/rad, coulomb: N m (N s/m and N of a linear axis).
"""
COLUMNS = ('parameter', 'joint', 'value', 'unit', 'meaning')


def urdf(robot: RobotParams, without: tuple = ()) -> str:
    """Return a robot of rigid joints as URDF, friction as ``<dynamics>`` [N m, N m s/rad]."""
    return robot_urdf(with_friction(robot), motors=False)


def ros2_control(robot: RobotParams, without: tuple = ()) -> str:
    """Return a ROS parameter file of viscous and Coulomb friction, one list over joints each."""
    robot = with_friction(robot)
    lists = {name: [float(f'{value:.9g}') for value in getattr(robot.friction.forward, name)]
             for name in ('viscous', 'coulomb')}
    yaml, text = YAML(), io.StringIO()
    yaml.default_flow_style = None
    yaml.dump({'/**': {'ros__parameters': {'joints': list(robot.joints), 'friction': lists}}},
              text)
    return _HEADER + text.getvalue()


URDF = Target(title='URDF', write=urdf, effects=(ViscousError.name,),
              parts=('spring', 'motor_inertia', 'gravity', *_DRY))
ROS2_CONTROL = Target(title='ros2_control', write=ros2_control, effects=(ViscousError.name,),
                      parts=_DRY)


def table(robot: RobotParams) -> str:
    """
    Return a robot, effects included, as CSV with the columns `COLUMNS`.

    One row per number; entry k of an array is ``name[k]``.
    """
    values = robot_values(robot)
    keys = known_keys(values, robot.joints)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(COLUMNS)
    for name, value in values.items():
        if name in ('joints', 'motors'):
            continue
        parts, key = name.split('.'), keys[name]
        joint = next((part for part in parts[1:-1] if part in (*robot.joints, WHOLE_ARM)), '')
        entries = enumerate(value) if isinstance(value, list) else ((None, value),)
        for k, entry in entries:
            writer.writerow([name if k is None else f'{name}[{k}]', joint, entry,
                             in_units(robot.arm, key.unit), key.description])
    return text.getvalue()
