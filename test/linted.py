# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which sources the linters of ROS look at: all, or some where ruff has looked at all of them."""

import os
from pathlib import Path
import shutil
import sys

RUFF = shutil.which('ruff', path=os.pathsep.join([str(Path(sys.executable).parent), os.defpath]))
# ruff.toml has the rules of both linters, which need a minute for all sources
STEP = 24 if RUFF and not os.environ.get('CI') else 1


def sources():
    """Return paths relative to here, those of hidden folders left out, list of str."""
    paths = sorted(path for path in Path().rglob('*.py')
                   if not any(part.startswith(('.', '_')) for part in path.parts[:-1]))
    return [str(path) for path in paths[::STEP]]
