# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Demonstrations over ROS 2, each with a robot that has what its controller does not know."""
