# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""From recordings to parameters: what data identify, the fits, and how far to trust them."""
