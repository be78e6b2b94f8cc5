# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Named effects that extend the model by composition, a class each in the catalogue."""
