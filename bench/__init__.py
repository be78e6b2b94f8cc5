# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What measures the package, run from a clone as ``python -m bench VERB``; never installed."""
