# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The front end of the tool, and `gms_flex simulate`: bags out, one sentence for what is bad."""

import json
import os
from pathlib import Path
import shlex
import subprocess

from gms_flex_control.cli.main import main
from gms_flex_control.data.reader import read_recording
from gms_flex_control.experiment.simulated import read_plan
from gms_flex_control.schema.files import load_robot, save_values
import numpy as np
from processes import environment_of, run_tool, TOOL
import pytest

pytestmark = pytest.mark.fast

CONFIG = Path(__file__).parents[1] / 'config'
ROBOT, CONTROLLER = CONFIG / 'robot.yaml', CONFIG / 'controller.yaml'


@pytest.fixture
def simulate(tmp_path, capsys):
    """Yield a function: options -> (exit code, printed, complaint)."""
    def run(*options, out=tmp_path / 'bag'):
        code = main(['simulate', *map(str, options), '--out', str(out)])
        return (code, *capsys.readouterr())
    return run


@pytest.mark.parametrize('modes', [['gms'], ['none', 'gms']])
def test_what_comes_next_runs_with_motors_of_any_name(modes, simulate, tmp_path, capsys):
    """Names in a bag do not show which are motors then, and config/ knows another robot."""
    robot = tmp_path / 'robot.yaml'
    robot.write_text(ROBOT.read_text().replace('[joint1_motor, joint2_motor]', "['m 1', drive]"))
    code, printed, _ = simulate('--robot', robot, '--duration', '1', '--compensation', *modes)
    *_, last = printed.strip().splitlines()
    words = shlex.split(last.partition('next: ')[2])[1:]
    assert code == 0
    if words[0] == 'view':
        assert words[2:] == ['--robot', str(robot)]
    else:
        assert main(words) == 0
        without = [one for one in words if one not in ('--motors', 'm 1', 'drive')]
        capsys.readouterr()
        assert main([one for one in without if 'joint' not in one]) == 2
        assert '--motors' in capsys.readouterr().err


def test_the_process_exits_0_1_and_2(tmp_path):
    """As a shell sees it: version, gains that break a condition, a bag that is not there."""
    assert run_tool('--version').returncode == 0
    weak = tmp_path / 'weak.yaml'
    weak.write_text(CONTROLLER.read_text().replace('kd_link: 0.8', 'kd_link: 0.1'))
    said_no = run_tool('check-gains', '--robot', str(ROBOT), '--controller', str(weak))
    assert said_no.returncode == 1 and said_no.stderr == ''
    assert 'joint1' in said_no.stdout and 'verdict' in said_no.stdout
    absent = run_tool('info', str(tmp_path / 'absent'))
    assert absent.returncode == 2 and absent.stdout == ''
    assert len(absent.stderr.splitlines()) == 1
    assert absent.stderr.startswith('gms_flex info: ') and 'absent' in absent.stderr


def test_a_reader_that_has_seen_enough_is_no_error(tmp_path):
    """As with ``gms_flex ... | head -0``."""
    read, write = os.pipe()
    os.close(read)
    process = subprocess.Popen(
        [*TOOL, 'simulate', '--duration', '0.1', '--out', str(tmp_path / 'bag')], stdout=write,
        stderr=subprocess.PIPE, text=True, env=environment_of())
    os.close(write)
    _, complaint = process.communicate(timeout=120)
    assert process.returncode == 0 and complaint == ''


def test_a_simulation_is_a_bag_and_a_line(simulate, tmp_path):
    code, printed, complaint = simulate('--duration', 1.5, '--compensation', 'none')
    assert code == 0 and complaint == ''
    assert printed.startswith(f'{tmp_path / "bag"}: sinusoid, none, 1.5 s, MSE per link')
    recording = read_recording(tmp_path / 'bag')
    assert recording.joints == ('joint1', 'joint2') and len(recording.time) == 750
    assert np.all(recording.friction_hat == 0.0)


