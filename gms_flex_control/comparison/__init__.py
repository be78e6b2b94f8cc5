# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction compensations side by side, on a simulated plant or along a recording."""
