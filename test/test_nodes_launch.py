# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The launch files load, describe themselves and start what their arguments ask for."""

from importlib import util
import os
from pathlib import Path
import re
import signal
import stat
import subprocess
import sys
import time
from types import SimpleNamespace

from gms_flex_control import nodes
from gms_flex_control.data.reader import read_recording
from gms_flex_control.experiment.driven import module_of, private_environment
from gms_flex_control.file_io import read_yaml
from gms_flex_control.params.gains import COMPENSATIONS
from gms_flex_control.schema.keys import known_keys
import launch_stand_in
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted(path.name.removesuffix('.launch.py') for path in (ROOT / 'launch').iterdir()
               if path.name.endswith('.launch.py'))
LOOP = ['plant_node', 'controller_node', 'trajectory_node']
SHOWN = ['robot_state_publisher', 'rviz2']
REAL = all(util.find_spec(name) for name in ('launch', 'launch_ros', 'rclpy'))
needs_launch = pytest.mark.skipif(not REAL, reason='launch and launch_ros are not installed')
COMMON = {'robot', 'controller', 'trajectory', 'bridge', 'mode', 'composed', 'record', 'rviz',
          'state_publisher', 'namespace', 'use_sim_time', 'realtime_priority'}


def loaded(name, monkeypatch):
    """Return the description of a launch file, made with the stand-in for ``launch``."""
    for module, stand_in in launch_stand_in.modules().items():
        monkeypatch.setitem(sys.modules, module, stand_in)
    parts = run_file('launch_parts', Path(nodes.__file__).with_name('launch_parts.py'))
    monkeypatch.setattr(nodes, 'launch_parts', parts, raising=False)
    return run_file(name, ROOT / 'launch' / f'{name}.launch.py').generate_launch_description()


def run_file(name, path):
    """Return a file as a module that nobody else imports."""
    spec = util.spec_from_file_location(name, path)
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def start(monkeypatch, tmp_path):
    """Return a function that returns what a launch file starts with some arguments."""
    for name in SHOWN:
        register(name, tmp_path)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))

    def started(name, pushed='', **given):
        found = launch_stand_in.started(loaded(name, monkeypatch), given, pushed)
        return {process.executable: process for process in found}
    return started


def register(package, prefix):
    """Let the ament index of a prefix know a package."""
    index = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True, exist_ok=True)
    (index / package).touch()


@pytest.mark.parametrize('name', FILES)
def test_every_launch_file_takes_the_same_arguments_and_describes_them(name, monkeypatch):
    entities = loaded(name, monkeypatch).given[0]
    declared = {entity.given[0]: entity.options['description'] for entity in entities
                if 'description' in entity.options}
    assert set(declared) >= COMMON
    assert all(declared.values())


@pytest.mark.parametrize('name, processes', [
    ('closed_loop', LOOP), ('bridge', LOOP), ('demo', [*LOOP, *SHOWN]),
    ('identification', [*LOOP, 'identification_node'])])
def test_a_launch_file_starts_these(name, processes, start):
    assert sorted(start(name)) == sorted(processes)


@pytest.mark.parametrize('name', FILES)
@pytest.mark.parametrize('bridge', ['', 'my_bridge.yaml'])
def test_one_process_is_given_what_three_are(name, bridge, start):
    three, one = (start(name, composed=composed, bridge=bridge, controller='gains.yaml')
                  for composed in ('false', 'true'))
    assert sorted(set(three) - set(one)) == sorted(LOOP)
    loop = one['loop_node']
    for node in LOOP:
        assert set(three[node].files) <= set(loop.files)
        assert three[node].parameters.items() - {('use_sim_time', 'False')} \
            <= loop.parameters.items()
    assert not bridge or loop.files[-1] == bridge


@pytest.mark.parametrize('mode', COMPENSATIONS)
def test_the_demo_takes_every_compensation_of_the_controller(mode, start):
    assert start('demo', compensation=mode)['controller_node'].parameters['compensation'] == mode


@pytest.mark.parametrize('given, shown', [
    ({}, []), ({'rviz': 'true'}, SHOWN), ({'state_publisher': 'true'}, SHOWN[:1]),
    ({'rviz': 'true', 'state_publisher': 'false'}, SHOWN[1:])])
