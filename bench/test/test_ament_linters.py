# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The style checks of the ROS 2 core packages on all files; `make lint` has ruff's same rules."""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

ament_flake8 = pytest.importorskip('ament_flake8.main')
ament_pep257 = pytest.importorskip('ament_pep257.main')


def sources():
    """Return paths relative to here, those of hidden folders left out, list of str."""
    return [str(path) for path in sorted(Path().rglob('*.py'))
            if not any(part.startswith(('.', '_')) for part in path.parts[:-1])]


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8():
    result, errors = ament_flake8.main_with_errors(argv=sources())
    assert result == 0, f'{len(errors)} style errors:\n' + '\n'.join(errors)


@pytest.mark.linter
@pytest.mark.pep257
def test_pep257():
    assert ament_pep257.main(argv=sources()) == 0, 'found docstring errors'


@pytest.mark.linter
@pytest.mark.parametrize('plugin', ['builtins', 'comprehensions', 'docstrings', 'import-order',
                                    'quotes'])
def test_plugin_is_there(plugin):
    """Without its plugins flake8 says less than on a ROS machine."""
    try:
        assert version(f'flake8-{plugin}')
    except PackageNotFoundError:
        pytest.fail(f'flake8-{plugin} is missing; install the extra [test]')
