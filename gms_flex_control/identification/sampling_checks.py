# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Faults of stamps, angles and rates: lost samples, jumps, frozen values, too little motion."""

from collections.abc import Sequence

from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.data.recording import MOTOR_SUFFIX, Recording
from gms_flex_control.data.signal_analysis import BESIDE
from gms_flex_control.identification import check_basis as limits
from gms_flex_control.identification.check_basis import Fault, sides
from gms_flex_control.params.robot import RobotParams
import numpy as np


def length(*recordings: Recording) -> list[Fault]:
    """Return a fault if Recordings that are used together are too short."""
    count = sum(len(one.time) for one in recordings)
    duration = float(sum(one.time[-1] for one in recordings))
    if count >= limits.FEWEST and duration >= limits.SHORT:
        return []
    severity = 'refuse' if count < limits.FEWEST or duration < limits.SHORTEST else 'warn'
    return [Fault('too_short', '', severity, f'{named(recordings)}: {count} samples in '
                  f'{duration:.3g} s are too short to separate friction from inertia; record at '
                  f'least {limits.SHORT:g} s and {limits.FEWEST} samples, with motion both '
                  'ways')]


def clock(signals: Recording) -> list[Fault]:
    """Return faults of the time stamps, kinds 'clock' and 'dropped'."""
    steps, period = np.diff(signals.time), signals.period
    mean = float(np.mean(steps))
    if period < limits.BURST * mean and np.mean(steps > limits.BURST * mean) > limits.BURSTS:
        return [Fault('clock', '', 'refuse', f'{signals.source}: stamps come in bursts, most '
                      f'{1e3 * period:.2g} ms or less after the one before, {1e3 * mean:.3g} ms '
                      'on average: times of receipt; stamp the samples when they are taken '
                      '(header.stamp)')]
    if not limits.FASTEST <= period <= limits.SLOWEST:
        return [Fault('clock', '', 'refuse', f'{signals.source}: the median sample period is '
                      f'{period:.4g} s; are the stamps in another unit than seconds?')]
    multiple = np.rint(steps / period)
    steady = np.mean((np.abs(steps / period - multiple) < limits.ON_GRID) & (multiple > 0)) > 0.9
    gaps = np.flatnonzero(steps > (1.5 if steady else 1.8) * period)
    return [*_short_steps(signals, steps, steady), *_lost(signals, steps, gaps)]


def _short_steps(signals, steps, steady):
    """Find stamps closer than the sampling really was, as when the clock is set back."""
    short = np.flatnonzero(steps < limits.TOO_SOON * signals.period)
    near = limits.CLUSTER
    dense = len(short) > near and np.min(short[near:] - short[:-near]) < 5 * near
    if steady and (dense or short.size > max(limits.TOO_SOON_SHARE * len(steps), 2)):
        yield Fault('clock', '', 'warn', f'{signals.source}: {short.size} stamps follow the '
                    f'one before too soon, the first at {signals.time[short[0]]:.3f} s; was '
                    'the clock set back there? If so, cut the recording')
        return
    spread = float(np.subtract(*np.quantile(steps, [0.9, 0.1]))) / signals.period
    if spread > limits.IRREGULAR and not steady:
        yield Fault('clock', '', 'warn', f'{signals.source}: the sample period is irregular '
                    f'({spread:.1f} periods between the 10 % and 90 % quantiles); stamp the '
                    'samples when they are taken')


def _lost(signals, steps, gaps):
    if not gaps.size:
        return
    lost = int(np.sum(np.rint(steps[gaps] / signals.period) - 1))
    share = lost / (lost + len(signals.time))
    worst = gaps[np.argmax(steps[gaps])]
    if share >= limits.LOST_REFUSE:
        severity = 'refuse'
    elif (share >= limits.LOST_WARN and lost >= 3) or steps[worst] > max(
            limits.GAP_WARN, 5 * signals.period):
        severity = 'warn'
    else:
        return
    yield Fault('dropped', '', severity, f'{signals.source}: {lost} samples '
                f'({100 * share:.2g} %) are missing in {gaps.size} gaps, the longest '
                f'{1e3 * steps[worst]:.4g} ms at {signals.time[worst]:.3f} s; they are '
                'bridged only where short: record with less load or a higher priority')


