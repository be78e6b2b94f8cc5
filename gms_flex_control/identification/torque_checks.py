# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Faults of the torque: clipped, reversed or off by a factor; and motor and link exchanged."""

from gms_flex_control.data.signals import friction_columns, is_moving, quantum, sign_fit
from gms_flex_control.identification.equations import (
    balance_fit,
    FEWEST,
    filtered,
    spring_fit,
    spring_joints,
    torque_joints,
    total_torque,
)
from gms_flex_control.identification.exchange_checks import (
    exchanged_angles,
    exchanged_joints,
    exchanged_torques,
    side_scales,
)
from gms_flex_control.identification.findings import Finding
import numpy as np

CLIPPED_WARN, CLIPPED_REFUSE = 0.005, 0.5  # shares of the moving samples
SCALE_STIFFNESS = 4.0       # refused beyond this factor of what the spring says
SCALE_INERTIA = (3.0, 8.0)  # warned about, refused: the inertia of a rigid joint is less known
SCALE_SLIGHT = 50.0         # likewise where friction is nearly all: little torque tells inertia
_NEARLY_ALL = 0.9           # of the variance
_CLEAR = 0.5                # of the variance a fit must explain to be believed
_EXACT = 0.95               # a fit as good as this is no delay between encoders
_UNEXPLAINED = 0.2          # less than this is no fit at all


def saturated(signals):
    """Return findings of torques (Signals) that stay at their extreme while the joint moves."""
    found = []
    for j, joint in enumerate(signals.joints):
        tau, q = signals.tau_motor[:, j], signals.q_link[:, j]
        if np.isfinite(tau).sum() < FEWEST or np.isfinite(q).sum() < FEWEST:
            continue
        clipped = _at_an_extreme(tau)
        if not clipped.any():
            continue
        width = max(1, round(0.05 / signals.period))
        travel = np.abs(q[2 * width:] - q[:-2 * width])
        moving = np.pad(travel > max(0.02 * np.nanmax(travel, initial=0.0), 2 * quantum(q)),
                        width)
        share = np.sum(clipped & moving) / max(np.sum(moving), 1)
        if share >= CLIPPED_WARN:
            limit = np.abs(tau[clipped]).max()
            found.append(Finding(
                'saturated', joint, 'refuse' if share > CLIPPED_REFUSE else 'warn',
                f'{signals.source}: the torque of {joint} is clipped at {limit:.4g} N m in '
                f'{100 * share:.2g} % of the moving samples, so it may have been larger '
                'than recorded there; move more gently or raise the limit'))
    return found


def _at_an_extreme(tau):
    """Return where a torque (T,) stays at its largest or smallest value as if cut off there."""
    known = np.isfinite(tau)
    largest, span = np.abs(tau[known]).max(), np.ptp(tau[known])
    clipped = np.zeros(len(tau), dtype=bool)
    still = np.concatenate([[False], np.diff(tau) == 0])
    if span == 0:
        return clipped
    for sign in (1.0, -1.0):
        value = sign * tau
        top = value[known].max()
        if top < 0.3 * largest:
            continue
        at = value >= top - 1e-6 * span
        below = (value >= top - max(1.5 * quantum(tau), 0.01 * span)) & ~at
        repeats = np.sum(still & at)
        rare = np.sum(still & ~at & (tau != 0)) < 0.2 * repeats
        if repeats >= 5 and (rare or at.sum() > 4 * below.sum()):
            clipped |= at
    # a torque in steps stands still at every level, not only at the outer ones
    return clipped & (np.sum(still & ~clipped & (tau != 0)) < 0.3 * np.sum(clipped))


