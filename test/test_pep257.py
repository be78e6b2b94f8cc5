# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The docstring check of the ROS 2 core packages."""

from linted import sources
import pytest

main = pytest.importorskip('ament_pep257.main')


@pytest.mark.linter
@pytest.mark.pep257
def test_pep257():
    assert main.main(argv=sources()) == 0, 'found docstring errors'
