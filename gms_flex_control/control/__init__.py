# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The cascade control law, its friction observer and the conditions on its gains."""
