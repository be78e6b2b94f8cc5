# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What was found of the arm as estimates with intervals, and what these data cannot tell."""

from gms_flex_control.identification import axis_ripple
from gms_flex_control.identification.arm_fit import (
    axis_numbers,
    combined,
    CONSTANT,
    is_chain,
)
from gms_flex_control.identification.chain_fit import base_estimates
from gms_flex_control.identification.result import CONFIDENT, Estimate, Interval
import numpy as np

_SLIGHT = 0.1      # of the torque: an inertia that takes less is not to be believed
_UNKNOWN = Interval(np.nan, np.nan)
_WIDE = 0.5         # half an interval this large a part of the value tells nothing
_TELLS_INERTIA = 'faster changes of speed tell it'
_TELLS_GRAVITY = 'motion over a wider range of angles tells it'
_TELLS_MOTOR = ('a motion that makes the motor swing against the link tells it, both encoders '
                'sampled at one time')
_TELLS_CONSTANT = ('a constant torque is told from friction by motion both ways at the same '
                   'angles and speeds')
_SCALE_NOTE = ('all torques, stiffnesses and inertias go with the scale of the recorded torque; '
               'these data cannot tell it, a known mass added to the link would')


def arm_estimates(robot, arm_fit, thetas, spreads):
    """
    Return the Estimates of the arm, a tuple per joint.

    Parameters
    ----------
    robot, arm_fit, thetas, spreads
        As `folded`.

    Returns
    -------
    list of tuple of Estimate
        Those of the arm as a whole with the first joint.

    """
    rows = [[] for _ in thetas]
    if is_chain(robot.arm):
        values, covariance = combined(robot.arm, arm_fit, thetas, spreads)
        told = np.zeros(len(values))
        for numbers, spread in zip(arm_fit.numbers, spreads, strict=True):
            told[numbers] = np.maximum(told[numbers], spread.told[-len(numbers):])
        rows[0] += base_estimates(values, covariance, told, robot.n_joints,
                                  any(arm_fit.has_gravity))
    for j, (theta, spread) in enumerate(zip(thetas, spreads, strict=True)):
        name = f'arm.{robot.joints[j]}'
        if not is_chain(robot.arm):
            rows[j] += _axis_rows(robot, arm_fit, j, theta, spread, name)
        if arm_fit.motors[j] is not None:
            rows[j] += _motor_rows(arm_fit.motors[j], name, bool(robot.arm.rigid[j]))
    rows[0].append(Estimate('arm.torque_scale', '', 1.0, _UNKNOWN, ('not identifiable',),
                            _SCALE_NOTE))
    return [tuple(row._replace(interval=_UNKNOWN) if row.flags else row for row in part)
            for part in rows]


def _axis_rows(robot, arm_fit, joint, theta, spread, name):
    scale, numbers = arm_fit.units[joint], arm_fit.numbers[joint]
    if not len(numbers):
        return []
    at = len(spread.covariance) - len(scale)
    values = axis_numbers(robot.arm, arm_fit, joint, theta)[numbers]
    covariance = spread.covariance[at:, at:] * np.outer(scale, scale)
    error = np.sqrt(np.diag(covariance))
    rows = [_row(f'{name}.inertia', 'kg m^2', values[0], error[0],
                 'about the joint, centre of mass and motor included', _TELLS_INERTIA)]
    if arm_fit.shares[joint] < _SLIGHT:
        rows[0] = rows[0]._replace(flags=('not identifiable',), note=(
            f'it takes {100 * max(arm_fit.shares[joint], 0.0):.2g} % of the torque in this '
            f'motion, less than what the model lacks may take: {_TELLS_INERTIA}'))
    if 3 in numbers:
        rows.append(_row(f'effects.{robot.joints[joint]}.{CONSTANT}.bias', 'N m', -values[-1],
                         error[-1], 'friction would have to be several times '
                         'larger one way than the other without it', _TELLS_CONSTANT))
    if 1 in numbers:
        size = np.hypot(*values[1:3])
        slope = values[1:3] / max(size, 1e-300)
        spreads = covariance[1:3, 1:3]
        angle = np.arctan2(-values[2], values[1])
        turn = np.array([-slope[1], slope[0]]) / max(size, 1e-300)
        rows.append(_row(f'{name}.gravity_torque', 'N m', size, np.sqrt(slope @ spreads @ slope),
                         'of the link held level: mass com '
                         'gravity; mass and com apart cannot be told', _TELLS_GRAVITY))
        error = float(np.sqrt(turn @ spreads @ turn))
        told = error < _WIDE
        rows.append(Estimate(
            f'{name}.offset', 'rad', float(angle), Interval(angle - CONFIDENT * error,
                                                            angle + CONFIDENT * error),
            () if told else ('not identifiable',), '' if told else _TELLS_GRAVITY))
    if arm_fit.ripples[joint]:
        rows += _ripple_rows(arm_fit.ripples[joint],
                             f'effects.{robot.joints[joint]}.{axis_ripple.NAME}')
    if 1 not in numbers:
        rows.append(Estimate(f'{name}.gravity_torque', 'N m', 0.0, _UNKNOWN,
                             ('not identifiable',),
                             'no gravity is seen in this motion: it does not lower the error on '
                             'data held out'))
    return rows


def _ripple_rows(ripple, name):
    rows = []
    for part, unit, error, note in (
            ('amplitude', 'N m', ripple.amplitude_error, 'taken off the torque before friction '
             'was fitted'),
            ('order', '1', ripple.order_error, 'periods in 2 pi of the angle')):
        value = getattr(ripple, part)
        interval = Interval(value - CONFIDENT * error, value + CONFIDENT * error)
        rows.append(Estimate(f'{name}.{part}', unit, value, interval, (), note))
    return rows


def _row(name, unit, value, error, meaning, tells):
    interval = Interval(value - CONFIDENT * error, value + CONFIDENT * error)
    told = CONFIDENT * error < _WIDE * abs(value) and (value > 0.0 or 'bias' in name)
    return Estimate(name, unit, float(value), Interval(*map(float, interval)),
                    () if told else ('not identifiable',), meaning if told else tells)


def _motor_rows(motor, name, rigid):
    rows = []
    for part, unit, value, error, told in zip(
            ('motor_inertia', 'stiffness', 'damping'), ('kg m^2', 'N m/rad', 'N m s/rad'),
            motor[:3], motor.error, motor.believed, strict=True):
        if rigid and part == 'motor_inertia':
            continue
        note = '' if told else _TELLS_MOTOR
        if not told and motor.skew >= 0.3:
            note = ('most of the twist goes with the velocity, as if the two encoders were read '
                    'at different times: that looks like a soft spring or damping and is neither')
        wide = Interval(float(value - CONFIDENT * error), float(value + CONFIDENT * error))
        rows.append(Estimate(f'{name}.{part}', unit, float(value), wide,
                             () if told else ('not identifiable',), note))
    return rows
