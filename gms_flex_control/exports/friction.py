# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Targets that have viscous and Coulomb friction only: URDF, and ROS parameters as UR has them."""

import io

from gms_flex_control.effects.catalogue.viscous_error import ViscousError
from gms_flex_control.effects.table import with_friction
from gms_flex_control.exports.target import Target
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema.urdf import robot_urdf
from ruamel.yaml import YAML

_DRY = ('presliding', 'stribeck', 'direction')
_HEADER = """\
# Friction of each joint, in the order of joints: torque = viscous * velocity + coulomb * sign.
# viscous: N m s/rad, coulomb: N m (N s/m and N of a linear axis).
"""


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
