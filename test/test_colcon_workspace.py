# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Build the package with colcon in a workspace of its own and start an installed node."""

import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys

from gms_flex_control import __version__
import pytest

PACKAGE = 'gms_flex_control'
ROOT = Path(__file__).resolve().parents[1]
NOT_SOURCE = shutil.ignore_patterns(
    '.*', '__pycache__', '*.egg-info', 'build', 'install', 'log', 'demo_output')

colcon = shutil.which('colcon', path=os.pathsep.join(
    [str(Path(sys.executable).parent), os.environ.get('PATH', '')]))
pytestmark = pytest.mark.skipif(colcon is None, reason='needs colcon: install the extra [test]')


@pytest.fixture(scope='module')
def domain():
    """Yield a ROS domain id that no other process here uses."""
    take_domain = pytest.importorskip('bench.faults.node_bench').take_domain
    number, lock = take_domain()
    with lock:
        yield number


@pytest.fixture(scope='module')
def environment(domain):
    """Return an environment in which ament finds what this Python has, and no other network."""
    prefixes = [sys.prefix, os.environ.get('AMENT_PREFIX_PATH', '')]
    return {**os.environ, 'AMENT_PREFIX_PATH': os.pathsep.join(filter(None, prefixes)),
            'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}


@pytest.fixture(scope='module')
def prefix(tmp_path_factory, environment):
    """Build a copy of the sources once; return where colcon installed the package."""
    workspace = tmp_path_factory.mktemp('workspace')
    shutil.copytree(ROOT, workspace / 'src' / PACKAGE, ignore=NOT_SOURCE)
    result = subprocess.run(
        [colcon, 'build', '--packages-select', PACKAGE], cwd=workspace, env=environment,
        capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return workspace / 'install' / PACKAGE


@pytest.fixture
def plant(prefix, environment, tmp_path):
    """Start the installed plant from the sourced workspace; yield (process, path of output)."""
    setup = prefix.parent / 'local_setup.bash'
    executable = prefix / 'lib' / PACKAGE / 'plant_node'
    config = prefix / 'share' / PACKAGE / 'config'
    command = [executable, '--ros-args', *(word for name in ('robot', 'controller')
                                           for word in ('--params-file', config / f'{name}.yaml'))]
    output = tmp_path / 'output.txt'
    with open(output, 'w', encoding='utf-8') as stream:
        process = subprocess.Popen(
            ['bash', '-c', '. "$0" && exec "$@"', setup, *command], cwd=tmp_path,
            env=environment, stdout=stream, stderr=subprocess.STDOUT)
        try:
            yield process, output
        finally:
            process.kill()
            process.wait()


def test_the_workspace_has_executables_and_resources(prefix):
    executables = {path.name for path in (prefix / 'lib' / PACKAGE).iterdir()}
    assert executables >= {'plant_node', 'controller_node', 'trajectory_node', 'loop_node',
                           'gms_flex'}
    share = prefix / 'share'
    assert (share / 'ament_index' / 'resource_index' / 'packages' / PACKAGE).is_file()
    for part in ('package.xml', 'config/robot.yaml', 'config/controller.yaml',
                 'launch/closed_loop.launch.py'):
        assert (share / PACKAGE / part).is_file(), part


def test_the_workspace_runs_its_own_copy(prefix, environment):
    """Sourced, it hides an installation of the same package, finds its files and has the tool."""
    program = ('import gms_flex_control, gms_flex_control.file_io as r;'
               'print(gms_flex_control.__file__); print(r.share_path())')
    result = subprocess.run(
        ['bash', '-c', '. "$0" && command -v gms_flex && gms_flex --version && exec "$@"',
         prefix.parent / 'local_setup.bash', sys.executable, '-c', program], cwd=prefix,
        env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    where, version, module, share = result.stdout.split()
    assert Path(where) == prefix / 'lib' / PACKAGE / 'gms_flex' and version == __version__
    assert prefix in Path(module).parents and Path(share) == prefix / 'share' / PACKAGE


def test_an_installed_node_is_recorded_and_ends_cleanly(prefix, environment, plant, tmp_path):
    """Start plant_node and the recorder from the workspace; interrupt the plant: exit 0."""
    pytest.importorskip('rclpy')
    process, output = plant
    for k in range(30):  # while it compiles nothing comes
        heard = subprocess.run(
            ['bash', '-c', '. "$0" && exec gms_flex record --topics /joint_states --json '
             f'--duration 2 --out bag{k}', prefix.parent / 'local_setup.bash'], cwd=tmp_path,
            env=environment, capture_output=True, text=True, timeout=60, check=False)
        if heard.returncode == 0 or process.poll() is not None:
            break
    assert heard.returncode == 0, heard.stderr + output.read_text(encoding='utf-8')
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=20) == 0, output.read_text(encoding='utf-8')
