# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The ten names of the interface for Python, and the example of the documents."""

import inspect
from pathlib import Path
import re
import subprocess
import sys

import gms_flex_control
from gms_flex_control.schema.files import load_robot
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'python.md').read_text(encoding='utf-8')


def test_the_example_of_the_documents_finds_the_stiffness_and_the_friction(tmp_path):
    """As printed there, in a process of its own; the robot of the file is the truth."""
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    example, = re.findall(r'```python\n(.*?)```', PAGE, re.DOTALL)
    ran = subprocess.run([sys.executable, '-c', example], cwd=tmp_path, capture_output=True,
                         text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr
    verdict, friction = ran.stdout.splitlines()
    assert verdict.startswith('effects_found [') and 'stiffness_error' in verdict
    found, true = (load_robot([path]).friction.forward for path in (
        tmp_path / 'identified.yaml', ROOT / 'config' / 'robot.yaml'))
    np.testing.assert_allclose(np.array(friction.strip('[]').split(), dtype=float), found.coulomb,
                               rtol=1e-6)
    speed = np.array([0.8, 1.6])  # a sinusoid tells friction at speed from no Coulomb level
    np.testing.assert_allclose(found.coulomb + speed * found.viscous,
                               true.coulomb + speed * true.viscous, rtol=0.15)


def test_there_are_ten_names_and_the_page_has_each():
    assert len(gms_flex_control.__all__) == 10
    for name in gms_flex_control.__all__:
        assert re.search(rf'^\| .*`{name}\b', PAGE, re.MULTILINE), name
    assert set(gms_flex_control.__all__) <= set(dir(gms_flex_control))
    assert not hasattr(gms_flex_control, 'nonsense')


@pytest.mark.parametrize('name', sorted(gms_flex_control.__all__))
def test_a_public_function_says_what_it_returns(name):
    public = getattr(gms_flex_control, name)
    assert public.__name__ == name and inspect.getdoc(public)
    if inspect.isfunction(public):
        assert inspect.signature(public).return_annotation is not inspect.Signature.empty


def test_importing_the_package_imports_nothing_else():
    """The names are imported when they are used: command line and nodes start quickly."""
    script = ('import sys, gms_flex_control; '
              'print([name for name in ("numpy", "numba", "scipy") if name in sys.modules])')
    ran = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                         check=True, timeout=60)
    assert ran.stdout == '[]\n'
