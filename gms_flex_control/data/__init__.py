# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Recordings: in memory, as bags of ROS 2 without a ROS installation, from CSV; checks."""