def missing(signals: Recording, robot: RobotParams) -> list[Fault]:
    """Return faults for numbers that are not there."""
    found, alone = [], signals.motors_alone
    for j, joint in enumerate(signals.joints):
        flexible = not robot.arm.rigid[j]
        channels = [('link angle', signals.q_link[:, j], True),
                    ('torque', signals.tau_motor[2:, j], not flexible)]
        if flexible and alone[j]:
            found.append(Fault('missing', joint, 'refuse', (
                f'{signals.source}: the link angle of {joint} was not recorded, nor a torque '
                'by which it follows from the motor angle; record either, or describe the joint '
                f'as rigid, under the name of its motor, {robot.motors[j] or joint + MOTOR_SUFFIX}'
            )))
            channels = channels[1:]
        if flexible:
            no_torsion = not np.isfinite(signals.tau_motor[2:, j]).any()
            channels.insert(1, ('motor angle', signals.q_motor[:, j], no_torsion))
        for name, values, needed in channels:
            found += _holes(signals, joint, name, values, needed)
    return found


def _holes(signals, joint, name, values, needed):
    lost = np.flatnonzero(~np.isfinite(values))
    share = lost.size / len(values)
    if share == 1.0:
        severity = 'refuse' if needed else 'warn'
        text = (f'the {name} of {joint} was not recorded' + (
            '; nothing can be fitted without it' + (
                ': commands do not say what acted, record it as effort (import-csv: torque)'
                if name == 'torque' else '') if needed else
            '; what it alone shows is lost: record it as well'))
    elif share >= limits.MISSING_WARN or lost.size > limits.MISSING_MOST:
        severity = 'refuse' if share > limits.MISSING_REFUSE else 'warn'
        text = (f'the {name} of {joint} is not a number in {lost.size} samples '
                f'({100 * share:.2g} %), {np.diff(analysis.runs(~np.isfinite(values))).max()} in '
                f'a row, first at {signals.time[lost[0]]:.3f} s; leave that part out')
    else:
        return
    yield Fault('missing', joint, severity, f'{signals.source}: {text}')


def motion(*recordings: Recording) -> list[Fault]:
    """Return faults 'still' and 'one_direction' of joints in Recordings of them together."""
    found, still, source = [], [], named(recordings)
    for j, joint in enumerate(recordings[0].joints):
        parts = [one for one in recordings if np.isfinite(one.q_link[:, j]).sum() >= limits.FEWEST]
        moved = [_ways(one, j) for one in parts]
        ways = np.sum([one for one in moved if one is not None], axis=0)
        if np.ndim(ways):
            found += _one_way(source, joint, *ways)
        elif any(one is None for one in moved):
            still.append((joint, max(float(np.nanmax(one.q_link[:, j]) - np.nanmin(
                one.q_link[:, j])) for one in parts)))
    for joint, travel in still:
        moves = (f'never moves (by {travel:.3g} rad at most, which its encoder hardly resolves)'
                 if travel > 0.0 else 'does not move')
        found.append(Fault(
            'still', joint, 'refuse' if len(still) == len(recordings[0].joints) else 'warn',
            f'{source}: {joint} {moves}; none of its parameters can be had from '
            f'{"this recording" if len(recordings) == 1 else "these recordings"}'))
    return found


def named(recordings: Sequence[Recording]) -> str:
    """Return the sources of recordings for a message."""
    first, *others = [one.source for one in recordings]
    return f'{first} and {len(others)} more' if others else first


def _ways(signals, j):
    """Return how far a joint moves forward and backward (2,) [rad], None where it stands."""
    q = signals.q_link[:, j]
    filtered, = analysis.smoothed(signals.time, [q], analysis.derivative_window(signals.time, q))
    if not len(filtered.value):
        return np.zeros(2)
    noise, span = np.nanstd(np.diff(q)) / np.sqrt(2), np.ptp(filtered.value)
    if span <= limits.STILL_STEPS * max(analysis.quantum(q), min(noise, span)):
        return None
    steps = np.diff(filtered.value)[analysis.is_moving(filtered.first)[1:]]
    return np.array([steps[steps > 0].sum(), -steps[steps < 0].sum()])


