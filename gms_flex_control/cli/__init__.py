# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The command line tool `gms_flex`: one module per verb."""
