# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Faults of a recording that would make a fit wrong, found before any fit.

==================  =============================================================
kind                what is wrong
==================  =============================================================
joint_names         a joint of the robot is not in the recording
too_short           too few samples or seconds
clock               stamps are uneven or in another unit
dropped             samples are missing
missing             channels, or parts of them, are no number
angle_unit          angles are in degrees
still               a joint never moves
one_direction       a joint moves one way only
jump                an angle jumps
frozen              samples are repeated while a joint moves
velocity            a velocity is not the derivative of its angle
saturated           the torque is clipped while a joint moves
swapped_torques     the torques of two joints are exchanged
swapped_sides       motor and link are exchanged
side_scale          the motor angle has another scale or sign than the link's
torque_sign         the torque is reversed
torque_scale        the torque is off by a factor
unexplained         the torque does not belong to the motion
load                a load on an arm that is not one of a URDF
coupling            coupled motors on an arm that is not one of a URDF
==================  =============================================================
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import friction_columns, is_moving, quantum, sign_fit
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification import check_basis as limits
from gms_flex_control.identification import sampling_checks
from gms_flex_control.identification.check_basis import absent_joints, Balance, Fault, spring_fit
from gms_flex_control.params.arm import carrying
from gms_flex_control.params.robot import RobotParams
import numpy as np

OF_ALL = ('too_short', 'still', 'one_direction')  # kinds that recordings have together


