# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Frozen, validated parameters of robot and controller, and the YAML files they come from."""
