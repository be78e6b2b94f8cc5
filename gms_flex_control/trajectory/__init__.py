# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Reference motions with derivatives to the fourth."""