def saturated(signals: Recording) -> list[Fault]:
    """Return faults of torques that stay at their extreme while the joint moves."""
    found = []
    for j, joint in enumerate(signals.joints):
        tau, q = signals.tau_motor[:, j], signals.q_link[:, j]
        if min(np.isfinite(tau).sum(), np.isfinite(q).sum()) < limits.FEWEST_ROWS:
            continue
        clipped = _at_an_extreme(tau)
        if not clipped.any():
            continue
        lasting, part = limits.CLIP_TRAVEL
        width = max(1, round(lasting / signals.period))
        travel = np.abs(q[2 * width:] - q[:-2 * width])
        moving = np.pad(travel > max(part * np.nanmax(travel, initial=0.0), 2 * quantum(q)), width)
        share = np.sum(clipped & moving) / max(np.sum(moving), 1)
        if share >= limits.CLIPPED_WARN:
            limit = np.abs(tau[clipped]).max()
            found.append(Fault(
                'saturated', joint, 'refuse' if share > limits.CLIPPED_REFUSE else 'warn',
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
        if top < limits.CLIP_TOP * largest:
            continue
        at = value >= top - limits.CLIP_AT * span
        below = (value >= top - max(1.5 * quantum(tau), limits.CLIP_BELOW * span)) & ~at
        repeats = np.sum(still & at)
        rare = np.sum(still & ~at & (tau != 0)) < limits.CLIP_RARE * repeats
        if repeats >= limits.CLIP_REPEATS and (rare or at.sum() > limits.CLIP_DENSE * below.sum()):
            clipped |= at
    # a torque in steps stands still at every level, not only at the outer ones, or has no others
    between = known & ~clipped & (tau != 0)
    in_steps = np.sum(between) <= limits.CLIP_BETWEEN * np.sum(clipped)
    return clipped & (not in_steps) & (
        np.sum(still & between) < limits.CLIP_ALONE * np.sum(clipped))


def physics(signals: Recording, robot: RobotParams, rough: bool) -> list[Fault]:
    """
    Compare torque, sides and joints with the equations of motion.

    Without a torque only the angles are compared. ``rough``: inertia and stiffness are mere
    placeholders; a factor is a warning only. One fault at a time, since each hides the next.
    """
    balance = Balance(signals, robot)
    if len(balance.motion.tau) < limits.FEWEST_ROWS:
        return []
    return (_side_scales(balance) or _exchanged_torques(balance) or _directions(balance)
            or _scales(balance, rough) or _unexplained(balance))


def _directions(balance):
    """Find reversed torques and exchanged sides."""
    found = []
    for j in balance.driven:
        driven = _balance_sign(balance, j)
        spring = _spring_sign(balance, j) if j in balance.springs else 0
        name = balance.joints[j]
        if spring < 0 and driven >= 0:
            proviso = '' if driven > 0 else ', unless the sign of its torque is reversed'
            found.append(Fault(
                'swapped_sides', name, 'refuse', f'{balance.source}: motor and link of {name} '
                'seem exchanged: its torque fits the spring between them only the other way '
                f'round{proviso}; exchange the two names'))
        elif driven < 0:
            found.append(Fault('torque_sign', name, 'refuse', (
                f'{balance.source}: the torque of {name} ' + _braking(balance, j, spring > 0))))
    return found


def _braking(balance, j, exchanged):
    """Return the rest of a sentence on a torque that brakes joint j."""
    gravity = ', or the gravity of the robot file' if balance.arm.gravity.any() else ''
    if not exchanged and balance.fits(-balance.motion.tau[:, j], j)[0].weights[0] == 0.0:
        return ('brakes its motion, but reversed does not accelerate it either; do other joints '
                'or a load move it? Then go on with --force. Else reverse it, or the angles'
                + gravity)
    also = ', and its motor and link are exchanged' if exchanged else ''
    moved = ('. A joint that others move while its drive brakes looks alike: then go on '
             'with --force' if len(balance.joints) > 1 else '')
    return ('has the wrong sign: only reversed does it accelerate the joint and overcome '
            f'friction{also}; reverse it, or the angles{gravity}{moved}')


def _balance_sign(balance, j):
    """Return 1 or -1 if the torque drives joint j forward or backward, 0 if that is open."""
    tau = balance.motion.tau[:, j]
    fits = balance.fits(tau, j)
    if fits is None:
        return 0
    known, loose = fits
    if known.as_is > limits.CLEAR and known.as_is > known.opposite + limits.APART:
        return 1
    clear = known.opposite > limits.CLEAR and known.opposite > known.as_is + limits.APART
    # a joint that is not driven by its torque takes no work from it in the end
    power = tau * balance.motion.dq_link[:, j]  # friction takes work
    driven = np.sum(power) / max(np.sum(np.abs(power)), 1e-300) > limits.CLEAR
    return -1 if clear and not driven and loose.as_is < max(loose.opposite, limits.LOOSE) else 0


def _spring_sign(balance, j):
    """Return 1 or -1 if the torque of joint j fits its spring as it is or with sides exchanged."""
    motion, torsion = balance.motion, balance.torsion(j)
    tau = motion.tau[:, j]
    explained, gain = spring_fit(tau, motion.ddq_motor[:, j], torsion)
    explained_other, gain_other = spring_fit(tau, motion.ddq_link[:, j], -torsion)
    if explained > limits.CLEAR and gain > limits.CLEAR and gain_other < limits.OTHER_SIDE:
        return 1
    if explained_other > limits.CLEAR and gain_other > limits.CLEAR and gain < limits.OTHER_SIDE:
        return -1
    return 0


def _scales(balance, rough):
    """Find torques off by a factor."""
    found = [fault for j in balance.driven for fault in (
        _spring_scale if j in balance.springs else _inertia_scale)(balance, j)]
    return [fault._replace(severity='warn') for fault in found] if rough else found


def _spring_scale(balance, j):
    """Compare torque over deflection with the stiffness; an encoder delay must not decide it."""
    motion, name, torsion = balance.motion, balance.joints[j], balance.torsion(j)
    tau, one = motion.tau[:, j], np.ones(len(motion.tau))
    stiffness = balance.arm.stiffness[j]
    ratios, limit = [], limits.SCALE_STIFFNESS
    rest = np.stack([torsion, motion.dq_link[:, j]])
    exact = balance.spring_share(tau, j) > limits.EXACT
    if not exact and rest[1].any() and np.corrcoef(rest)[0, 1] ** 2 > limits.LATE:
        # read late, one encoder adds a part of the velocity to the torsion
        limit *= limits.LATE_FACTOR
    for others in [[motion.ddq_motor[:, j]]] if exact else (
            [], [motion.ddq_motor[:, j]], [motion.dq_motor[:, j]],
            [motion.ddq_motor[:, j], motion.dq_motor[:, j]]):
        fit = sign_fit(tau, [torsion], [one, *others])
        if fit.as_is > limits.CLEAR:
            ratios.append(fit.weights[0] / stiffness)
    if not ratios or min(ratios) < limit and max(ratios) > 1 / limit:
        return
    if _fits_where_small(tau, motion.ddq_motor[:, j], torsion, stiffness):
        return  # drives that give but a part of what is asked of them
    middle = float(np.median(ratios))
    yield Fault('torque_scale', name, 'refuse', f'{balance.source}: the torque '
                f'of {name} is {middle:.3g} times what its torsion and a stiffness '
                f'of {stiffness:.4g} N m/rad make; give the torque in N m at the joint (unit, '
                'gear ratio), or its torque constant in recording.yaml, or correct the '
                'stiffness')


def _fits_where_small(tau, ddq_motor, torsion, stiffness):
    """Return whether torque (T,) is what the spring makes where it is no more than that ever."""
    small = np.abs(tau) <= stiffness * np.abs(torsion - np.median(torsion)).max()
    if small.sum() < limits.FEWEST_ROWS:
        return False
    free = [np.ones(int(small.sum())), ddq_motor[small]]
    fit = sign_fit(tau[small], [torsion[small]], free)
    ratio = fit.weights[0] / stiffness
    return fit.as_is > limits.EXACT and 1 / limits.SCALE_STIFFNESS < ratio < limits.SCALE_STIFFNESS


def _inertia_scale(balance, j):
    """Compare torque with what the robot's inertia and gravity need."""
    motion, name = balance.motion, balance.joints[j]
    fits = balance.fits(motion.tau[:, j], j)
    if fits is None:
        return
    rows = is_moving(motion.dq_link[:, j])
    friction = sign_fit(motion.tau[rows, j], friction_columns(motion.dq_link[rows, j]),
                        [np.ones(int(rows.sum()))]).as_is
    whole = fits[0]
    more = whole.as_is - friction
    if whole.as_is < limits.SCALE_SHOWN or more < limits.CLEAR * (1 - friction):
        return
    ratio = float(whole.weights[0])
    factor = max(ratio, 1.0 / ratio) if ratio > 0.0 else np.inf
    refused = limits.SCALE_SLIGHT if friction > limits.NEARLY_ALL else limits.SCALE_INERTIA[1]
    if factor > limits.SCALE_INERTIA[0]:
        yield Fault('torque_scale', name, 'refuse' if factor > refused else 'warn',
                    f'{balance.source}: the torque of {name} is {ratio:.3g} '
                    "times what the robot's inertia and gravity need; give the torque in N m "
                    'at the joint (unit, gear ratio), or its torque constant in recording.yaml, '
                    'or correct the inertia')


def _unexplained(balance):
    """Find torques that have nothing to do with the motion."""
    found = []
    others = (' Where other joints move it, a robot file of the whole arm explains it.'
              if len(balance.driven) > 1 and balance.arm.kind == 'decoupled' else '')
    for j in balance.driven:
        tau, name = balance.motion.tau[:, j], balance.joints[j]
        shares = [fit.as_is for fit in balance.fits(tau, j) or ()]
        if j in balance.springs:
            shares.append(balance.spring_share(tau, j))
        if shares and max(shares) < limits.UNEXPLAINED:
            found.append(Fault(
                'unexplained', name, 'warn', f'{balance.source}: inertia, gravity, '
                f'spring and friction explain {100 * max(shares):.0f} % of the torque of '
                f'{name}; is it the torque of this joint, at the time of its '
                f'angles, and is the robot file right?{others}'))
    return found


def _side_scales(balance):
    """Find a motor angle with another sign or scale than the link's, far beyond any deflection."""
    found, motion = [], balance.motion
    for j in balance.springs:
        x, y = (side[:, j] - side[:, j].mean() for side in (motion.q_link, motion.q_motor))
        if not (x.any() and y.any()):
            continue
        slope, fit = x @ y / (x @ x), x @ y / np.sqrt((x @ x) * (y @ y))
        torsion = balance.arm.stiffness[j] * np.std(y - x)
        tau = motion.tau[:, j]
        torn = torsion > limits.SIDE_FACTOR * np.std(tau) if np.isfinite(tau).all() else abs(
            np.log(abs(slope) + 1e-12)) > np.log(limits.SIDE_SLOPE_ALONE)
        low, high = limits.SIDE_SLOPE
        if abs(fit) > limits.SIDE_FIT and not low < slope < high and (torn or slope < 0.0):
            found.append(Fault(
                'side_scale', balance.joints[j], 'refuse', f'{balance.source}: the motor of '
                f'{balance.joints[j]} moves {slope:.4g} times as far as its link; give motor '
                'angles as seen at the joint (divide by the gear ratio, correct the sign)'))
    return found


def _exchanged_torques(balance):
    """Find two joints each of whose torque fits the other's motion far better."""
    found = []

    def explained(torque, j, sign=1.0):
        tau = sign * balance.motion.tau[:, torque]
        if j in balance.springs:
            return balance.spring_share(tau, j)
        fits = balance.fits(tau, j)
        return fits[0].as_is if fits else 0.0

    for i, j in combinations(balance.driven, 2):
        crossed = [1 - explained(i, j), 1 - explained(j, i)]
        straight = [1 - explained(i, i), 1 - explained(j, j)]
        if sum(1 - explained(k, k, -1.0) for k in (i, j)) < sum(crossed):
            continue  # both are reversed, as `_directions` says
        if (max(crossed) < limits.EXCHANGED
                and sum(crossed) < limits.EXCHANGED_SHARE * sum(straight)
                and all(a < b for a, b in zip(crossed, straight, strict=True))):
            first, second = balance.joints[i], balance.joints[j]
            found.append(Fault(
                'swapped_torques', first, 'refuse', f'{balance.source}: the torques of {first} '
                f'and {second} seem exchanged: each fits the motion of the other; exchange the '
                'names in the recording or the robot file'))
    return found


def check(recording: Recording, robot: RobotParams, rough=False) -> tuple[Fault, ...]:
    """
    Return the faults of one experiment, faults of time first, since they hide the others.

    Of the robot is used which joints are flexible, stiffness within a factor of 4, inertia within
    one of 3, no friction; ``rough`` says that both are placeholders, for instance because they
    are to be estimated.
    """
    absent = absent_joints(recording, robot)
    if absent:
        return tuple(absent)
    signals = recording.of_joints(robot.joints)
    load, load_unknown, _ = signals.operation
    if (load is not None or load_unknown) and robot.arm.frames is None:
        return (Fault('load', robot.joints[-1], 'refuse', (
            f'{recording.source}: has a load, which needs an arm of a URDF; write the robot file '
            'with arm.kind: urdf, or add the load to its last link')),)
    if recording.coupling is not None and robot.arm.frames is None:
        return (Fault('coupling', robot.joints[-1], 'refuse', (
            f'{recording.source}: has coupled motors, whose friction needs an arm of a URDF; '
            'write the robot file with arm.kind: urdf')),)
    robot = replace(robot, arm=carrying(robot.arm, load))
    found = [*sampling_checks.length(signals), *sampling_checks.clock(signals),
             *sampling_checks.missing(signals, robot)]
    if any(fault.severity == 'refuse' for fault in found):
        return tuple(found)
    found += sampling_checks.units(signals, robot)
    if any(fault.kind == 'angle_unit' for fault in found):
        return tuple(found)
    found += sampling_checks.broken(signals)
    if any(fault.kind == 'jump' for fault in found):
        return tuple(found)
    found += sampling_checks.motion(signals)
    found += sampling_checks.rates(signals)
    found += saturated(signals)
    loose = [joint for joint, sd in zip(signals.joints, signals.scale_sd, strict=True) if sd]
    found += [one for one in physics(signals, robot, rough or bool(loose))
              if one.kind != 'torque_scale' or one.joint not in loose]
    return tuple(found)


def of_all(recordings: Sequence[Recording], robot: RobotParams) -> list[Fault]:
    """
    Return warnings of what only Recordings fitted together can lack, kinds OF_ALL.

    One of them may be short, and have motion of some joints, or one way.
    """
    seen = [one.of_joints(robot.joints) for one in recordings]
    return [fault._replace(severity='warn') for fault in (
        *sampling_checks.length(*seen), *sampling_checks.motion(*seen))]


def standing(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """
    Return the joints that stand still in all recordings, () where all do.

    Not those whose motor is seen: it may move on a spring.
    """
    joints = recordings[0].joints
    still = {fault.joint for fault in sampling_checks.motion(*recordings)
             if fault.kind == 'still' and not any(np.isfinite(
                 one.q_motor[:, joints.index(fault.joint)]).any() for one in recordings)}
    return tuple(joint for joint in joints if joint in still) if still < {*joints} else ()


def require(recording: Recording, robot: RobotParams, force=False, rough=False) -> list:
    """Return warnings of `check`, with ``force`` all; IdentificationError where a fit is wrong."""
    found = check(recording, robot, rough)
    for fault in found:
        if fault.severity == 'refuse' and not force:
            raise IdentificationError(fault.text)
    return found
