# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Between a controller and a real robot, without ROS: mapping, limits, states, faults, devices."""
