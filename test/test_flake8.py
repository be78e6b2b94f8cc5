# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Ruff has looked at every file; flake8 of the ROS 2 core packages: bench/test."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

RUFF = shutil.which('ruff', path=os.pathsep.join([str(Path(sys.executable).parent), os.defpath]))


@pytest.mark.linter
@pytest.mark.skipif(RUFF is None, reason='ruff is not installed')
def test_ruff_has_looked_at_all():
    done = subprocess.run([RUFF, 'check', '--no-cache', Path(__file__).parents[1]],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