def physics(signals, robot, rough=False):
    """
    Compare torque, sides and joints with the equations of motion.

    Parameters
    ----------
    signals : Signals
        The recording; without a torque only the angles are compared.
    robot : RobotParams
        Roughly the robot.
    rough : bool
        Inertia and stiffness are mere placeholders: a factor is a warning only, and inertia
        is no evidence of exchanged joints.

    Returns
    -------
    list of Finding
        Kinds 'swapped_joints', 'swapped_sides', 'side_scale', 'torque_sign', 'torque_scale'
        and 'unexplained'; one fault at a time, since each hides the next.

    """
    motion = filtered(signals, robot)
    if len(motion.tau) < FEWEST:
        return []
    return (exchanged_angles(signals, robot, motion) or side_scales(signals, robot, motion)
            or exchanged_torques(signals, robot, motion)
            or _directions(signals, robot, motion)
            or (not rough and exchanged_joints(signals, robot, motion))
            or _scales(signals, robot, motion, rough) or _unexplained(signals, robot, motion))


def _directions(signals, robot, motion):
    """Find reversed torques and exchanged sides."""
    total, springs = total_torque(motion, robot), spring_joints(robot, motion)
    found = []
    for j in torque_joints(robot, motion):
        balance = _balance_sign(motion, motion.tau[:, j], total, j)
        spring = _spring_sign(motion, j) if j in springs else 0
        name = signals.joints[j]
        if spring < 0 and balance >= 0:
            doubt = '' if balance > 0 else ', unless the sign of its torque is reversed'
            found.append(Finding(
                'swapped_sides', name, 'refuse', f'{signals.source}: motor and link of {name} '
                'seem exchanged: its torque fits the spring between them only the other way '
                f'round{doubt}; exchange the two names'))
        elif balance < 0:
            also = ', and its motor and link are exchanged' if spring > 0 else ''
            gravity = ', or the gravity of the robot file' if robot.arm.gravity.any() else ''
            found.append(Finding(
                'torque_sign', name, 'refuse', f'{signals.source}: the torque of {name} has the '
                'wrong sign: only reversed does it accelerate the joint and overcome '
                f'friction{also}; reverse it, or the angles{gravity}'))
    return found


def _balance_sign(motion, tau, total, j):
    """Return 1 or -1 if a torque drives joint j forward or backward, 0 if one cannot tell."""
    fits = balance_fit(motion, tau, total, j)
    if fits is None:
        return 0
    known, loose = fits
    if known.as_is > _CLEAR and known.as_is > known.opposite + 0.3:
        return 1
    clear = known.opposite > _CLEAR and known.opposite > known.as_is + 0.3
    # a joint that is not driven by its torque takes no work from it in the end
    driven = _work(tau, motion.dq_link[:, j]) > _CLEAR
    return -1 if clear and not driven and loose.as_is < max(loose.opposite, 0.5) else 0


def _work(tau, velocity):
    """Return the work of a torque (S,) over that of its size, -1 to 1: friction takes work."""
    power = tau * velocity
    return float(np.sum(power) / max(np.sum(np.abs(power)), 1e-300))


def _spring_sign(motion, j):
    """Return 1 or -1 if the torque of joint j fits its spring as it is or with sides exchanged."""
    tau, twist = motion.tau[:, j], motion.q_motor[:, j] - motion.q_link[:, j]
    explained, gain = spring_fit(tau, motion.ddq_motor[:, j], twist)
    explained_other, gain_other = spring_fit(tau, motion.ddq_link[:, j], -twist)
    if explained > _CLEAR and gain > _CLEAR and gain_other < 0.1:
        return 1
    if explained_other > _CLEAR and gain_other > _CLEAR and gain < 0.1:
        return -1
    return 0


def _scales(signals, robot, motion, rough):
    """Find torques off by a factor."""
    total, springs = total_torque(motion, robot), spring_joints(robot, motion)
    found = []
    for j in torque_joints(robot, motion):
        if j in springs:
            found += _spring_scale(signals, robot, motion, j)
        else:
            found += _inertia_scale(signals, motion, total, j)
    return [finding._replace(severity='warn') for finding in found] if rough else found


