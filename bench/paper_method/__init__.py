# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The identification of the paper (section 4), the baseline of gms_flex identify."""
