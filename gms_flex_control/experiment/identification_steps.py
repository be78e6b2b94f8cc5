# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The steps of each identification experiment, planned to keep the limits of every joint."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from gms_flex_control.dynamics import chain
from gms_flex_control.errors import ConfigError
from gms_flex_control.friction import steady_friction
from gms_flex_control.schema.build import trajectory_from_values
import numpy as np

_STEEPEST = 2.1875  # acceleration of a change of velocity by 1 in unit time
_FASTEST = 0.9      # of the velocity limit
_SLOWEST = 1.0 / 3  # of v_s
_SHORTEST_DWELL = 0.1  # at a constant velocity [s]
_LEAST_PERIODS = 3  # of a sliding step
_BROKEN_AWAY = 0.6  # of the ramp's duration, when break-away is expected
BRAKING_TIME = 0.5  # after an open-loop torque [s]


class Step(NamedTuple):
    """One step of the experiment."""

    name: str          # unique in the plan
    phase: str         # constant_velocity, break_away, presliding, sliding or approach
    joint: str         # that is identified
    kind: str          # 'motion': follow the reference; 'torque': apply it as open-loop torque;
    #                    'approach': go to ``end``; 'relax': let the springs unload
    trajectory_parameters: dict  # for the trajectory node
    value: float       # signed velocity [rad/s] or torque amplitude [N m]
    duration_estimate: float     # [s]
    begin: tuple | None = None   # link angles [rad]; None where they depend on the robot
    end: tuple | None = None
    travel: float = 0.0          # the step ends once the joint has moved so far; 0 never [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class StepLimits:
    """Limits of each joint, and what is believed of its friction; all (n_joints,)."""

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    slowest: np.ndarray
    fastest: np.ndarray
    static: np.ndarray
    weakest_static: np.ndarray
    stribeck_velocity: np.ndarray

    @classmethod
    def read(cls, flat: dict, robot, gains) -> 'StepLimits':
        """Return the limits of checked parameters, zeros replaced by what they stand for."""
        names = ('lower', 'upper', 'velocity', 'acceleration', 'torque', 'slowest', 'fastest',
                 'static', 'stribeck_velocity')
        own = {name: np.array([flat[f'identification.{joint}.{name}'] for joint in robot.joints])
               for name in names}
        for joint, lower, upper in zip(robot.joints, own['lower'], own['upper'], strict=True):
            if not lower + 2 * flat['identification.margin'] < upper:
                raise ConfigError(f'identification.{joint}.upper must be above lower by more '
                                  f'than two margins, got {lower:g} to {upper:g} rad with '
                                  f'identification.margin {flat["identification.margin"]:g}')
        forward, backward = robot.friction.forward, robot.friction.backward

        def default(name, value):
            own[name] = np.where(own[name] > 0.0, own[name], value)

        own['weakest_static'] = np.where(own['static'] > 0.0, own['static'],
                                         np.minimum(forward.static, backward.static))
        default('static', np.maximum(forward.static, backward.static))
        default('stribeck_velocity', 0.5 * (forward.velocity + backward.velocity))
        default('torque', gains.torque_limit)
        own['torque'] = np.minimum(own['torque'], gains.torque_limit)
        default('slowest', _SLOWEST * own['stribeck_velocity'])
        default('fastest', _FASTEST * own['velocity'])
        return cls(**own)


