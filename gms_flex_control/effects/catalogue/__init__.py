# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The effects by the part of the machine they act on; `effects.registry` finds them by name."""
