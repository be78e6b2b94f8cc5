# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Recordings and results as pictures and as one interactive HTML file."""
