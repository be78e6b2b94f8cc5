# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The tutorial with a robot, on real nodes: it does what it says, and everything ends."""

import os
from pathlib import Path
import re
import shutil
from time import monotonic, sleep

from gms_flex_control.data.reader import read_recording
import numpy as np
import pytest
from tutorial import OWN, parts_of, PATIENCE, place_of, ROOT, Terminals, TUTORIALS, write_tool

# what nodes say on a machine that is too busy for them; the bridge answers it with FAULT
LATE = 'too busy for this rate|no usable joint state|was silent for|jumped by'


@pytest.fixture
def place(tmp_path):
    """Yield a place to work in, with ``ros2`` and a domain of its own."""
    here, environment = place_of(tmp_path)
    harness = pytest.importorskip('node_harness')
    number, lock = harness.take_domain()
    environment |= {'ROS_DOMAIN_ID': str(number), harness.DISCOVERY: 'LOCALHOST',
                    'PYTHONUNBUFFERED': '1', 'ROS_LOG_DIR': str(tmp_path / 'log')}
    if not shutil.which('ros2', path=environment['PATH']):
        write_tool(Path(environment['PATH'].split(os.pathsep)[0]) / 'ros2',
                   ROOT / 'test' / 'ros2_stand_in.py')
    with lock:
        yield here, environment


@pytest.mark.flaky(reruns=2)  # other processes of the machine can delay real nodes
def test_the_arm_moves_as_the_tutorial_says_and_everything_ends(place):
    """Where the prose says Ctrl-C every terminal gets it, ends well and leaves nothing behind."""
    here, environment = place
    with Terminals(here, environment) as terminals:
        for prose, commands in parts_of(TUTORIALS / 'with_a_robot.md'):
            if 'Ctrl-C' in prose:
                codes = terminals.interrupt()
                assert codes and not any(codes), terminals.shown()
            for command, expected in commands:
                if command.endswith(OWN):
                    terminals.start(command.removesuffix(OWN))
                else:
                    terminals.do(command, expected)
        assert terminals.interrupt() == []
        terminals.do('ros2 daemon stop', '...')
        angles = read_recording(here / 'first').q_link
        if not re.search(LATE, terminals.shown()):
            assert (np.ptp(angles, axis=0) > 0.5).all(), terminals.shown()  # of 0.6
        assert 'Traceback' not in terminals.shown()
        end = monotonic() + PATIENCE
        while terminals.left() and monotonic() < end:
            sleep(0.1)
        assert terminals.left() == []