def test_frames_are_published_for_rviz_and_where_they_are_asked_for(given, shown, start):
    assert sorted(set(start('closed_loop', **given)) - set(LOOP)) == shown


def test_helpers_of_packages_that_are_missing_are_warnings(start, monkeypatch, caplog):
    monkeypatch.setenv('AMENT_PREFIX_PATH', '')
    assert sorted(start('demo')) == sorted(LOOP)
    assert [record.getMessage().split()[0] for record in caplog.records] == SHOWN
    assert 'sudo apt install ros-jazzy-robot-state-publisher' in caplog.text


@pytest.mark.parametrize('name', FILES)
def test_helpers_come_first_and_the_loop_ends_with_any_of_its_nodes(name, start):
    found = start(name, rviz='true', record='bag')
    assert sorted(list(found)[:3]) == sorted([*SHOWN, 'gms_flex'])
    for process in (*(found[node] for node in LOOP), start(name, composed='true')['loop_node']):
        assert type(at_exit(process, 0)).__name__ == 'Shutdown'
        assert at_exit(process, -9, ending=True) is None  # it was too slow to end
        with pytest.raises(RuntimeError, match='ended with exit code -9'):  # which launch reports
            at_exit(process, -9)


def at_exit(process, code, ending=False):
    """Return what the launch does at the end of a process; ``ending`` is the launch itself."""
    return process.on_exit(SimpleNamespace(returncode=code, process_name=process.executable),
                           SimpleNamespace(is_shutdown=ending))


@pytest.mark.parametrize('name', FILES)
def test_every_parameter_that_a_launch_file_gives_is_known(name, start):
    """Merge files and single parameters as a node would and look every name up."""
    for process in start(name).values():
        if process.executable not in LOOP:
            continue
        names = set(process.parameters) - {'use_sim_time'}
        for file in process.files:
            names |= set(flat(read_yaml(file, typ='safe')['/**']['ros__parameters']))
        known_keys(names, ('joint1', 'joint2'))


def flat(tree, prefix=''):
    """Return nested parameters as dotted names."""
    found = {}
    for name, value in tree.items():
        found |= flat(value, f'{prefix}{name}.') if isinstance(value, dict) else {
            prefix + name: value}
    return found


@pytest.mark.parametrize('name', FILES)
def test_a_bridge_file_takes_the_place_of_the_simulation(name, start):
    plant = start(name, bridge='my_bridge.yaml')['plant_node']
    assert plant.parameters['backend'] == 'bridge'
    assert plant.files[-1] == 'my_bridge.yaml'
    simulated = start(name, bridge='', mode='lockstep')['plant_node']
    assert 'backend' not in simulated.parameters
    assert simulated.parameters['mode'] == 'lockstep'


def test_a_real_robot_is_started_gently(start):
    """With the gains that test_tuning holds the arm with."""
    gains = start('bridge')['controller_node'].files[-1]
    assert gains == str(ROOT / 'config' / 'first_start.yaml')
    assert start('demo')['controller_node'].files[-1].endswith('/controller.yaml')


def test_a_real_robot_goes_before_other_programs(start):
    given = {name: process.parameters.get('realtime_priority')
             for name, process in start('bridge', bridge='my_bridge.yaml').items()}
    assert given == {'plant_node': None, 'controller_node': '50', 'trajectory_node': '50'}
    own = read_yaml(ROOT / 'config' / 'bridge.yaml', typ='safe')['/**']['ros__parameters']
    assert own['realtime_priority'] == 50
    assert start('demo')['plant_node'].parameters['realtime_priority'] == '0'


@pytest.mark.parametrize('name', FILES)
def test_arguments_reach_the_processes(name, start):
    found = start(name, robot='my.yaml', controller='gains.yaml', trajectory='way.yaml',
                  namespace='left', record='bag', rviz='true', use_sim_time='true')
    assert found['controller_node'].files == ['my.yaml', 'gains.yaml']
    assert found['trajectory_node'].files == ['my.yaml', 'gains.yaml', 'way.yaml']
    assert {found[node].namespace for node in LOOP} == {'left'}
    assert found['gms_flex'].words[:3] == ['record', '--topics', '/left/joint_states']
    assert found['gms_flex'].words[-2:] == ['--out', 'bag']
    outer = start(name, pushed='cell', namespace='left', record='bag')
    assert '/cell/left/joint_states' in outer['gms_flex'].words
    assert found['controller_node'].parameters['use_sim_time'] == 'true'
    if name != 'bridge':  # the simulation makes that time
        assert found['plant_node'].parameters['use_sim_time'] == 'False'
    shown = found['robot_state_publisher'].parameters['robot_description']
    assert shown == 'output of gms_flex urdf --robot "my.yaml"'
    assert Path(found['rviz2'].words[-1]).is_file()


