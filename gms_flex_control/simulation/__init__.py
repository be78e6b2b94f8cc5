# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Simulation of robot, encoders and the closed loop; deterministic, fixed step."""
