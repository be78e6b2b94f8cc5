# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the workflow says of real recordings of other people's robots."""

from pathlib import Path

from bench.real_machines.machines import BAND, MACHINES
from bench.real_machines.split import identified, model_rms
from bench.real_machines.torsion import study
from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.discrepancy.result import FOUND
from gms_flex_control.discrepancy.workflow import find_discrepancy
import pytest

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / 'shared' / 'data'
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f'{DATA} with the recordings is absent')


def axis_of_kr300(folder, name):
    """Return the recording of axis 1 alone, as read from a bag of all three."""
    log = import_csv(DATA / 'kr300' / f'{name}.csv', ROOT / 'config' / 'import_kr300.yaml')
    write_recording(folder / name, log.recording, motors=log.motors)
    return read_recording(folder / name, joints=['axis1'], motors=['axis1_motor'])


def test_flexibility_of_the_kr300_is_an_encoder_skew(tmp_path):
    """Its encoders are read at different times, which a spring does not explain."""
    first, second = (axis_of_kr300(tmp_path, name) for name in ('rec_A', 'rec_B'))
    robot = study(first, 'axis1', 4.58e6).robot
    result = find_discrepancy([first], robot, holdout=[second])
    assert result.verdict == FOUND
    main = result.findings[0]
    assert main.effect == 'encoder_skew' and -0.0035 < main.parameters['delay'] < -0.002
    assert result.gap.after[0] < 0.25 * result.gap.before[0]


def test_what_emps_is_known_to_have_is_found_and_predicts_pulses_of_force():
    """Low-speed shape, ripple and delay; no limit of the drive, which gives twice the torque."""
    machine = MACHINES['emps']
    fitted, pulses = ([machine.recording(piece) for piece in pieces] for pieces in (
        machine.splits[0].fitted, machine.splits[0].held_out))
    robot, _ = identified(machine, fitted)
    result = find_discrepancy(fitted, robot)
    named = {one.effect for one in result.named}
    assert all(named & set(one.effects) for one in machine.known)
    assert 'actuator_saturation' not in {spec.name for spec in result.robot.effects}
    assert model_rms(pulses, result.robot, BAND) < 0.8 * model_rms(pulses, robot, BAND)
