# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Where model and measurement disagree, which effect is missing, and how much it matters."""
