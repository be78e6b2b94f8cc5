# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction identification and compensation for robots with flexible joints."""

__version__ = '0.1.0'
