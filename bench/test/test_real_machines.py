# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The bench of real machines: its least squares on closed forms, its imports, a whole run."""

from dataclasses import replace
import json
from pathlib import Path

from bench.__main__ import main
from bench.real_machines import least_squares
from bench.real_machines.least_squares import Part
from bench.real_machines.machines import MACHINES, shared_data, VARIABLE
from bench.real_machines.motion import low_pass, Motion, motion_of, residual_torque, rms
from bench.real_machines.split import identified, model_rms, parts_of
from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.data.recording import Recording
from gms_flex_control.discrepancy.result import FOUND
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.params.robot import StribeckParams
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / 'shared' / 'data'
ALL = IdentifyOptions(estimate='all', blocks=(1, 3))
real = pytest.mark.skipif(not DATA.is_dir(), reason='the recordings are not beside the project')
PERIOD = 2e-3
BAND = 40.0
INERTIA, COULOMB, VISCOUS, OFFSET = 2.0, 3.0, 1.5, -0.7
RIPPLE, ORDER, DELAY = 0.6, 40.0, 1.5e-3
ANGLE = (0.9, 0.5), (0.4, 1.3)  # amplitude [rad] and frequency [Hz] of both sines


def angle(time, derivative=0):
    """Return the angle at times, or a derivative, in closed form."""
    return sum(amplitude * (2.0 * np.pi * hertz) ** derivative
               * np.sin(2.0 * np.pi * hertz * time + 0.5 * np.pi * derivative)
               for amplitude, hertz in ANGLE)


def torque(time, ripple=0.0):
    """Return the torque that the motion at ``time`` takes."""
    rate = angle(time, 1)
    return (INERTIA * angle(time, 2) + COULOMB * np.sign(rate) + VISCOUS * rate + OFFSET
            + ripple * np.sin(ORDER * angle(time) + 0.3))


def motion(ripple=0.0, delay=0.0, duration=20.0):
    """Return a Motion without noise whose torque lags behind by ``delay``."""
    time = PERIOD * np.arange(int(duration / PERIOD))
    return Motion(time=time, period=PERIOD, angle=angle(time), rate=angle(time, 1),
                  acceleration=angle(time, 2), torque=torque(time - delay, ripple),
                  standing=np.zeros(len(time), dtype=bool), weight=0.0, source='closed form')


def part(one):
    return [Part(one, one.used)]


def test_textbook_recovers_inertia_and_friction():
    fit = least_squares.textbook(part(motion()), BAND, gravity=False)
    assert fit.weights == pytest.approx([INERTIA, COULOMB, VISCOUS, OFFSET], rel=5e-3)
    assert fit.rms(part(motion())) < 0.02 * COULOMB


def test_library_recovers_ripple_and_delay_and_chooses_them():
    delay = -DELAY
    one = motion(RIPPLE, delay)
    found = least_squares.compared(part(one), BAND, gravity=False, loaded=False)
    assert {'ripple', 'delay'} <= set(found.chosen.groups)
    assert found.chosen.delay == pytest.approx(delay, abs=1.3e-4)
    wave = next(column.name for column in found.chosen.columns if column.group == 'ripple')
    order = wave.partition('_')[2]
    size = np.hypot(found.chosen.weight(f'sin_{order}'), found.chosen.weight(f'cos_{order}'))
    assert size == pytest.approx(RIPPLE, rel=0.05)
    assert found.chosen.weight('inertia') == pytest.approx(INERTIA, rel=0.01)
    later = part(motion(RIPPLE, delay, 30.0))
    assert found.chosen.rms(later) < 0.2 * found.plain.rms(later)


def test_nothing_is_chosen_where_the_textbook_is_the_truth():
    rng = np.random.default_rng(1)
    one = motion()
    noisy = replace(one, torque=one.torque + rng.normal(0.0, 0.5, len(one.time)))
    found = least_squares.compared(part(noisy), BAND, gravity=False, loaded=False)
    assert found.chosen.groups == found.plain.groups


def closed_form_recording():
    """Return a Recording of the closed form, torque held over each sample as its middle has it."""
    time = PERIOD * np.arange(10000)
    return Recording(joints=('axis',), time=time, source='closed form',
                     q_link=angle(time)[:, None],
                     tau_motor=torque(time - 0.5 * PERIOD)[:, None])


