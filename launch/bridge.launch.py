# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Start the bridge to a real robot, controller and trajectory; docs/hardware.md comes first.

The gains are gentle and friction is not compensated unless controller:=my_controller.yaml says so.

ros2 launch gms_flex_control bridge.launch.py bridge:=my_bridge.yaml robot:=my_robot.yaml
"""

from gms_flex_control.nodes import launch_parts as parts


def generate_launch_description():
    """Return the closed loop around a real robot; torque waits for /plant/enable."""
    arguments = parts.arguments(bridge=parts.config('bridge.yaml'), controller='first_start.yaml',
                                priority='50')
    return parts.description(arguments, parts.closed_loop())
