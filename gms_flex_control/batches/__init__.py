# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Many independent items: in processes or on a cluster, each finished one kept on disk."""
