# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The identification of the paper (section 4), the baseline of gms_flex identify."""
