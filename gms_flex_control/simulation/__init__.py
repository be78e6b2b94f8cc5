# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Simulation of robot, encoders and the closed loop; deterministic, fixed step."""
