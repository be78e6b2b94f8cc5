# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Between a controller and a real robot, without ROS: mapping, limits, states, faults, devices."""
