# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Start robot, controller and trajectory; the arm waits for a call of /trajectory/start.

ros2 launch gms_flex_control closed_loop.launch.py --show-args
"""

from gms_flex_control.nodes import launch_parts as parts


def generate_launch_description():
    """Return the closed loop around a simulated robot."""
    return parts.description(parts.arguments(), parts.closed_loop())
