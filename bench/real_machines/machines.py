# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The machines: where their recordings are, what is believed and what is known of them."""

from dataclasses import dataclass, replace
import os
from pathlib import Path
from typing import NamedTuple

from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.schema.files import load_robot
import numpy as np

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
VARIABLE = 'GMS_FLEX_SHARED_DATA'
BAND = 8.0                     # of the low-pass: that of the tool's residual torque [Hz]


class Piece(NamedTuple):
    """A recording, or a share of it."""

    file: str
    begin: float = 0.0        # [s]
    end: float = np.inf       # [s]


class Split(NamedTuple):
    """Which recordings are fitted, and which are only predicted."""

    name: str
    fitted: tuple             # of Piece
    held_out: tuple


class Known(NamedTuple):
    """Something that an axis is known to have, and the effects of the catalogue that say so."""

    words: str
    effects: tuple            # of str: effects that differ by other motion only


@dataclass(frozen=True, kw_only=True)
class Machine:
    """One axis of a machine."""

    name: str  # for commands
    title: str  # for people
    folder: str  # of the recordings, in the shared data
    import_map: Path  # what their columns are
    joint: str  # which joint of them
    splits: tuple  # what is fitted and what is held out
    # file in robots/ that says what is known beforehand; '' if nothing: a rigid axis
    belief: str = ''
    # what identification finds, 'friction' or 'all': inertia and gravity as well
    estimate: str = 'all'
    gravity: bool = False  # whether it acts on the axis
    loaded: bool = False  # whether the load of the axis changes
    unit: str = 'N m'  # in which torques are reported
    factor: float = 1.0  # by which they are multiplied for it
    length: tuple = ('mrad', 1e3)  # likewise of angles in free runs
    # a second, higher band in which least squares and models are compared [Hz]; 0 for none
    wide: float = 0.0
    known: tuple = ()  # what is published of it

    @property
    def bands(self):
        """Return the bands of the low-pass [Hz]."""
        return (BAND, self.wide) if self.wide else (BAND,)

    def absent(self):
        """Return the first file that is not there, or None."""
        files = {piece.file for split in self.splits
                 for piece in (*split.fitted, *split.held_out)}
        return next((path for path in sorted(shared_data() / self.folder / file for file in files)
                     if not path.is_file()), None)

    def recording(self, piece):
        """Return a Piece as a Recording of the one joint, time from its beginning."""
        path = shared_data() / self.folder / piece.file
        recording = import_csv(path, self.import_map).recording.of_joints([self.joint])
        return between(recording, piece.begin, piece.end)

    @property
    def files(self):
        """Return the robot files that say what is known beforehand, tuple of Path."""
        return (HERE / 'robots' / self.belief,) if self.belief else ()

    def believed(self, recording):
        """Return what is known of the robot beforehand (RobotParams)."""
        return load_robot(self.files) if self.files else rigid_joints(recording.joints)


def shared_data():
    """Return the folder of the public recordings."""
    return Path(os.environ.get(VARIABLE, ROOT.parent / 'shared' / 'data'))


def between(recording, begin, end):
    """Return what a Recording has from ``begin`` to before ``end`` [s], time from 0."""
    inside = (recording.time >= begin) & (recording.time < end)
    if inside.all():
        return recording
    cut = recording.of_samples(inside)
    return replace(cut, time=cut.time - cut.time[0])


def halves(file, middle, begin=0.0, end=np.inf, name='halves'):
    """Return the Split of a recording into what is before and after ``middle`` [s]."""
    return Split(name, (Piece(file, begin, middle),), (Piece(file, middle, end),))


def _kr300(axis, import_map, **further):
    one, other = (Piece(f'rec_{part}.csv') for part in 'AB')
    return Machine(
        name=f'kr300_axis{axis}', title=f'KUKA KR300, axis {axis}', folder='kr300',
        import_map=import_map, joint=f'axis{axis}', loaded=True, wide=20.0,
        splits=(Split('A, then B', (one,), (other,)), Split('B, then A', (other,), (one,))),
        **further)


def _servo(motions, gains=(400, 100)):
    return tuple(Piece(f'{motion}_kp{gain}.csv') for motion in motions for gain in gains)


_MOTIONS = ('sin_time_square', 'lift_and_drop', 'sin_sin', 'up_and_down')
MACHINES = {machine.name: machine for machine in (
    Machine(
        name='emps', title='EMPS, slide with ball screw', folder='emps',
        import_map=HERE / 'maps' / 'emps.yaml', joint='slide', belief='emps.yaml', unit='N',
        length=('mm', 1e3), wide=40.0, known=(
            Known('low-speed shape', ('stribeck_error', 'low_speed_friction')),
            Known('ripple of the screw', ('torque_ripple',)),
            Known('delay', ('input_delay', 'actuator_lag', 'recording_delay'))),
        splits=(Split('identification, then pulses', (Piece('identification.csv'),),
                      (Piece('pulses.csv'),)),
                halves('identification.csv', 12.42, name='halves of identification'))),
    _kr300(1, ROOT / 'config' / 'import_kr300.yaml', belief='kr300_axis1.yaml',
           known=(Known('skew of the encoders', ('encoder_skew',)),)),
    _kr300(2, HERE / 'maps' / 'kr300_motor_side.yaml', gravity=True),
    _kr300(3, HERE / 'maps' / 'kr300_motor_side.yaml', gravity=True),
    Machine(
        name='xl330', title='Dynamixel XL330, pendulum', folder='bam_xl330',
        import_map=ROOT / 'config' / 'import_bam_xl330.yaml', joint='joint1', gravity=True,
        loaded=True, unit='mN m', factor=1e3, wide=20.0,
        known=(Known('friction by load', ('load_friction',)),),
        splits=(Split('two motions, then two others', _servo(_MOTIONS[:2]), _servo(_MOTIONS[2:])),
                Split('stiff gain, then soft', _servo(_MOTIONS, (400,)),
                      _servo(_MOTIONS, (100,))))),
    Machine(
        name='arts_friction_damper', title='ARTS friction damper', folder='arts_friction_damper',
        import_map=HERE / 'maps' / 'arts_friction_damper.yaml', joint='damper',
        belief='arts_friction_damper.yaml', estimate='friction', unit='N', length=('mm', 1e3),
        wide=40.0, known=(Known('backlash', ('friction_backlash',)),),
        splits=(Split('sine at 30 lb, then earthquake at 36 lb',
                      (Piece('sine_0.25hz_1in_30lb.csv'),), (Piece('earthquake_36lb.csv'),)),
                halves('sine_0.25hz_1in_30lb.csv', 14.0, name='halves of sine'))),
    Machine(
        name='odri_motor', title='ODRI motor', folder='odri_motor',
        import_map=HERE / 'maps' / 'odri_motor.yaml', joint='motor', belief='odri_motor.yaml',
        estimate='all', unit='mA', factor=1e3, wide=100.0,
        known=(Known('cogging', ('torque_ripple',)),),
        # the position slips by half a radian and more up to 8.77 s, the other's at 8.48 s
        splits=(Split('acceleration, then speed control', (Piece('acceleration.csv', 8.8),),
                      (Piece('speed_control.csv', 8.6),)),
                halves('acceleration.csv', 17.8, 8.8, name='halves of acceleration'),
                Split('speed control, before and after its slip',
                      (Piece('speed_control.csv', 0.0, 8.3),),
                      (Piece('speed_control.csv', 8.6, 14.9),)))))}
