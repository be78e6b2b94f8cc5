# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the workflow says of real recordings of other people's robots."""

from pathlib import Path

from bench.real_machines.torsion import study
from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.discrepancy.result import FOUND, UNEXPLAINED
from gms_flex_control.discrepancy.workflow import find_discrepancy, Options
from gms_flex_control.schema.files import load_robot
import pytest

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / 'shared' / 'data'
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f'{DATA} with the recordings is absent')
# what gms_flex identify makes of all eight recordings of the servo, Coulomb and viscous friction,
# with presliding a tenth as stiff: with 125 N m/rad load friction is no more than the nearest
SERVO = """
/**:
  ros__parameters:
    joints: [joint1]
    motors: ['']
    arm:
      kind: decoupled
      gravity: 9.80665
      joint1: {mass: 0.770, length: 0.0, com: 0.0767, inertia: 0.00445, motor_inertia: 0.0,
               stiffness: .inf, damping: 0.0, offset: -1.594}
    friction:
      joint1:
        forward: {static: 0.0331, coulomb: 0.0330, velocity: 0.001, viscous: 0.00935}
        backward: {static: 0.0440, coulomb: 0.0439, velocity: 0.001, viscous: 0.00811}
        stiffness: [12.55]
        weight: [1.0]
        attraction: 3.845
    effects:
      joint1:
        constant_link_torque: {bias: -0.0257}
"""
MOTIONS = ('sin_sin', 'lift_and_drop')


def axis_of_kr300(folder, name):
    """Return the recording of axis 1 alone, as read from a bag of all three."""
    log = import_csv(DATA / 'kr300' / f'{name}.csv', ROOT / 'config' / 'import_kr300.yaml')
    write_recording(folder / name, log.recording, motors=log.motors)
    return read_recording(folder / name, joints=['axis1'], motors=['axis1_motor'])


def test_flexibility_of_the_kr300_is_an_encoder_skew(tmp_path):
    """
    Its encoders are read at different times, which a spring does not explain.

    About 3 ms by the torsion alone; the second recording had no part in any of it.
    """
    first, second = (axis_of_kr300(tmp_path, name) for name in ('rec_A', 'rec_B'))
    robot = study(first, 'axis1', 4.58e6).robot
    result = find_discrepancy([first], robot, holdout=[second])
    assert result.verdict == FOUND
    main = result.findings[0]
    assert main.effect == 'encoder_skew' and -0.0035 < main.parameters['delay'] < -0.002
    assert result.gap.after[0] < 0.25 * result.gap.before[0]


def test_a_hobby_servo_gets_no_wrong_name(tmp_path):
    """
    Four short recordings, each too short for a block held out of its own.

    Its friction grows with the load, which nothing but load_friction may stand for; that it sticks
    at loads its model's blocks do not bear is not explained.
    """
    (tmp_path / 'servo.yaml').write_text(SERVO)
    robot = load_robot(tmp_path / 'servo.yaml')
    recordings = [import_csv(DATA / 'bam_xl330' / f'{motion}_kp{gain}.csv',
                             ROOT / 'config' / 'import_bam_xl330.yaml').recording
                  for gain in (400, 100) for motion in MOTIONS]
    result = find_discrepancy(recordings, robot, Options(most=1))
    assert result.verdict in (FOUND, UNEXPLAINED)
    assert {one.effect for one in result.findings} <= {'load_friction'}
