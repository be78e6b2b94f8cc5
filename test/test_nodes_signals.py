# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Every node ends by a signal with exit code 0, and the controller's last torque is zero."""

import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from gms_flex_control.experiment.driven import executable, ros_arguments
from gms_flex_control.nodes.process import LAUNCHED
from node_harness import MOTION, stamp_of
import pytest

INT, TERM = signal.SIGINT, signal.SIGTERM
NODES = ('controller_node', 'trajectory_node', 'plant_node')


@pytest.mark.parametrize('mode, numbers', [('realtime', (INT, INT)), ('lockstep', (TERM,))])
def test_a_signal_ends_each_node_and_leaves_zero_torque(lab, mode, numbers):
    """A second signal comes at once, as ros2 launch sends it after a Ctrl-C of the terminal."""
    common = {'files': MOTION, 'mode': mode}
    controller = lab.start('controller_node', **common)
    trajectory = lab.start('trajectory_node', trajectory__autostart=True, **common)
    commands, references, states = lab.hear('commands', 'references', 'states')
    plant = lab.start('plant_node', wait_for_subscribers=3, **common)
    lab.until(lambda: len(commands) > 100 and any(commands[-1].data) and states)
    assert controller.signal(*numbers) == 0
    lab.until(lambda: list(commands[-1].data) == [0.0, 0.0])
    answered = stamp_of(commands[-1])
    lab.until(lambda: answered in map(stamp_of, states))
    if mode == 'realtime':  # the plant goes on without torque, and without a controller
        lab.until(lambda: not any(states[-1].effort[2:]))
        lab.more(references, 10)
    assert trajectory.signal(*numbers) == 0
    lab.more(states, 1)
    assert plant.signal(*numbers) == 0
    for process in (controller, trajectory, plant):
        printed = process.printed()
        assert 'rror' not in printed, printed


def test_nodes_that_wait_for_others_end_as_well(lab):
    nodes = [lab.start(name, **({'wait_for_subscribers': 5} if name == 'plant_node' else {}))
             for name in NODES]
    lab.until(lambda: all('[INFO]' in node.printed() for node in nodes))
    for node in nodes:
        assert node.signal(INT, TERM) == 0 and 'rror' not in node.printed()


def test_a_signal_at_any_moment_of_the_start_prints_no_traceback(lab):
    """Also while modules are imported, and where a callback of a library swallows it."""
    for k, name in enumerate([*NODES, 'loop_node']):
        node = lab.start(name)
        maps = Path(f'/proc/{node.process.pid}/maps')  # past Python itself: it loads numpy
        lab.until(lambda maps=maps: '_multiarray_umath' in maps.read_text())
        time.sleep(0.05 * k)
        assert node.signal(INT) == 0 and 'rror' not in node.printed(), node.printed()


def test_the_first_start_says_why_it_takes_long_and_can_be_ended(lab, tmp_path):
    """The plant has to compile: its cache is empty."""
    lab.environment['NUMBA_CACHE_DIR'] = str(tmp_path / 'cache')
    plant = lab.start('plant_node')
    lab.until(lambda: 'the first start on a machine compiles' in plant.printed())
    assert '2 joints' not in plant.printed()
    assert plant.signal(INT) == 0


def test_help_says_what_a_node_is_and_how_it_is_started(lab):
    node = lab.run([*executable('loop_node'), '--help'], 'loop_node')
    assert node.wait() == 0
    assert 'usage: ros2 run gms_flex_control loop_node --ros-args' in node.printed()


def test_help_that_nobody_reads_to_its_end_is_no_error():
    """As of `plant_node --help | head -1`."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([*executable('plant_node'), '--help'], stdout=writer, text=True,
                          stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert done.returncode == -signal.SIGPIPE and done.stderr == ''


def test_what_a_launch_has_started_ends_with_it(lab):
    """The last command is zero torque, however the launch ended; without one nodes go on."""
    plant = lab.start('plant_node', files=MOTION)
    lab.environment[LAUNCHED] = 'true'
    starts = [[*executable(name), *ros_arguments(MOTION, {'trajectory.autostart': True})]
              for name in ('controller_node', 'trajectory_node')]
    launch = lab.run([sys.executable, '-c', LAUNCH, json.dumps(starts)], 'launch')
    commands = lab.hear('commands')
    lab.until(lambda: len(commands) > 100 and any(commands[-1].data))
    launch.signal(signal.SIGKILL)
    lab.until(lambda: not any(map(alive, map(int, launch.printed().split()[:2]))))
    assert not any(commands[-1].data)
    assert plant.runs


LAUNCH = """
import json, subprocess, sys
started = [subprocess.Popen(words) for words in json.loads(sys.argv[1])]
print(*(one.pid for one in started), flush=True)
started[0].wait()
"""


def alive(pid):
    """Return whether a process runs."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().split()[2] != 'Z'
    except FileNotFoundError:
        return False
