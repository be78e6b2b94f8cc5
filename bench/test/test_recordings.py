# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the workflow says of real recordings of other people's robots."""

from pathlib import Path

from bench.real_machines.machines import BAND, MACHINES
from bench.real_machines.split import identified, model_rms
from gms_flex_control.discrepancy.workflow import find_discrepancy
import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / 'shared' / 'data'
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f'{DATA} with the recordings is absent')


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
