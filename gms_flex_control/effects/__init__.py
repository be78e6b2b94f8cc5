# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Named effects that extend the model by composition, a class each in the catalogue."""
