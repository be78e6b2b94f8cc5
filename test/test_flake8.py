# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The style check of the ROS 2 core packages, with the plugins it has there."""

from importlib.metadata import PackageNotFoundError, version

import pytest

main = pytest.importorskip('ament_flake8.main')


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8():
    result, errors = main.main_with_errors(argv=[])
    assert result == 0, f'{len(errors)} style errors:\n' + '\n'.join(errors)


@pytest.mark.linter
@pytest.mark.parametrize('plugin', ['builtins', 'comprehensions', 'docstrings', 'import-order',
                                    'quotes'])
def test_plugin_is_there(plugin):
    """Without its plugins flake8 says less than on a ROS machine."""
    try:
        assert version(f'flake8-{plugin}')
    except PackageNotFoundError:
        pytest.fail(f'flake8-{plugin} is missing; install the extra [test]')
