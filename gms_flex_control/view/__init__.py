# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Bags of ROS 2 without a ROS installation: write, read, summarise, repair."""
