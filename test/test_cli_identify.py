# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`gms_flex identify` on bad bags: one clear sentence and code 2, or a true number."""

from dataclasses import replace
import json
import warnings

import faulty
from gms_flex_control.cli.main import main
from gms_flex_control.data.writer import write_recording
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.files import load_robot, save_robot, save_values
from identified_axis import axis, experiment, JOINT, pendulum
import numpy as np
import pytest

STEADY = ('static', 'coulomb', 'velocity', 'viscous')


def saved(folder, robot):
    """Write the robot's file and return its path."""
    save_robot(robot, folder / 'robot.yaml')
    return folder / 'robot.yaml'


def bag_of(folder, recording, robot, phases=()):
    """Write a recording as a bag and return its path."""
    write_recording(folder / 'bag', recording, robot.motors, phases=phases)
    return folder / 'bag'


def identified(folder, *arguments):
    """Run the verb on arguments, results into ``folder``/out; return the exit code."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        return main(['identify', *map(str, arguments), '--out', str(folder / 'out')])


@pytest.mark.parametrize(('base', 'fault', 'words'), [
    ('unlike', 'milliseconds', 'in another unit than seconds'),
    ('unlike', 'sides exchanged', 'motor and link of joint1'),
    ('rigid', 'torque reversed', 'the torque of joint1 has the wrong sign')])
def test_a_fault_is_refused_in_one_sentence(tmp_path, capsys, base, fault, words):
    recording, robot = faulty.healthy(base)
    inject = (faulty.FAULTS | faulty.SIDES)[fault][2]
    bag = bag_of(tmp_path, inject(recording), robot)
    assert identified(tmp_path, bag, '--robot', saved(tmp_path, robot)) == 2
    error = capsys.readouterr().err
    assert error.startswith('gms_flex identify: ') and error.count('\n') == 1 and words in error
    assert not (tmp_path / 'out').exists()


def test_motion_one_way_gives_friction_of_that_way_alone(tmp_path):
    """The other way is set to it, and has no interval; the robot file states no friction."""
    recording, robot = faulty.healthy('rigid gravity')
    stated = {name: value for name, value in robot_values(robot).items()
              if not name.startswith('friction.')}
    save_values(stated, tmp_path / 'robot.yaml')
    assert identified(tmp_path, bag_of(tmp_path, faulty.one_way(recording), robot), '--robot',
                      tmp_path / 'robot.yaml', '--blocks', 2) == 0
    report = json.loads((tmp_path / 'out' / 'report.json').read_text())
    found = {one['name']: one for joint in report['joints'] for one in joint['estimates']}
    for j, joint in enumerate(robot.joints):
        forward, backward = (found[f'friction.{joint}.{way}.coulomb'] for way in (
            'forward', 'backward'))
        assert forward['value'] == pytest.approx(robot.friction.forward.coulomb[j], rel=0.1)
        assert backward['value'] == forward['value']
        assert 'not identifiable' in backward['flags']


def clipped(recording):
    """Return a recording whose torque is cut off at half of its largest."""
    limit = 0.5 * np.nanmax(np.abs(recording.tau_motor))
    return replace(recording, tau_motor=np.clip(recording.tau_motor, -limit, limit))


@pytest.mark.parametrize(('words', 'inject'), [
    ('missing', lambda recording: faulty.dropped(recording, 0.01)), ('clipped', clipped)])
def test_a_poor_bag_never_gives_a_confident_wrong_number(tmp_path, capsys, words, inject):
    """Either refused, or warned of with numbers near the truth."""
    robot = axis(rigid=True)
    recording, phases = experiment(rigid=True)
    code = identified(tmp_path, bag_of(tmp_path, inject(recording), robot, phases), '--robot',
                      saved(tmp_path, robot), '--blocks', 4)
    output = capsys.readouterr()
    if code == 2:
        assert output.err.count('\n') == 1 and words in output.err
        assert not (tmp_path / 'out').exists()
        return
    assert code == 0
    report = json.loads((tmp_path / 'out' / 'report.json').read_text())
    assert words in ' '.join(report['warnings'])
    load_robot([tmp_path / 'robot.yaml', tmp_path / 'out' / 'friction.yaml'])
    estimates = {estimate['name']: estimate for estimate in report['joints'][0]['estimates']}
    for side in ('forward', 'backward'):
        for name in STEADY:
            truth = getattr(getattr(robot.friction, side), name)[0]
            estimate = estimates[f'friction.{JOINT}.{side}.{name}']
            low, high = estimate['interval']
            near = abs(estimate['value'] / truth - 1.0) < 0.1
            reported = estimate['flags'] or low <= truth <= high
            assert near or (reported and name in ('velocity', 'viscous')), (
                f'{side}.{name} is {truth}, estimated {estimate}')


def test_joints_of_an_unknown_robot_that_stand_still_are_left_out(tmp_path, capsys):
    """Of six joints moved one by one each bag has one; noise is no motion."""
    one = pendulum(seconds=20.0, pull=0.0)
    noise = 1e-4 * np.round(np.random.default_rng(3).standard_normal(len(one.time)))
    both = replace(
        one, joints=('swing', 'wrist'), tau_motor=one.tau_motor * [1.0, 0.1] + [0.0, 0.4],
        q_link=np.column_stack([one.q_link, noise]), scale_sd=np.zeros(2),
        **{name: np.full((len(one.time), 2), np.nan) for name in (
            'dq_link', 'q_motor', 'dq_motor', 'command', 'friction_hat')},
        reference=np.full((len(one.time), 5, 2), np.nan))
    write_recording(tmp_path / 'bag', both, ('', ''))
    assert main(['identify', str(tmp_path / 'bag'), '--blocks', '1',
                 '--out', str(tmp_path / 'out')]) == 0
    assert 'no motion of wrist: left out' in ' '.join(capsys.readouterr().out.split())
    assert load_robot([tmp_path / 'out' / 'friction.yaml']).joints == ('swing',)


def test_an_unknown_axis_is_linear_where_its_import_says_so(tmp_path):
    """No gravity is looked for over a range of metres, and units are those of a slide."""
    write_recording(tmp_path / 'bag', pendulum(seconds=20.0, pull=0.0), ('',),
                    custom={'axes': 'linear'})
    assert identified(tmp_path, tmp_path / 'bag', '--blocks', 1) == 0
    assert load_robot([tmp_path / 'out' / 'friction.yaml']).arm.axes == 'linear'
    report = json.loads((tmp_path / 'out' / 'report.json').read_text())
    units = {one['name']: one['unit'] for one in report['joints'][0]['estimates']}
    assert units['friction.swing.forward.viscous'] == 'N s/m'
    assert 'arm.swing.gravity_torque' not in units