def test_a_model_with_the_same_parameters_leaves_what_least_squares_leaves():
    """Both see one motion behind one filter, so the comparison is fair."""
    recording = closed_form_recording()
    one = motion_of(recording)
    fit = least_squares.textbook(part(one), 8.0, gravity=False)
    robot = rigid_joints(['axis'])
    sides = {side: StribeckParams(
        static=[level], coulomb=[level], velocity=[1e-3], viscous=[fit.weight('viscous')])
        for side, level in (('forward', fit.weight('coulomb') + fit.weight('offset')),
                            ('backward', fit.weight('coulomb') - fit.weight('offset')))}
    robot = replace(
        robot, arm=replace(robot.arm, inertia=np.array([fit.weight('inertia')])),
        friction=replace(robot.friction, **sides, stiffness=np.array([[1e5]]),
                         attraction=np.array([1e3])))
    left = low_pass(residual_torque(recording, robot), 8.0, one.period)
    assert fit.weight('inertia') == pytest.approx(INERTIA, rel=0.01)
    assert rms((left - fit.residual(one))[one.used]) < 0.05 * COULOMB
    heavier = replace(robot, arm=replace(robot.arm, inertia=robot.arm.inertia + 0.5))
    more = low_pass(residual_torque(recording, heavier), 8.0, one.period) - left
    expected = low_pass(-0.5 * one.acceleration, 8.0, one.period)
    assert rms((more - expected)[one.used]) < 0.01 * rms(expected)


DEGREE, INCH, KIP = np.pi / 180.0, 0.0254, 4448.2216
# samples per second, and from the columns of the log: position and torque in SI
LOGS = {
    'emps': (1000.0, lambda log: log[1], lambda log: 35.15065188 * log[3]),
    'kr300_axis1': (250.0, lambda log: DEGREE * log[1], lambda log: 256.9 * log[4]),
    'kr300_axis2': (250.0, lambda log: DEGREE * log[6], lambda log: 267.4 * log[8]),
    'kr300_axis3': (250.0, lambda log: DEGREE * log[10], lambda log: 252.3 * log[12]),
    'xl330': (188.0, lambda log: log[2],
              lambda log: 0.104 * (log[4] / 885.0 * log[5] - 0.354 * log[3])),
    'arts_friction_damper': (512.0, lambda log: INCH * log[1], lambda log: KIP * log[2]),
    'odri_motor': (1000.0, lambda log: log[1][8800:], lambda log: log[3][8800:])}


def needed(name):
    """Return a machine, or skip where its files are absent."""
    machine = MACHINES[name]
    if machine.absent():
        pytest.skip(f'{machine.absent()} is absent')
    return machine


def test_flexibility_of_the_kr300_is_an_encoder_skew():
    """Its encoders are read at different times, which a spring does not explain."""
    machine = needed('kr300_axis1')
    fitted = [machine.recording(piece) for piece in machine.splits[0].fitted]
    result = find_discrepancy(fitted, identified(machine, fitted)[0])
    assert result.verdict == FOUND
    found = {one.effect: one.parameters for one in result.findings}
    assert -0.0035 < found['encoder_skew']['delay'] < -0.002
    assert result.gap.after[0] < 0.25 * result.gap.before[0]


def emps_with_pulses(split):
    """Return the machine, what is said of a split, and errors of pulses before and after."""
    machine = needed('emps')
    fitted, pulses = ([machine.recording(piece) for piece in pieces] for pieces in (
        machine.splits[split].fitted, machine.splits[0].held_out))
    robot, _ = identified(machine, fitted)
    result = find_discrepancy(fitted, robot)
    return machine, result, *(model_rms(pulses, one, machine.bands[0])
                              for one in (robot, result.robot))


def test_what_emps_is_known_to_have_is_found_and_predicts_pulses_of_force():
    """Low-speed shape, ripple and delay; no limit of the drive, which gives twice the torque."""
    machine, result, before, after = emps_with_pulses(0)
    named = {one.effect for one in result.named}
    assert all(named & set(one.effects) for one in machine.known)
    assert 'actuator_saturation' not in {spec.name for spec in result.robot.effects}
    assert after < 0.8 * before


def test_half_of_emps_names_no_limit_that_its_peaks_resemble():
    """With a limit at 140 of 152 N the pulses, of 317 N, were predicted worse than without."""
    _, result, before, after = emps_with_pulses(1)
    assert 'actuator_saturation' not in {spec.name for spec in result.robot.effects}
    assert after < before


