# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The effects by the part of the machine they act on; `effects.registry` finds them by name."""
