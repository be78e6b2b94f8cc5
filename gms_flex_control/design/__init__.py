# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Design of experiments: the motion to be recorded next."""
