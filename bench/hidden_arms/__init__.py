# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Hidden effects on two arms in space, moved by MuJoCo."""