@pytest.mark.parametrize('name, code', [('plant_node', 0), ('gms_flex', 130)])
def test_a_ctrl_c_while_python_itself_starts_prints_no_traceback(name, code, start, tmp_path):
    process = start('closed_loop', record=str(tmp_path / 'bag'))[name]
    node = subprocess.Popen([*process.prefix.split(), *module_of(name), *process.words],
                            stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 10.0
    while not blocks(node.pid, signal.SIGINT):
        assert node.poll() is None and time.monotonic() < deadline
    node.send_signal(signal.SIGINT)
    assert 'Traceback' not in node.communicate(timeout=60)[1]
    assert node.returncode == code


def blocks(pid, number):
    """Return whether a process lets a signal wait."""
    lines = Path(f'/proc/{pid}/status').read_text().splitlines()
    mask, = (int(line.split()[1], 16) for line in lines if line.startswith('SigBlk'))
    return bool(mask >> (number - 1) & 1)


RUN = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
file, *given = sys.argv[1:]
included = IncludeLaunchDescription(PythonLaunchDescriptionSource(file), launch_arguments=[
    tuple(word.split(':=', 1)) for word in given])
service = LaunchService(argv=given)
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""


@pytest.fixture
def launch(tmp_path, monkeypatch):
    """Return a function that starts the real launch of the demo with installed nodes (Popen)."""
    register('gms_flex_control', tmp_path)
    (tmp_path / 'share' / 'gms_flex_control').symlink_to(ROOT)
    folder = tmp_path / 'lib' / 'gms_flex_control'
    folder.mkdir(parents=True)
    for name in (*LOOP, 'gms_flex'):
        (folder / name).write_text(f'#!/bin/sh\nexec {" ".join(module_of(name))} "$@"\n')
        (folder / name).chmod(stat.S_IRWXU)
    monkeypatch.setenv('AMENT_PREFIX_PATH', os.pathsep.join(
        [str(tmp_path), *filter(None, [os.environ.get('AMENT_PREFIX_PATH')])]))
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))
    for name, value in private_environment().items():
        monkeypatch.setenv(name, value)

    def started(*words):
        return subprocess.Popen(
            [sys.executable, '-c', RUN, str(ROOT / 'launch' / 'demo.launch.py'), 'rviz:=false',
             *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return started


@needs_launch
@pytest.mark.flaky(reruns=2)  # other processes of the machine can delay real nodes
def test_the_real_launch_runs_the_loop_in_a_namespace(launch, tmp_path):
    """Installed nodes track in lockstep until the plant's time is over, which ends all of them."""
    robot = tmp_path / 'robot.yaml'
    text = (ROOT / 'config' / 'robot.yaml').read_text()
    robot.write_text(text.replace('parameters:\n', 'parameters:\n    duration: 1.0\n'
                                  '    wait_for_subscribers: 3\n', 1))
    process = launch('mode:=lockstep', 'namespace:=left', f'robot:={robot}',
                     f'record:={tmp_path / "bag"}')
    printed, _ = process.communicate(timeout=60)
    assert process.returncode == 0, printed
    recording = read_recording(tmp_path / 'bag')
    assert recording.time[-1] == pytest.approx(1.0, abs=0.01)
    assert not np.isnan(recording.command[10:-1]).any()


@needs_launch
@pytest.mark.flaky(reruns=2)
def test_the_real_launch_fails_with_a_node_that_is_killed(launch):
    process = launch()
    started = re.compile(r'controller_node.*process started with pid .(\d+)')
    number = next(int(found[1]) for line in process.stdout if (found := started.search(line)))
    next(line for line in process.stdout if 'ACTIVE' in line)
    os.kill(number, signal.SIGKILL)
    printed, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert 'ended with exit code -9' in printed
    for name in ('plant_node', 'trajectory_node'):
        assert re.search(rf'{name}.*process has finished cleanly', printed)
