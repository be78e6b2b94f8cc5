# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Measurements of speed: the compiled core against itself, numpy and MuJoCo."""
