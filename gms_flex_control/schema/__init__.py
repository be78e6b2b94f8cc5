# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Names, types and ranges of parameters, files of them, and robots for other programs."""
