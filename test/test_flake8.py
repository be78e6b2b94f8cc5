# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Ruff sees what flake8 of the ROS 2 core packages sees, and has looked at every file."""

from importlib.metadata import PackageNotFoundError, version
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import pytest

main = pytest.importorskip('ament_flake8.main')
RUFF = shutil.which('ruff', path=os.pathsep.join([str(Path(sys.executable).parent), os.defpath]))


@pytest.mark.linter
@pytest.mark.skipif(RUFF is None, reason='ruff is not installed')
def test_ruff_has_looked_at_all():
    done = subprocess.run([RUFF, 'check', '--no-cache', Path(__file__).parents[1]],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


BAD = """import sys
import os
list = [x for x in (1, 2)]
def Loud( a ):
    b = "1"
    def c():
        'no.'
    if a == None:
        return {k: k for k in a},   {True: 1}

    return set([1, 2])
print( sys.path) ; print(os.path)
""" + f'{"x" * 99} = 1'


@pytest.mark.linter
@pytest.mark.skipif(RUFF is None, reason='ruff is not installed')
def test_ruff_sees_what_flake8_and_its_plugins_see(tmp_path):
    """In the same lines, of the same families of rules; so it may look in flake8's place."""
    (tmp_path / 'bad.py').write_text(BAD)
    _, errors = main.main_with_errors(argv=[str(tmp_path / 'bad.py')])
    found = subprocess.run([RUFF, 'check', '--output-format', 'json', '--no-cache', '--config',
                           Path(__file__).parents[1] / 'ruff.toml', 'bad.py'], cwd=tmp_path,
                           capture_output=True, text=True, check=False).stdout
    seen = {(one['location']['row'], one['code'][0]) for one in json.loads(found)}
    asked = {(1 if family == 'I' else int(line), family) for line, family in re.findall(
        r'bad\.py:(\d+):\d+: ([A-Z])', '\n'.join(errors))}
    assert {family for _, family in asked} == set('ACDEFIQW')
    assert asked <= seen


@pytest.mark.linter
@pytest.mark.parametrize('plugin', ['builtins', 'comprehensions', 'docstrings', 'import-order',
                                    'quotes'])
def test_plugin_is_there(plugin):
    """Without its plugins flake8 says less than on a ROS machine."""
    try:
        assert version(f'flake8-{plugin}')
    except PackageNotFoundError:
        pytest.fail(f'flake8-{plugin} is missing; install the extra [test]')
