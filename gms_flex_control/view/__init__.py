# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What `gms_flex view` shows: a bag or the running loop as a page in a browser."""
