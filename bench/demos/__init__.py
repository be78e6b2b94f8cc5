# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Demonstrations over ROS 2, each with a robot that has what its controller does not know."""
