# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Rounds of designed motions in simulation: one explanation is left, the true one."""

from dataclasses import replace
import json
from pathlib import Path

from gms_flex_control.cli.main import main
from gms_flex_control.data.conditions import conditions_of
from gms_flex_control.data.writer import write_recording
from gms_flex_control.experiment.simulated import Plan, simulate
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.schema.files import save_robot
from gms_flex_control.trajectory import builders
import numpy as np

CONFIG = Path(__file__).parents[2] / 'config'


def test_rounds_in_simulation_leave_the_true_name(robot, gains, tmp_path, capsys):
    loose = replace(robot, effects=(
        EffectSpec(name='backlash', joint='joint2', values=(0.004,)),))
    recording = simulate(Plan(
        robot=loose, model=robot, gains=gains, motion='creeping one way', duration=6.5,
        trajectory=builders.velocity_levels([[0.1, 0.15]], [8.0]),
        period_ns=2_000_000, substeps=20, seed=5, q_link=np.zeros(2)))
    save_robot(loose, tmp_path / 'true.yaml')
    write_recording(tmp_path / 'bag', replace(  # in amperes; the simulated robot's is torque
        recording, tau_motor=20.0 * recording.tau_motor, command=20.0 * recording.command),
                    robot.motors)
    (tmp_path / 'bag' / 'recording.yaml').write_text(
        'torque_constant: {joint1: 0.05, joint2: 0.05}\ntemperature: warm\n')
    (tmp_path / 'gap').mkdir()
    (tmp_path / 'gap' / 'report.json').write_text(json.dumps({
        'sources': [str(tmp_path / 'bag')], 'credible': [], 'findings': [], 'minor': []}))
    arguments = ['next', tmp_path / 'gap', '--robot', CONFIG / 'robot.yaml', '--limits',
                 CONFIG / 'bridge.yaml', '--effects', 'backlash:joint2',
                 'spring_offset:joint2', '--simulate', tmp_path / 'true.yaml', '--budget',
                 '30', '--out', tmp_path / 'rounds']
    assert main(list(map(str, arguments))) == 0
    values = json.loads((tmp_path / 'rounds' / 'separation.json').read_text())
    assert values['left'] == ['backlash of joint2']
    assert 0.0 < values['robot_time'] <= 30.0
    assert values['robot_time'] == sum(one['best']['duration'] for one in values['rounds'])
    known = conditions_of(tmp_path / 'rounds' / '1' / 'bag')
    assert known.operation.temperature == 'warm' and known.torque_constant is None
    printed = capsys.readouterr().out
    assert 'is left, with a probability of' in printed
    assert f' {tmp_path / "rounds" / "1" / "bag"} ' in printed  # in the next command
    assert main(list(map(str, arguments))) == 2
    assert 'has recordings of an earlier run' in capsys.readouterr().err