def _spring_scale(signals, robot, motion, j):
    """Compare torque over twist with the stiffness; an encoder delay must not decide it."""
    tau, one = motion.tau[:, j], np.ones(len(motion.tau))
    stiffness = robot.arm.stiffness[j]
    twist = motion.q_motor[:, j] - motion.q_link[:, j]
    ratios, limit = [], SCALE_STIFFNESS
    rest = np.stack([twist, motion.dq_link[:, j]])
    exact = spring_fit(tau, motion.ddq_motor[:, j], twist)[0] > _EXACT
    if not exact and rest[1].any() and np.corrcoef(rest)[0, 1] ** 2 > 0.1:
        limit *= 3.0  # read late, one encoder adds a part of the velocity to the twist
    for others in [[motion.ddq_motor[:, j]]] if exact else (
            [], [motion.ddq_motor[:, j]], [motion.dq_motor[:, j]],
            [motion.ddq_motor[:, j], motion.dq_motor[:, j]]):
        fit = sign_fit(tau, [twist], [one, *others])
        if fit.as_is > _CLEAR:
            ratios.append(fit.weights[0] / stiffness)
    if not ratios or min(ratios) < limit and max(ratios) > 1 / limit:
        return
    if _fits_where_small(tau, motion.ddq_motor[:, j], twist, stiffness):
        return  # drives that give but a part of what is asked of them
    middle = float(np.median(ratios))
    yield Finding('torque_scale', signals.joints[j], 'refuse', f'{signals.source}: the torque '
                  f'of {signals.joints[j]} is {middle:.3g} times what its twist and a stiffness '
                  f'of {stiffness:.4g} N m/rad make; give the torque in N m at the joint (unit, '
                  'gear ratio, torque constant), or correct the stiffness')


def _fits_where_small(tau, ddq_motor, twist, stiffness):
    """Return whether torque (T,) is what the spring makes where it is no more than that ever."""
    small = np.abs(tau) <= stiffness * np.abs(twist - np.median(twist)).max()
    if small.sum() < FEWEST:
        return False
    free = [np.ones(int(small.sum())), ddq_motor[small]]
    fit = sign_fit(tau[small], [twist[small]], free)
    ratio = fit.weights[0] / stiffness
    return fit.as_is > _EXACT and 1 / SCALE_STIFFNESS < ratio < SCALE_STIFFNESS


def _inertia_scale(signals, motion, total, j):
    """Compare torque with what the robot's inertia and gravity need."""
    fits = balance_fit(motion, motion.tau[:, j], total, j)
    if fits is None:
        return
    rows = is_moving(motion.dq_link[:, j])
    friction = sign_fit(motion.tau[rows, j], friction_columns(motion.dq_link[rows, j]),
                        [np.ones(int(rows.sum()))]).as_is
    whole = fits[0]
    if whole.as_is < 0.6 or (whole.as_is - friction) < _CLEAR * (1 - friction):
        return
    ratio = float(whole.weights[0])
    factor = max(ratio, 1 / ratio)
    refused = SCALE_SLIGHT if friction > _NEARLY_ALL else SCALE_INERTIA[1]
    if factor > SCALE_INERTIA[0]:
        yield Finding('torque_scale', signals.joints[j],
                      'refuse' if factor > refused else 'warn',
                      f'{signals.source}: the torque of {signals.joints[j]} is {ratio:.3g} '
                      "times what the robot's inertia and gravity need; give the torque in N m "
                      'at the joint (unit, gear ratio, torque constant), or correct the inertia')


def _unexplained(signals, robot, motion):
    """Find torques that have nothing to do with the motion."""
    total, springs, found = total_torque(motion, robot), spring_joints(robot, motion), []
    for j in torque_joints(robot, motion):
        fits = balance_fit(motion, motion.tau[:, j], total, j)
        shares = [fit.as_is for fit in fits or ()]
        if j in springs:
            twist = motion.q_motor[:, j] - motion.q_link[:, j]
            shares.append(spring_fit(motion.tau[:, j], motion.ddq_motor[:, j], twist)[0])
        if shares and max(shares) < _UNEXPLAINED:
            found.append(Finding(
                'unexplained', signals.joints[j], 'warn', f'{signals.source}: inertia, gravity, '
                f'spring and friction explain {100 * max(shares):.0f} % of the torque of '
                f'{signals.joints[j]}; is it the torque of this joint, at the time of its '
                'angles, and is the robot file right?'))
    return found
