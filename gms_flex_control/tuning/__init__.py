# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Gains of the cascade controller: proposed, judged by margins, tried, compared by errors."""
