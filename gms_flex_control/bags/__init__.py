# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Bags of ROS 2 without a ROS installation: write, read, summarise, repair."""

from importlib.util import find_spec

from gms_flex_control.errors import BagError

_MISSING = [name for name in ('mcap', 'rosbags') if not find_spec(name)]
if _MISSING:  # rosdep has no package of Ubuntu for them
    raise BagError(f'bags need {" and ".join(_MISSING)} for Python: pip install '
                   "'mcap>=1.5,<2' 'rosbags>=0.11,<0.12', on Ubuntu 24.04 with --user "
                   '--break-system-packages or in a virtual environment')