def test_several_motions_and_modes_make_a_bag_each(simulate):
    code, printed, _ = simulate('--duration', 0.4, '--trajectory', 'sinusoid', 'polynomial',
                                '--compensation', 'none', 'gms', '--json')
    results = json.loads(printed)
    assert code == 0 and [Path(result['bag']).name for result in results] == [
        'sinusoid_none', 'sinusoid_gms', 'polynomial_none', 'polynomial_gms']
    for result in results:
        recording = read_recording(result['bag'])
        error = recording.q_link - recording.reference[:, 0]
        assert np.mean(error ** 2, axis=0).tolist() == pytest.approx(result['mse'])


def test_a_bag_that_is_there_is_refused_before_the_first_run(simulate, tmp_path):
    (tmp_path / 'bag' / 'sinusoid_gms').mkdir(parents=True)
    code, _, said = simulate('--duration', 0.4, '--compensation', 'none', 'gms')
    assert code == 2 and 'sinusoid_gms: exists already' in said
    assert [one.name for one in (tmp_path / 'bag').iterdir()] == ['sinusoid_gms']


def test_a_full_standard_output_is_named(tmp_path):
    with open('/dev/full', 'w') as full:
        done = subprocess.run([*TOOL, 'effects'], stdout=full, stderr=subprocess.PIPE, text=True,
                              check=False, env=environment_of())
    assert done.returncode == 2
    assert done.stderr == 'gms_flex effects: standard output: No space left on device\n'


def test_an_identified_friction_completes_the_robot(simulate, tmp_path):
    """Later files win, for plant and model; as with a single file that holds both."""
    friction = tmp_path / 'friction.yaml'
    save_values({'friction.joint1.forward.static': 0.2,
                 'friction.joint1.forward.coulomb': 0.18}, friction)
    both = tmp_path / 'both.yaml'
    both.write_text(ROBOT.read_text().replace('static: 0.10787', 'static: 0.2').replace(
        'coulomb: 0.09393', 'coulomb: 0.18'))
    found = [json.loads(simulate('--duration', 0.5, '--compensation', 'gms', '--json', *options,
                                 out=tmp_path / name)[1])[0]['mse']
             for name, options in {
                 'paper': (), 'files': ('--robot', ROBOT, friction), 'one': ('--robot', both),
                 'model': ('--model', ROBOT, friction), 'of_one': ('--model', both)}.items()]
    paper, files, one, model, of_one = found
    assert files == one != paper and model == of_one != paper


def test_single_parameters_are_set_as_of_a_node(simulate, tmp_path):
    code, printed, _ = simulate(
        '--duration', 0.5, '--set', 'rate=250', 'initial.joint1=0.4', 'compensation=gms_paper',
        'encoder.counts=0', 'encoder.noise=1e-4', 'trajectory.joint1.amplitude=0.2')
    assert code == 0 and 'gms_paper' in printed
    recording = read_recording(tmp_path / 'bag')
    assert len(recording.time) == 125 and recording.q_link[0, 0] == pytest.approx(0.4, abs=1e-3)
    assert len(set(recording.q_link[:50, 0])) == 50  # noise without counts
    # the reference begins where the encoder sees the robot
    assert recording.reference[0, 0].tolist() == recording.q_link[0].tolist()


def test_motor_names_may_be_left_out_of_a_rigid_robot(tmp_path):
    text = ROBOT.read_text().replace('stiffness: 1.5  ', 'stiffness: .inf')
    (tmp_path / 'named.yaml').write_text(text.replace(
        'motors: [joint1_motor, joint2_motor]', "motors: ['', '']"))
    (tmp_path / 'bare.yaml').write_text(text.replace('motors: [joint1_motor, joint2_motor]', ''))
    assert load_robot(tmp_path / 'bare.yaml').motors == ('', '')
    plans = [read_plan([tmp_path / name, CONTROLLER, CONFIG / 'sinusoid.yaml'], duration=0.2)
             for name in ('named.yaml', 'bare.yaml')]
    assert all(np.all(plan.robot.arm.rigid) for plan in plans)
