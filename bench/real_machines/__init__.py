# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Identification and discrepancy on public recordings of real machines."""
