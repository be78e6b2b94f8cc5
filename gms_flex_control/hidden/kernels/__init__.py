# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The compiled parts of the hidden robots; they share none with the simulation."""
