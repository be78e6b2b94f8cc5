# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Plant or bridge, controller and trajectory in one process: as three, and to the last bit."""

import os
from pathlib import Path

from bridge_lab import ask, bridge_lab, move
from gms_flex_control.bags.reader import read_recording
from gms_flex_control.experiment.driven import TOPICS
from gms_flex_control.experiment.processes import executable
from gms_flex_control.experiment.plan import read_plan
from gms_flex_control.experiment.simulated import simulate_to_bag
from gms_flex_control.nodes.serialized import Serialized
from node_harness import (
    array_message,
    COMMANDS,
    CONFIG,
    FILES,
    Float64MultiArray,
    JointState,
    Lab,
    REFERENCE,
    stamp_of,
    STATES,
    TERM,
    traceback_free,
    Trigger,
)
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from test_nodes_lockstep import assert_equal

# other processes of the machine can delay real nodes beyond any bound
pytestmark = pytest.mark.flaky(reruns=2)
MOTION = [*FILES, CONFIG / 'sinusoid.yaml']
NODES = {'/plant', '/cascade_controller', '/trajectory'}


def test_lockstep_in_one_process_is_the_simulation_to_the_last_bit(tmp_path):
    with Lab(tmp_path) as lab:
        recorder = lab.run([*executable('gms_flex'), 'record', '--topics', *TOPICS, '--out',
                            str(tmp_path / 'driven')], 'recorder')
        loop = lab.start('loop_node', files=MOTION, trajectory__autostart=True, mode='lockstep',
                         rate=500.0, duration=3.0, wait_for_subscribers=3)
        assert loop.wait() == 0
        assert recorder.signal(TERM) == 0
        assert traceback_free(loop, recorder)
    plan = read_plan(MOTION, duration=3.0, overrides={'compensation': 'gms', 'rate': 500.0})
    simulate_to_bag(plan, tmp_path / 'simulated')
    driven, simulated = (read_recording(tmp_path / name, plan.robot.joints, plan.robot.motors)
                         for name in ('driven', 'simulated'))
    assert len(driven.time) == 1500 and np.ptp(driven.q_link[:, 0]) > 0.3  # it moved
    assert_equal(driven, simulated)