def _one_way(source, joint, forward, backward):
    if min(forward, backward) >= limits.ONE_WAY * max(forward, backward):
        return
    way, other = ('forward', 'backward') if forward > backward else ('backward', 'forward')
    yield Fault('one_direction', joint, 'warn', f'{source}: {joint} moves {way} only '
                f'({max(forward, backward):.3g} rad against {min(forward, backward):.2g}): '
                f'friction.{joint}.{other} is not identifiable, nor friction separable from a '
                'constant torque; add motion the other way')


def units(signals: Recording, robot: RobotParams) -> list[Fault]:
    """Return a fault for the first joint whose angles fit the limits of a URDF as degrees."""
    frames = robot.arm.frames
    for j, joint in enumerate(signals.joints if frames else ()):
        most = float(np.nanmax(np.abs(signals.q_link[:, j] + robot.arm.offset[j])))
        limit = max(abs(frames.lower[j]), abs(frames.upper[j]))
        if frames.prismatic[j] or not np.isfinite(limit):
            continue
        if most > limits.BEYOND * limit and np.radians(most) < limits.BEYOND * limit:
            return [Fault('angle_unit', joint, 'refuse', (
                f'{signals.source}: {joint} goes to {most:.3g} rad, its limits in the URDF end at '
                f'{limit:.3g}: its angles look like degrees; record radians, or import them with '
                'their unit (import-csv)'))]
    return []


def doubtful_columns(recording: Recording, joints: Sequence) -> list[str]:
    """Return sentences on torques that are always 0, and angles like degrees, of an ImportMap."""
    found = []
    for j, joint in enumerate(joints):
        for name, torque in (('torque', recording.tau_motor), ('command', recording.command)):
            known = torque[np.isfinite(torque[:, j]), j]
            if len(known) and not known.any():
                found.append(f'the {name} of {joint.name} is always 0; is it another column?')
        side = 'link' if 'link_position' in joint.channels else 'motor'
        most = np.nanmax(np.abs(getattr(recording, f'q_{side}')[:, j]), initial=0.0)
        if joint.angle.unit == 'rad' and limits.TURNS < most <= limits.DEGREES and not (
                _has_measured_rate(recording, j, side, joint)):
            found.append(f'{joint.name} turns to {most:.3g} rad, {most / (2.0 * np.pi):.0f} turns;'
                         ' are these degrees? Then give unit: deg')
    return found


def _has_measured_rate(recording, j, side, joint):
    """Return whether a velocity, not computed from its angle, is what the angle changes by."""
    channel = joint.channels.get(f'{side}_velocity')
    judged = channel and channel.estimate is None and analysis.derivative_slope(
        recording.time, getattr(recording, f'q_{side}')[:, j],
        getattr(recording, f'dq_{side}')[:, j])
    return bool(judged) and _within(judged, limits.SLOPE, limits.SLOPE_FIT)


def rates(signals: Recording) -> list[Fault]:
    """Return faults of rates that are not the derivative of their angle."""
    found = []
    for j, joint in enumerate(signals.joints):
        for side, q, dq in sides(signals, j):
            judged = analysis.derivative_slope(signals.time, q, dq)
            if judged is None or _within(judged, limits.SLOPE, limits.SLOPE_FIT):
                continue
            slope, fit = judged
            mild = _within(judged, limits.SLOPE_MILD, limits.SLOPE_MILD_FIT)
            found.append(Fault(
                'velocity', joint, 'warn' if mild else 'refuse', f'{signals.source}: the {side} '
                f'velocity of {joint} is not the derivative of its angle but {slope:.3g} times '
                f'it (correlation {fit:.2f}): either the velocity is wrong, which no fit uses, or '
                'angle or time are, and then inertia and friction will be; correct unit, sign or '
                'time' + ('' if mild else ', or go on with --force if angle and time are right')))
    return found


