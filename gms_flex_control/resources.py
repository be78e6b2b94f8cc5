# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Find the parameter and launch files, wherever the package was installed."""

import os
from pathlib import Path
import sys

from gms_flex_control.errors import ConfigError

PACKAGE = 'gms_flex_control'


def share_path() -> Path:
    """
    Return the folder that holds ``package.xml``, ``config/`` and ``launch/``.

    The source tree where the package runs from one (pip's editable installation and ``colcon build
    --symlink-install`` do), else ``share/gms_flex_control`` of the prefix it was installed to.
    ConfigError if the package was copied without its files.
    """
    candidates = list(_candidates())
    for path in candidates:
        if (path / 'package.xml').is_file() and (path / 'config').is_dir():
            return path
    searched = ', '.join(map(str, dict.fromkeys(candidates)))
    raise ConfigError(f'the config folder of {PACKAGE} is in none of {searched}; '
                      'install the package with pip or colcon, or name the file to read')


def robot_file() -> Path:
    """Return the default robot file, ``config/robot.yaml`` of the package."""
    return share_path() / 'config' / 'robot.yaml'


def controller_file() -> Path:
    """Return the default controller file, ``config/controller.yaml`` of the package."""
    return share_path() / 'config' / 'controller.yaml'


def _candidates():
    source = Path(__file__).resolve().parents[1]
    yield source
    # <prefix>/lib/python3.x/site-packages for pip, --user, --prefix and colcon alike
    if len(source.parents) > 2:
        yield source.parents[2] / 'share' / PACKAGE
    for prefix in [sys.prefix, *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)]:
        if prefix:
            yield Path(prefix) / 'share' / PACKAGE
