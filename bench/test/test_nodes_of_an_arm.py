# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Nodes drive the arm of a URDF in lockstep as one process does."""

from pathlib import Path

from node_harness import write_parameters
import numpy as np
import pytest
from test_nodes_lockstep import assert_equal, both

EXAMPLES = Path(__file__).parents[2] / 'examples' / 'industrial_arm'
pytestmark = pytest.mark.flaky(reruns=2)  # other processes of the machine can delay real nodes


def test_an_arm_of_a_urdf_runs(tmp_path, monkeypatch):
    """The nodes find the URDF beside the parameter file that names it; its springs carry links."""
    files = [EXAMPLES / name for name in ('robot.yaml', 'controller.yaml', 'trajectory.yaml')]
    extra = write_parameters(tmp_path / 'extra.yaml', 'trajectory: {ramp_time: 1.0}')
    driven, simulated, _ = both(tmp_path, monkeypatch, [*files, extra], duration=0.8,
                                compensation='gms', rate=1000.0)
    assert len(driven.time) == 800
    assert np.abs(driven.tau_motor[:, 1]).max() > 10.0  # gravity
    assert_equal(driven, simulated)
