# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Friction and motor inertia of a real six-axis arm with a coupled wrist, beside published values.

    .venv/bin/python -m bench real-arm

The Staubli TX40 of github.com/thanhndv212/figaroh-examples: its folder examples/staubli_tx40/data
(curr_data.csv, pos_read_data.csv) and urdf/tx40_mdh_modified.urdf are looked for in tx40 of the
shared data. The published model has viscous friction and inertia of motor 6, which turns with
joint 5 as well, in two places: with the sum of both joints, and in the numbers of joints 5 and 6.
Here each stands once, so that of motor 6 comes off the published ones of both joints.
"""

from functools import partial
import json
from pathlib import Path
import tempfile

from bench.real_machines.machines import shared_data
from gms_flex_control.answer import align
from gms_flex_control.cli.options import add_verb, option, Verb
from gms_flex_control.compiled import in_one_thread
from gms_flex_control.data.conditions import Conditions, with_conditions
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import low_pass
from gms_flex_control.dynamics import chain
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import write_text
from gms_flex_control.identification.arm_differences import plain_friction
from gms_flex_control.identification.arm_regression import fit_base_parameters
from gms_flex_control.identification.segments import drive_sides, filled, segments_of
from gms_flex_control.schema.files import load_robot
import numpy as np

_SOURCE = 'thanhndv212/figaroh-examples'
FILES = 'curr_data.csv', 'pos_read_data.csv', 'tx40_mdh_modified.urdf'
_JOINTS = tuple(f'joint_{k}' for k in range(1, 7))
_RATIO = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])  # of gears; currents are N m of motors
_ZERO = np.array([0.0, -0.5, 0.5, 0.0, 0.0, 0.0]) * np.pi
_PERIOD, _MEAN_OF = 2e-4, 5          # of the data [s]; samples taken together
_COULOMB = (7.14, 8.26, 6.34, 2.48, 3.03, 0.282, 1.95)  # published [N m], motor 6 last
_VISCOUS = (8.05, 5.53, 1.97, 1.11, 1.86, 0.65, 0.616)  # [N m s/rad]
_INERTIA = (0.362, 0.362, 0.0988, 0.0313, 0.0468, 0.0105, 0.00964)  # of motors [kg m^2]
_POINT = 'ixx="0.000" ixy="0.000" ixz="0.000" iyy="0.000" iyz="0.000" izz="0.000"'
_SMALL = 'ixx="0.0004" ixy="0.0" ixz="0.0" iyy="0.0004" iyz="0.0" izz="0.0001"'
_SLOWEST = 0.05                      # of the rms rate: slower does not count


def published() -> np.ndarray:
    """Return Coulomb, viscous friction and inertia (3, 7), each of motor 6 in one place only."""
    table = np.array([_COULOMB, _VISCOUS, _INERTIA])
    table[1:, 4:6] -= table[1:, 6:]
    table[2, 5] = table[2, 6]
    return table


def believed(urdf: Path, folder: Path):
    """Return the robot of the URDF, the point masses in it made bodies."""
    (folder / 'arm.urdf').write_text(urdf.read_text().replace(_POINT, _SMALL))
    arm, friction = [], []
    for name, coulomb, viscous, inertia in zip(_JOINTS, _COULOMB, _VISCOUS, _INERTIA,
                                               strict=False):
        arm.append(f'      {name}: {{motor_inertia: {inertia}, stiffness: .inf}}')
        curve = (f'{{static: {1.1 * coulomb}, coulomb: {coulomb}, velocity: 0.05, '
                 f'viscous: {viscous}}}')
        friction.append(f'      {name}: {{forward: {curve}, backward: {curve}, '
                        'stiffness: [1000.0], weight: [1.0], attraction: 20.0}')
    (folder / 'robot.yaml').write_text('\n'.join([
        '/**:', '  ros__parameters:', f'    joints: [{", ".join(_JOINTS)}]',
        "    motors: ['', '', '', '', '', '']", '    arm:', '      kind: urdf',
        '      urdf: arm.urdf', '      tip: link_6', '      gravity_vector: [0.0, 0.0, -9.81]',
        *arm, '    friction:', *friction,
        '    encoder: {counts: 0.0, noise: 0.0, velocity_cutoff: 100.0}']) + '\n')
    return load_robot(folder / 'robot.yaml')


def recording_of(folder: Path) -> Recording:
    """Return the recording: angles of joints, torques of the motors at their joints."""
    torque, turned = (np.loadtxt(folder / name, delimiter=',', skiprows=1) for name in FILES[:2])
    gears = np.diag(_RATIO)
    gears[5, 4] = _RATIO[5]
    angle, torque = (one[:len(one) // _MEAN_OF * _MEAN_OF].reshape(-1, _MEAN_OF, 6).mean(axis=1)
                     for one in (turned @ np.linalg.inv(gears).T + _ZERO, torque * _RATIO))
    return with_conditions(Recording(
        joints=_JOINTS, time=_MEAN_OF * _PERIOD * np.arange(len(angle)), source='TX40',
        q_link=angle, tau_motor=np.roll(torque, 1, axis=0)),
        Conditions(coupling={'joint_6': {'joint_5': 1.0}}))


def found_in(recording: Recording, robot) -> np.ndarray:
    """Return Coulomb, viscous friction and motor inertia (3, 7), the last of motor 6."""
    fit, found = fit_base_parameters([recording], robot), np.zeros((3, 7))
    coupled, last = fit.differences.coupled, 5
    found[:2, 6], found[2, :6], found[2, 6] = (
        coupled.friction[last], coupled.inertia, coupled.inertia[last])
    left, rates = [], []
    for segment in segments_of(recording, robot, drive_sides(recording, robot)):
        clear = fit.differences.cleared(segment, 0)
        motion = map(np.ascontiguousarray, (filled(clear.angle), clear.rate, clear.acceleration))
        left.append(low_pass(clear.torque - chain.inverse_dynamics(*motion, fit.arm),
                             clear.window))
        rates.append(clear.rate)
    left, rates = np.concatenate(left), np.concatenate(rates)
    for j, rate in enumerate(rates.T):
        moving = np.abs(rate) > _SLOWEST * np.sqrt(np.mean(rate ** 2))
        columns = np.column_stack([plain_friction(rate), np.ones(len(rate))])
        found[:2, j] = np.linalg.lstsq(columns[moving], left[moving, j], rcond=None)[0][:2]
    return found


VERB = Verb(
    'real-arm', lambda args: run(args),
    'friction of a real arm with a coupled wrist, beside published values',
    'Identify a Staubli TX40 from its public recording; print friction and motor inertia beside '
    f'published values. Files are looked for in {shared_data() / "tx40"}.', (
        option('--data', type=Path, metavar='DIR', help='folder of the files instead'),
        option('--out', metavar='FILE', help='the numbers as JSON')), ())
add_parser = partial(add_verb, VERB)


def run(args) -> int:
    """Print the table; return 0, or 1 if a file is absent."""
    data = args.data or shared_data() / 'tx40'
    absent = next((data / name for name in FILES if not (data / name).is_file()), None)
    if absent and args.data:
        raise ConfigError(f'--data: {absent} is absent; it is in github.com/{_SOURCE}')
    if absent:
        print(f'skipped: {absent} is absent')
        return 1
    with tempfile.TemporaryDirectory() as folder, in_one_thread():
        found = found_in(recording_of(data), believed(data / FILES[2], Path(folder)))
    names, reported = (*_JOINTS, 'motor 6, with joints 5 + 6'), published()
    if args.out:
        write_text(args.out, json.dumps({'names': names, 'found': found.tolist(),
                                         'published': reported.tolist()}, indent=1) + '\n')
    print(align(
        ['', *(f'{what}{kind}' for what in ('Coulomb [N m]', 'viscous [N m s/rad]',
                                            'motor inertia [kg m^2]')
               for kind in ('', ', published'))],
        [[name, *(f'{value:.3g}' for pair in zip(found[:, j], reported[:, j], strict=True)
                  for value in pair)] for j, name in enumerate(names)]))
    return 0
