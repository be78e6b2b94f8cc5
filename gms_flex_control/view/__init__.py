# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What `gms_flex view` shows: a bag or the running loop as a page in a browser."""
