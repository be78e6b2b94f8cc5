# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The same experiment in this process or as three ROS 2 nodes, from the same files."""
