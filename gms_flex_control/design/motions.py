# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Motions that may be recorded next, each within the limits of the joints."""

from collections.abc import Sequence
from typing import NamedTuple

from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.arm import Body
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema.build import trajectory_from_values
from gms_flex_control.schema.keys import trajectory_keys
from gms_flex_control.trajectory.polynomials import Trajectory
import numpy as np

APPROACH = 2.0         # to the beginning of a motion, and to rest: of the trajectory node [s]
_OF_LIMIT = 0.8        # share of each limit that a reference uses: the robot overshoots
QUICK, _QUICKEST = 4.0, 8.0  # velocity limits that moves, and swings, gain in a second
_SLOW, _CREEP = 2.5, 20.0  # times the shortest period or time that the limits allow
_APART = 1.3           # times the period of the joint before: joints are not in step
_MEDIUM, _SHORT, _TINY = 0.4, 0.15, 0.05  # of the range: the shorter, the quicker they reverse
_CREEPING = 0.02       # of the range: swings within presliding and play
_HOLD = 0.6            # at each posture [s]
_FASTEST, _STEEPEST = 2.4609375, 9.3721  # peak rates of a move of degree 9 over unit time
_POSTURES, _STROKES = 6, 5
_HANGING = 2.0         # of a person, to hang a weight at the tip [min]
_LOADED = 'medium_swings', 'tones', 'fast_swings', 'slow_swings', 'slow_postures'  # with it
_TONES, _PERIOD, _LONGEST = 12, 6.0, 120.0  # harmonics of tones, and their period; of any [s]


class Candidate(NamedTuple):
    """One motion."""

    name: str
    words: str
    parameters: dict  # ``trajectory.*`` of trajectory_node
    load: Body | None = None  # that a person hangs at the tip before, beside what is carried
    minutes: float = 0.0      # that this takes

    def trajectory(self, joints: Sequence[str]) -> Trajectory:
        """Return the reference, its time from 0."""
        values = {key.name: key.default for key in trajectory_keys(joints)}
        return trajectory_from_values(values | self.parameters, joints)


def candidates(limits: Limits, joints: Sequence[str], pace: float = 1.0,
               stuck: np.ndarray | None = None) -> list[Candidate]:
    """
    Return motions of many kinds: swings, tones, strokes, moves, of all joints and of single ones.

    They use 80 % of range and velocity, ``pace`` times as slow as the limits allow, since torque
    may demand it. ``stuck`` (n,) are amplitudes at which friction holds every link, from
    `below_break_away` [rad].
    """
    reach = _reach(limits, joints)
    several = 'all joints' if len(joints) > 1 else joints[0]

    def swing(name, words, amplitude, slower=1.0):
        return _swing(name, words, amplitude, limits, joints, slower * pace)
    found = [
        swing('short_swings', f'short fast swings of {several}', _SHORT * reach),
        swing('medium_swings', f'medium fast swings of {several}', _MEDIUM * reach),
        _tones('tones', f'chirps of {several}, each of many tones', reach, limits, joints, pace),
        swing('fast_swings', f'wide fast swings of {several}', reach),
        random_moves(limits, joints, 0, pace),
        swing('tiny_swings', f'tiny quick swings of {several}', _TINY * reach),
        swing('slow_swings', f'wide slow swings of {several}', reach, _SLOW),
        _strokes('strokes', f'strokes of {several}, each shorter and slower than the last',
                 reach, limits, joints, pace),
        swing('creeping', f'slow reversals of {several} within a small range',
              _CREEPING * reach, _CREEP),
        *([] if stuck is None else [swing(
            'below_break_away', f'slow ramps of {several} up to half of break-away',
            np.minimum(stuck, _CREEPING * reach), 3.0 * _CREEP)]),
        _postures('fast_postures', f'fast moves with holds at {_POSTURES} postures', reach,
                  limits, joints, pace, 1),
        _postures('slow_postures', f'slow moves with holds at {_POSTURES} postures', reach,
                  limits, joints, _SLOW * pace, 0)]
    for j in np.flatnonzero(reach) if len(joints) > 1 else ():
        joint = joints[j]
        alone = np.where(np.arange(len(joints)) == j, reach, 0.0)
        found += [swing(f'{joint}_alone', f'wide fast swings of {joint} alone, the others held',
                        alone),
                  swing(f'{joint}_alone_short', f'short fast swings of {joint} alone, the '
                        'others held', _SHORT * alone)]
    return found


def below_break_away(robot: RobotParams) -> np.ndarray:
    """Return amplitudes (n,) at which friction gives half of what it breaks away at [rad]."""
    friction = robot.friction
    return 0.5 * np.minimum(friction.forward.static, friction.backward.static
                            ) / friction.stiffness.sum(axis=-1)


