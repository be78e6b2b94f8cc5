# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Where model and measurement disagree, which effect is missing, and how much it matters."""
