# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Gains for the cascade controller: proposed, judged by their margins, tried under uncertainty."""
