# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Robots in which something is hidden, from an integrator of their own: the test bench."""
