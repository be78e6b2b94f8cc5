# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction identification and compensation for robots with flexible joints."""

import sys

__version__ = '0.1.0'

if sys.version_info < (3, 11):  # noqa: UP036  colcon does not ask
    sys.exit(f'gms_flex_control needs Python 3.11 or later, this is {sys.version.split()[0]}')
