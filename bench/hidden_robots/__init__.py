# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Robots in which something is hidden, from an integrator of their own: the test bench."""