class Planner:
    """Plans steps for a robot as believed, from checked ``identification.*`` parameters."""

    def __init__(self, flat, robot, limits):
        self._flat, self._robot, self._limits = flat, robot, limits
        self._margin = flat['identification.margin']
        self._rest = 0.5 * (limits.lower + limits.upper)
        self._friction = robot.friction
        counts = robot.encoder.counts
        self._count = 2.0 * np.pi / float(counts) if counts > 0 else 0.0

    def __getitem__(self, name):
        """Return the value of a key below ``identification``."""
        return self._flat[f'identification.{name}']

    def plan(self, experiment: str, joint: str) -> Iterator[Step]:
        """Yield each Step of one experiment on one joint."""
        yield from getattr(self, f'_{experiment}')(joint, self._robot.joints.index(joint))

    def _constant_velocity(self, joint, j):
        slowest, fastest = self._limits.slowest[j], self._limits.fastest[j]
        if not slowest < fastest:
            raise ConfigError(f'identification.{joint}.slowest is {slowest:g} rad/s, which is '
                              f'not below the fastest, {fastest:g}')
        speeds = np.geomspace(slowest, fastest, self['speeds'])
        for speed in speeds[::-1]:
            for repeat in range(self['repeats']):
                for sign, mark in ((1.0, '+'), (-1.0, '-')):
                    name = (f'constant_velocity/{joint}/{mark}{speed:.4g}'
                            f'/{repeat + 1}of{self["repeats"]}')
                    yield self._stroke(name, joint, j, sign * speed)

    def _stroke(self, name, joint, j, velocity):
        """Return a stroke at one velocity; a slow one begins with faster sliding."""
        speed, sign = abs(velocity), np.sign(velocity)
        lead_speed = min(self['lead_in_speed'], 0.5 * self._limits.velocity[j])
        settle = self._settle(j, max(speed, lead_speed))
        levels, durations = [velocity], [self._dwell(name, joint, speed)]
        if speed < lead_speed and self['lead_in'] > 0.0:
            levels = [sign * lead_speed, velocity]
            durations.insert(0, max(_SHORTEST_DWELL, self['lead_in'] / lead_speed - settle))
        need, room = np.abs(levels) @ (np.array(durations) + settle), self._room(j)
        if need > room:
            shortest = min(_SHORTEST_DWELL, durations[-1])
            durations[-1] -= (need - room) / speed
            if len(levels) > 1 or durations[-1] < shortest:
                self._refuse(joint, name, f'needs {need:.3g} rad, the range within the margins '
                             f'is {room:.3g} rad', 'widen lower and upper, allow more '
                             'acceleration, or lower fastest or lead_in')
        values = {'trajectory.type': 'velocity_levels', 'trajectory.ramp_time': float(settle),
                  'trajectory.durations': [float(duration) for duration in durations]}
        for i, other in enumerate(self._robot.joints):
            values[f'trajectory.{other}.velocities'] = [
                float(level) if i == j else 0.0 for level in levels]
        return self._motion(name, 'constant_velocity', joint, j, values, velocity)

    def _dwell(self, name, joint, speed):
        """Return how long a velocity is held [s]."""
        dwell = max(self['dwell_time'], self['counts'] * self._count / speed)
        if dwell > self['longest_dwell']:
            self._refuse(joint, name, f'needs {dwell:.3g} s for {self["counts"]:g} encoder '
                         f'counts, the limit longest_dwell is {self["longest_dwell"]:g} s',
                         f'raise it, or identification.{joint}.slowest')
        return dwell

    def _sliding(self, joint, j):
        settle_of = 1.0 + self['modulation']
        for multiple in self['sliding_speeds']:
            mean = multiple * self._limits.stribeck_velocity[j]
            for sign, mark in ((1.0, '+'), (-1.0, '-')):
                name = f'sliding/{joint}/{mark}{mean:.4g}'
                settle = self._settle(j, settle_of * mean)
                swing = mean * self['modulation'] * self['sliding_period'] / np.pi
                longest = ((self._room(j) - swing) / mean
                           - settle * (1.0 + 0.5 * self['modulation']))
                duration = min(self['sliding_duration'], longest)
                if duration < _LEAST_PERIODS * self['sliding_period']:
                    self._refuse(joint, name, f'has room for {max(duration, 0.0):.3g} s of '
                                 f'sliding, needs {_LEAST_PERIODS} periods of '
                                 f'{self["sliding_period"]:g} s', 'widen lower and upper, or '
                                 'lower sliding_speeds or sliding_period')
                values = {'trajectory.type': 'sliding', 'trajectory.duration': float(duration),
                          'trajectory.ramp_time': float(settle),
                          'trajectory.modulation': self['modulation']}
                for i, other in enumerate(self._robot.joints):
                    values[f'trajectory.{other}.period'] = self['sliding_period']
                    values[f'trajectory.{other}.velocity'] = float(sign * mean if i == j else 0)
                yield self._motion(name, 'sliding', joint, j, values, sign * mean)

    def _settle(self, j, change):
        return max(self['settle_time'], _STEEPEST * change / self._limits.acceleration[j])

    def _room(self, j):
        return self._limits.upper[j] - self._limits.lower[j] - 2 * self._margin

    def _motion(self, name, phase, joint, j, values, value):
        """Return the step with its stroke in the middle of the range, its limits checked."""
        joints = self._robot.joints
        values |= {f'trajectory.{other}.offset': 0.0 for other in joints}
        trajectory = trajectory_from_values(values, self._robot.joints)
        time = np.linspace(0.0, trajectory.end, 400)
        angle = trajectory.sample(time)[:, 0, j]
        offset = self._rest.copy()
        offset[j] -= 0.5 * (angle.min() + angle.max())
        values |= {f'trajectory.{other}.offset': float(offset[i])
                   for i, other in enumerate(joints)}
        samples = trajectory_from_values(values, self._robot.joints).sample(time)
        self._check(joint, name, j, samples)
        return Step(name, phase, joint, 'motion', values, float(value),
                    trajectory.end + self['rest_time'], tuple(samples[0, 0].tolist()),
                    tuple(samples[-1, 0].tolist()))

    def _check(self, joint, name, j, samples):
        """Refuse a motion beyond a limit; ``samples`` (T, 5, n)."""
        limits, angle = self._limits, samples[:, 0, j]
        for value, limit, beyond in (
                (angle.min(), limits.lower[j] + self._margin, -1.0),
                (angle.max(), limits.upper[j] - self._margin, 1.0)):
            if beyond * (value - limit) > 1e-6:
                self._refuse(joint, name, f'reaches {value:.4g} rad, the limit within the '
                             f'margin is {limit:.4g} rad', 'widen lower and upper')
        for row, kind, unit, limit in ((1, 'velocity', 'rad/s', limits.velocity[j]),
                                       (2, 'acceleration', 'rad/s^2', limits.acceleration[j])):
            value = np.abs(samples[:, row, j]).max()
            if value > limit * (1.0 + 1e-3):
                self._refuse(joint, name, f'reaches {value:.4g} {unit}, the limit of '
                             f'{kind} is {limit:.4g} {unit}', f'raise identification.{joint}.'
                             f'{kind} or plan a slower step')
        q, dq, ddq = np.moveaxis(samples[::8, :3], 1, 0)
        arm = self._robot.arm
        torque = np.abs(chain.inverse_dynamics(q, dq, ddq, arm) + np.where(
            arm.rigid, 0.0, arm.motor_inertia) * ddq + steady_friction(dq, self._friction)).max(
                axis=0)
        for i, other in enumerate(self._robot.joints):
            if torque[i] > limits.torque[i]:
                self._refuse(joint, name, f'needs {torque[i]:.3g} N m of the motor of {other}, '
                             f'the limit is {limits.torque[i]:.3g} N m', 'lower acceleration or '
                             'velocity, or raise torque and gains.*.torque_limit')

    def _break_away(self, joint, j):
        top = self['break_away_level'] * self._limits.static[j]
        for repeat in range(self['break_away_repeats']):
            for sign, mark in ((1.0, '+'), (-1.0, '-')):
                name = f'break_away/{joint}/{mark}{top:.4g}/{repeat + 1}of' \
                       f'{self["break_away_repeats"]}'
                yield self._open_loop(name, 'break_away', joint, j, [sign * top], sign * top,
                                      self._rest, self['break_away_travel'])

    def _presliding(self, joint, j):
        room = 0.5 * self._room(j)
        places = self['presliding_places']
        shift = min(self['shift'], room / (places * len(self['presliding_levels'])))
        for k, level in enumerate(self['presliding_levels']):
            top = level * self._limits.weakest_static[j]
            inner = self['minor_loop'] * top
            cycle = [top, -inner, 0.5 * inner, -top, inner, -0.5 * inner]
            if inner == 0.0:
                cycle = [top, -top]
            for number in range(places):
                place = self._rest.copy()
                place[j] += (places * k + number) * shift
                yield self._open_loop(
                    f'presliding/{joint}/{top:.4g}/{number + 1}of{places}', 'presliding', joint,
                    j, [*cycle * self['presliding_cycles'], top], top, place,
                    self['presliding_travel'])

    def _open_loop(self, name, phase, joint, j, levels, value, place, travel):
        rate = self['torque_rate'] * self._limits.static[j]
        bias = chain.inverse_dynamics(place, 0.0, 0.0, self._robot.arm)  # gravity's
        values = {'trajectory.type': 'torque_levels', 'trajectory.rate': float(rate),
                  'trajectory.approach_time': BRAKING_TIME}
        for i, other in enumerate(self._robot.joints):
            values[f'trajectory.{other}.levels'] = [
                float(level) if i == j else 0.0 for level in levels]
            values[f'trajectory.{other}.bias'] = float(bias[i])
            values[f'trajectory.{other}.travel'] = float(travel) if i == j else 0.0
        need = np.abs(bias)
        need[j] += np.max(np.abs(levels))
        for i, other in enumerate(self._robot.joints):
            if need[i] > self._limits.torque[i]:
                self._refuse(joint, name, f'needs {need[i]:.3g} N m of the motor of {other}, the '
                             f'limit is {self._limits.torque[i]:.3g} N m', 'raise torque and '
                             'gains.*.torque_limit, or lower the level')
        duration = trajectory_from_values(values, self._robot.joints).end
        if phase == 'break_away':
            duration *= 0.5 * _BROKEN_AWAY
        return Step(name, phase, joint, 'torque', values, float(value),
                    duration + BRAKING_TIME + self['rest_time'], tuple(place.tolist()), None,
                    travel)

    def _refuse(self, joint, name, finding, way_out):
        raise ConfigError(f'identification.{joint}: step {name} {finding}; {way_out}')
