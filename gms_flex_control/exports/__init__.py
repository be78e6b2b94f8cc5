# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A robot for other programs: MuJoCo, URDF, ros2_control, a table; what they lack is named."""
