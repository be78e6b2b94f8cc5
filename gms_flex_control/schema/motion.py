# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The reference motion that a set of ``trajectory.*`` parameters describes."""

from gms_flex_control.errors import ConfigError, TrajectoryError
from gms_flex_control.schema.node_keys import trajectory_keys
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.segments import Trajectory


def trajectory_from_values(values: dict, joints) -> Trajectory:
    """
    Return the Trajectory chosen by ``trajectory.type``, its own time beginning at 0.

    Of schema.node_keys.trajectory_keys ``values`` may leave out those with a default. ConfigError,
    which names the type, if they make no trajectory.
    """
    values = {key.name: key.default for key in trajectory_keys(joints)} | values
    kind = values['trajectory.type']
    try:
        return _BUILDERS[kind](_Motion(values, joints))
    except TrajectoryError as error:
        raise ConfigError(f'trajectory.type {kind}: {error}') from error


class _Motion:
    """Short access to the parameters of one motion."""

    def __init__(self, values, joints):
        self._values, self._joints = values, joints

    def __getitem__(self, name):
        return self._values[f'trajectory.{name}']

    def each(self, name):
        """Return one parameter of every joint (list)."""
        return [self._values[f'trajectory.{joint}.{name}'] for joint in self._joints]

    def torques(self):
        """Return the amplitudes of a torque ramp; one at least is not zero."""
        torques = self.each('torque')
        if not any(torques):
            raise TrajectoryError('give trajectory.<joint>.torque [N m] of a joint at least')
        return torques

    def rows(self, name):
        """Return a list per joint as one of all joints per entry; as many of every joint."""
        columns = self.each(name)
        if len({len(column) for column in columns}) != 1 or not columns[0]:
            raise TrajectoryError(f'each joint needs the same number of {name}, got '
                                  f'{[len(column) for column in columns]}')
        return [list(row) for row in zip(*columns, strict=True)]

    def moved(self, trajectory):
        """Return a motion from zero as one from where it is to begin."""
        return trajectory.displaced(self.each('offset'))

    def held(self, trajectory):
        """Return a torque with what holds the arm against gravity."""
        return trajectory.displaced(self.each('bias'))


_BUILDERS = {
    'hold': lambda p: builders.hold([0.0 for _ in p.each('amplitude')]),
    'sinusoid': lambda p: builders.sinusoid(p.each('amplitude'), p.each('period'),
                                            phase=p.each('phase'), ramp_time=p['ramp_time']),
    'polynomial': lambda p: builders.polynomial(p.each('amplitude'), p['move_time'],
                                                p['hold_time'], p['repeats']),
    'via_points': lambda p: builders.via_points(p.rows('points'), p['move_time'], p['hold_time']),
    'constant_velocity': lambda p: p.moved(builders.constant_velocity(
        p.each('velocity'), p['travel'], settle_time=p['ramp_time'])),
    'fourier': lambda p: p.moved(builders.fourier(
        p.rows('sine'), p.rows('cosine'), p.each('period')[0], repeats=p['repeats'],
        ramp_time=p['ramp_time'])),
    'velocity_levels': lambda p: p.moved(builders.velocity_levels(
        p.rows('velocities'), p['durations'], settle_time=p['ramp_time'])),
    'torque_ramp': lambda p: p.held(builders.torque_ramp(p.torques(), p['rate'],
                                                         p['repeats'])),
    'torque_levels': lambda p: p.held(builders.torque_levels(p.rows('levels'), p['rate'])),
    'sliding': lambda p: p.moved(builders.sliding(
        p.each('velocity'), p['modulation'], p.each('period')[0], p['duration'],
        settle_time=p['ramp_time'])),
}
