# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Frozen, validated parameters of robot and controller, and the YAML files they come from."""
