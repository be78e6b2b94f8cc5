# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The ROS 2 nodes: thin shells that translate messages and delegate."""
