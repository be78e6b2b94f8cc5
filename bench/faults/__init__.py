# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Faults tried on the installed nodes, each as processes of their own over DDS."""
