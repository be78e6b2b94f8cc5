# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Names, types and ranges of all parameters, and the ROS parameter files they are read from."""
