# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Motions that may be recorded next, each within the limits of the joints."""

from collections.abc import Sequence
from typing import NamedTuple

from gms_flex_control.hardware.limits import Limits
from gms_flex_control.schema.node_keys import trajectory_keys
from gms_flex_control.schema.node_values import trajectory_from_values
from gms_flex_control.trajectory.polynomials import Trajectory
import numpy as np

_OF_LIMIT = 0.8        # share of each limit that a reference uses: the robot overshoots
_QUICK = 4.0           # velocity limits that a reference gains in a second
_SLOW, _CREEP = 2.5, 20.0  # times the shortest period or time that the limits allow
_APART = 1.3           # times the period of the joint before: joints are not in step
_SHORT = 0.15          # of the range: swings whose reversals are frequent
_CREEPING = 0.02       # of the range: swings within presliding and play
_HOLD = 0.6            # at each posture [s]
_FASTEST, _STEEPEST = 2.4609375, 9.3721  # peak rates of a move of degree 9 over unit time
_POSTURES = 6


class Candidate(NamedTuple):
    """One motion."""

    name: str
    words: str
    parameters: dict  # ``trajectory.*`` of trajectory_node

    def trajectory(self, joints: Sequence[str]) -> Trajectory:
        """Return the reference, its time from 0."""
        values = {key.name: key.default for key in trajectory_keys(joints)}
        return trajectory_from_values(values | self.parameters, joints)


def candidates(limits: Limits, joints: Sequence[str], pace: float = 1.0, seed: int = 0
               ) -> list[Candidate]:
    """
    Return motions of many kinds: swings, short, creeping and of single joints, and postures.

    Parameters
    ----------
    limits : Limits
        Of the robot; references use 80 % of range and velocity.
    joints : sequence of str
        Link names.
    pace : float
        Times as slow as the limits allow; torque may demand it.
    seed : int
        Of the postures.

    """
    reach = _OF_LIMIT * np.minimum(limits.upper, -limits.lower)
    several = 'all joints' if len(joints) > 1 else joints[0]
    found = [
        _swing('fast_swings', f'fast swings of {several}', reach, limits, joints, pace),
        _swing('slow_swings', f'slow swings of {several}', reach, limits, joints, _SLOW * pace),
        _swing('short_swings', f'short fast swings of {several}', _SHORT * reach, limits, joints,
               pace),
        _swing('creeping', f'slow reversals of {several} within a small range',
               _CREEPING * reach, limits, joints, _CREEP * pace),
        _postures('fast_postures', f'fast moves with holds at {_POSTURES} postures', reach,
                  limits, joints, pace, seed),
        _postures('slow_postures', f'slow moves with holds at {_POSTURES} postures', reach,
                  limits, joints, _SLOW * pace, seed)]
    if len(joints) > 1:
        found += [_swing(f'{joint}_alone', f'fast swings of {joint} alone, the others held',
                         np.where(np.arange(len(joints)) == j, reach, 0.0), limits, joints, pace)
                  for j, joint in enumerate(joints)]
    return found


def random_moves(limits: Limits, joints: Sequence[str], seed: int) -> Candidate:
    """Return moves through random postures, which designed motions are compared with."""
    reach = _OF_LIMIT * np.minimum(limits.upper, -limits.lower)
    return _postures('random', 'random moves', reach, limits, joints, 1.0, seed, 40)


def _swing(name, words, amplitude, limits, joints, slower):
    """Return sinusoids, the period of each joint `_APART` times that of the one before."""
    period = 2.0 * np.pi * slower * float(np.max(np.maximum(
        amplitude / (_OF_LIMIT * limits.velocity),
        np.sqrt(amplitude / (_OF_LIMIT * _QUICK * limits.velocity)))))
    parameters = {'trajectory.type': 'sinusoid', 'trajectory.ramp_time': 0.5 * period}
    for j, joint in enumerate(joints):
        parameters |= {f'trajectory.{joint}.amplitude': float(amplitude[j]),
                       f'trajectory.{joint}.period': float(period * _APART ** j)}
    return Candidate(name, words, parameters)


def _postures(name, words, reach, limits, joints, slower, seed, count=_POSTURES):
    """Return rest-to-rest moves through random postures, repeated to the end."""
    places = np.random.default_rng(seed).uniform(-reach, reach, (count, len(joints)))
    places = np.vstack([np.zeros(len(joints)), np.tile(places, (8, 1))])
    distance = np.abs(np.diff(places, axis=0)).max(axis=0)
    time = slower * np.max(np.maximum(
        _FASTEST * distance / (_OF_LIMIT * limits.velocity),
        np.sqrt(_STEEPEST * distance / (_OF_LIMIT * _QUICK * limits.velocity))))
    parameters = {'trajectory.type': 'via_points', 'trajectory.move_time': float(time),
                  'trajectory.hold_time': _HOLD}
    return Candidate(name, words, parameters | {
        f'trajectory.{joint}.points': places[:, j].tolist() for j, joint in enumerate(joints)})
