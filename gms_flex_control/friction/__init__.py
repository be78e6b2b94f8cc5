# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction of the joints: the Stribeck curve and the Generalized Maxwell-Slip blocks."""
