# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Tracking errors, the paper's Table 4, and a first model of one recorded axis."""