def _within(judged, slopes, fit):
    return slopes[0] < judged[0] < slopes[1] and judged[1] > fit


def broken(signals: Recording) -> list[Fault]:
    """Return faults of samples that cannot be motion: kinds 'jump' (angle) and 'frozen'."""
    found = []
    for j, joint in enumerate(signals.joints):
        for side, q, _ in sides(signals, j):
            top, unit = signals.period * analysis.top_speed(signals.time, q), analysis.quantum(q)
            grain = max(unit, 3 * _noise(q))
            step = max(3 * grain, 0.05 * top)
            held = _while_moving(q, np.diff(q) == 0, step)
            moving = np.sum(np.abs(q[BESIDE:] - q[:-BESIDE]) > BESIDE * step)
            found += _frozen(signals, joint, f'the {side} angle of {joint} stays', held, moving)
            found += _jumps(signals, joint, side, q, unit)
    return found


def _noise(q):
    """Return about the standard deviation of the noise of an angle (T,)."""
    bends = np.abs(np.diff(q, 2))
    bends = bends[np.isfinite(bends)]
    return float(np.median(bends)) / (analysis.NORMAL_MEDIAN * np.sqrt(6)) if bends.size else 0.0


def _while_moving(q, equal, step):
    """
    Return first and last sample (R, 2) of runs that are ``equal`` (T - 1,) to the sample before.

    Of those on both sides of which the angle moves one way by ``step`` a sample.
    """
    found = analysis.runs(equal)
    first, end = found[(found[:, 0] >= BESIDE) & (found[:, 1] + BESIDE < len(q))].T
    before = (q[first] - q[first - BESIDE]) / BESIDE
    after = (q[end + BESIDE] - q[end]) / BESIDE
    last, following = q[first] - q[first - 1], q[end + 1] - q[end]
    same_way = (before * after > 0) & (before * last > 0) & (before * following > 0)
    moving = (np.minimum(np.abs(before), np.abs(after)) > step) & same_way
    # a joint that comes to rest and starts again has slow samples on both sides
    abrupt = np.maximum(np.abs(last), np.abs(following)) > 0.5 * np.abs(before)
    return np.stack([first, end], axis=1)[moving & abrupt]


def _frozen(signals, joint, what, found, moving):
    in_row = found[:, 1] - found[:, 0]
    count = int(np.sum(in_row))
    share = count / len(signals.time)
    squares = np.sum(in_row * (in_row + 1) * (2 * in_row + 1)) / 6  # of 1, 2, ... periods
    late = signals.period * np.sqrt(squares / max(moving, 1))
    if count < limits.FROZEN or share < limits.FROZEN_WARN or late < limits.FROZEN_LATE:
        return
    longest = found[np.argmax(in_row)]
    span = signals.time[longest[1]] - signals.time[longest[0]]
    yield Fault('frozen', joint, 'refuse' if share > limits.FROZEN_REFUSE else 'warn',
                f'{signals.source}: {what} the same in {count} samples ({100 * share:.2g} %) '
                f'in the middle of motion, longest {1e3 * span:.4g} ms at '
                f'{signals.time[longest[0]]:.3f} s: samples are repeated; record the source '
                'at its own rate')


def _jumps(signals, joint, side, q, unit):
    known = np.isfinite(q)
    time, q = signals.time[known], q[known]
    jumps, top = analysis.jumps(time, q, signals.period)
    moves = np.diff(q)
    moves[jumps - 1] = 0.0
    if jumps.size and np.ptp(np.cumsum(moves)) > limits.TRAVEL * unit:  # else it gives way once
        worst = jumps[0]
        yield Fault('jump', joint, 'refuse', f'{signals.source}: the {side} angle of {joint} '
                    f'jumps {jumps.size} times, most by {q[worst] - q[worst - 1]:.4g} rad in '
                    f'one sample at {time[worst]:.3f} s (at full speed it moves '
                    f'{top:.2g}); unwrap the angle, or cut the recording there: a clock '
                    'that was set back by whole periods looks like this too')
