# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Equations of motion of planar chains and decoupled axes with flexible joints."""
