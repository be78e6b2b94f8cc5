# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What measures the package, run from a clone as ``python -m bench VERB``; never installed."""
