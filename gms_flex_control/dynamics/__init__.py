# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Equations of motion of planar chains and decoupled axes with flexible joints."""