@pytest.mark.parametrize('name', list(MACHINES))
def test_logs_come_in_si_units_at_their_own_rate(name):
    machine = needed(name)
    piece = machine.splits[0].fitted[0]
    recording = machine.recording(piece)
    log = np.genfromtxt(shared_data() / machine.folder / piece.file, delimiter=',',
                        skip_header=1).T
    rate, position, effort = LOGS[name]
    assert 1.0 / recording.period == pytest.approx(rate, rel=0.01)
    assert recording.q_link[:, 0] == pytest.approx(position(log), rel=1e-5, abs=1e-12)
    assert recording.tau_motor[:, 0] == pytest.approx(effort(log), rel=1e-5, abs=1e-9)
    assert machine.believed(recording).joints == (machine.joint,)


@pytest.mark.parametrize('name', list(MACHINES))
def test_nothing_that_is_held_out_is_fitted(name):
    for split in MACHINES[name].splits:
        for one in split.fitted:
            for other in split.held_out:
                assert (one.file != other.file or one.end <= other.begin
                        or other.end <= one.begin), (split.name, one)


def test_least_squares_of_emps_is_that_published():
    """Janot, Gautier and Brunot: 95.11 kg, 203.5 N s/m, 20.39 N, -3.16 N."""
    machine = needed('emps')
    recording = machine.recording(machine.splits[0].fitted[0])
    fit = least_squares.textbook(parts_of([recording], BAND), BAND, gravity=False)
    assert fit.weight('inertia') == pytest.approx(95.11, rel=0.005)
    assert fit.weight('viscous') == pytest.approx(203.5, rel=0.03)
    assert fit.weight('coulomb') == pytest.approx(20.39, rel=0.03)
    assert fit.weight('offset') == pytest.approx(-3.16, rel=0.03)


def test_the_smallest_machine_runs_from_log_to_table(tmp_path, capsys):
    needed('kr300_axis1')
    assert main(['real-machines', 'kr300_axis1', '--first', '--out', str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert 'KUKA KR300, axis 1: A, then B' in printed and 'crashed' not in printed
    outcome, = json.loads((tmp_path / 'results.json').read_text())['outcomes']
    for one in outcome['bands']:
        assert 0 < one['final'] < one['torque'] and 0 < one['chosen'] < one['torque']
    assert (tmp_path / 'real_kr300_axis1.png').stat().st_size > 5000


def test_absent_recordings_are_skipped_with_a_reason(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert main(['real-machines', 'emps']) == 1
    assert f'skipped, {tmp_path}/emps/identification.csv is absent' in capsys.readouterr().out


def imported(folder, pattern, mapping):
    """Return real recordings as (Recording, ())."""
    mapping = ROOT / 'config' / mapping
    return [(import_csv(path, mapping).recording, ())
            for path in sorted((DATA / folder).glob(pattern))]


def assert_no_worse(found):
    """Raise if a joint predicts held-out torque or free motion worse than Coulomb + viscous."""
    for result in found.joints:
        errors = result.held_out
        assert errors.relative < 1.06 * errors.coulomb_viscous, result.joint
        assert errors.free_run_rms < 1.06 * errors.free_run_coulomb_viscous, result.joint


@real
def test_an_industrial_robot_is_predicted_no_worse_than_by_coulomb_and_viscous():
    recorded, other = ([(recording.of_joints(['axis1']), ())] for name in 'AB'
                       for recording, _ in imported('kr300', f'rec_{name}.csv',
                                                    'import_kr300.yaml'))
    found = identify(recorded, rigid_joints(['axis1']), holdouts=other, options=ALL)
    assert_no_worse(found)
    assert any(estimate.name == 'arm.axis1.stiffness' and 'not identifiable' in estimate.flags
               for estimate in found.joints[0].estimates)


@real
def test_a_servo_with_a_pendulum_is_predicted_no_worse_than_by_coulomb_and_viscous():
    fitted, others = (imported('bam_xl330', f'*kp{gain}.csv', 'import_bam_xl330.yaml')
                      for gain in (100, 400))
    found = identify(fitted, rigid_joints(fitted[0][0].joints), holdouts=others, options=ALL)
    assert_no_worse(found)
    gravity = next(estimate for estimate in found.joints[0].estimates
                   if estimate.name == 'arm.joint1.gravity_torque')
    assert 0.3 < gravity.value < 0.7  # 0.49 kg at 0.1 m and the arm that carries it


@real
def test_a_machine_is_answered_though_what_is_found_of_it_runs_away():
    """The motor hardly slows down before it slips: friction at rest is not in that motion."""
    machine = MACHINES['odri_motor']
    split = next(one for one in machine.splits if 'slip' in one.name)
    recordings = [machine.recording(piece) for piece in split.fitted]
    robot, _ = identified(machine, recordings)
    assert find_discrepancy(recordings, robot).robot is not None
