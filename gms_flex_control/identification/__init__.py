# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""From recordings to parameters: what data identify, the fits, and how far to trust them."""