def by_hand(motions: Sequence[Candidate], weight: float) -> list[Candidate]:
    """Return motions once more, with a weight [kg] that a person hangs at the tip before."""
    return [one._replace(
        name=f'{one.name}_with_weight', minutes=_HANGING, load=Body(
            weight, np.zeros(3), np.zeros((3, 3))),
        words=f'{one.words}, after {weight:g} kg are hung at the tip (by hand, {_HANGING:g} min)')
        for one in motions if one.name in _LOADED]


def random_moves(limits: Limits, joints: Sequence[str], seed: int, pace: float = 1.0) -> Candidate:
    """Return moves through random postures, which designed motions are compared with."""
    return _postures('random_moves', 'moves through random postures', _reach(limits, joints),
                     limits, joints, pace, seed, 40)


def _reach(limits, joints):
    """Return the amplitudes about zero that references may have (n,); 0 at an end of the range."""
    reach = _OF_LIMIT * np.minimum(limits.upper, -limits.lower) + 0.0  # never -0
    for joint, one in zip(joints, reach, strict=True):
        if one < 0.0 or not reach.any():
            raise ConfigError(f'limits.{joint}: motions swing about zero, which lower and upper '
                              'leave out; let its angle be zero within them (arm.offset)')
    return reach


def _swing(name, words, amplitude, limits, joints, slower):
    """Return sinusoids, the period of each joint `_APART` times that of the one before."""
    period = 2.0 * np.pi * slower * float(np.max(np.maximum(
        amplitude / (_OF_LIMIT * limits.velocity),
        np.sqrt(amplitude / (_OF_LIMIT * _QUICKEST * limits.velocity)))))
    parameters = {'trajectory.type': 'sinusoid', 'trajectory.ramp_time': 0.5 * period}
    for j, joint in enumerate(joints):
        parameters |= {f'trajectory.{joint}.amplitude': float(amplitude[j]),
                       f'trajectory.{joint}.period': float(period * _APART ** j)}
    return Candidate(name, words, parameters)


def _tones(name, words, reach, limits, joints, slower):
    """Return a Fourier series, a chirp per period (Schroeder 1970), as fast as limits allow."""
    order = np.arange(1, _TONES + 1)[:, None]
    turn = 2.0 * np.pi * order[:, :, None] * np.linspace(0.0, 1.0, 400)
    phase = order * (np.pi / _TONES * (order - 1) + np.arange(len(joints)))
    period = _PERIOD * slower

    def peak(power):  # of the derivative of this order (n,)
        rate = (2.0 * np.pi * order / period) ** power / order
        return np.abs(np.sum(rate[:, :, None] * np.sin(
            turn + phase[:, :, None] + 0.5 * np.pi * power), axis=0)).max(axis=1)
    size = np.minimum.reduce([
        reach / peak(0), _OF_LIMIT * limits.velocity / peak(1) / slower,
        _OF_LIMIT * _QUICKEST * limits.velocity / peak(2) / slower ** 2])
    parameters = {'trajectory.type': 'fourier', 'trajectory.ramp_time': 1.0,
                  'trajectory.repeats': int(np.ceil(_LONGEST / period))}
    for j, joint in enumerate(joints):
        parameters |= {f'trajectory.{joint}.period': float(period), **{
            f'trajectory.{joint}.{name}': (size[j] / order[:, 0] * of(phase[:, j])).tolist()
            for name, of in (('sine', np.cos), ('cosine', np.sin))}}
    return Candidate(name, words, parameters)


def _postures(name, words, reach, limits, joints, slower, seed, count=_POSTURES):
    """Return rest-to-rest moves through random postures, repeated to the end."""
    places = np.random.default_rng(seed).uniform(-reach, reach, (count, len(joints)))
    return _moves(name, words, np.tile(places, (8, 1)), limits, joints, slower, _HOLD)


def _strokes(name, words, reach, limits, joints, slower):
    """Return strokes to and fro in equal times, each shorter than the one before."""
    share = np.arange(2 * _STROKES, 0, -1) / (2 * _STROKES)
    places = np.outer(share * np.tile([1.0, -1.0], _STROKES), reach)
    return _moves(name, words, np.tile(places, (8, 1)), limits, joints, slower, 0.0)


def _moves(name, words, places, limits, joints, slower, hold):
    """Return rest-to-rest moves of equal times from zero through ``places`` (K, n)."""
    places = np.vstack([np.zeros(len(joints)), places])
    distance = np.abs(np.diff(places, axis=0)).max(axis=0)
    time = slower * np.max(np.maximum(
        _FASTEST * distance / (_OF_LIMIT * limits.velocity),
        np.sqrt(_STEEPEST * distance / (_OF_LIMIT * QUICK * limits.velocity))))
    parameters = {'trajectory.type': 'via_points', 'trajectory.move_time': float(time),
                  'trajectory.hold_time': hold}
    return Candidate(name, words, parameters | {
        f'trajectory.{joint}.points': places[:, j].tolist() for j, joint in enumerate(joints)})
