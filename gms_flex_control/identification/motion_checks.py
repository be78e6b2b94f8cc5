# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Faults of angles and rates: too little motion, jumps, frozen or missing samples, wrong rates."""

from gms_flex_control.data.signals import (
    derivative_slope,
    derivative_window,
    is_moving,
    quantum,
    smoothed,
)
from gms_flex_control.identification.findings import Finding
import numpy as np

FEWEST, SHORTEST, SHORT = 200, 2.0, 4.0  # samples; refused and warned about below [s]
ONE_WAY = 0.03                           # of the travel goes the other way
_BESIDE = 5                              # samples that tell the velocity beside a run


def length(signals):
    """Return a finding if the recording (Signals) is too short."""
    count, duration = len(signals.time), float(signals.time[-1])
    if count >= FEWEST and duration >= SHORT:
        return []
    severity = 'refuse' if count < FEWEST or duration < SHORTEST else 'warn'
    return [Finding('too_short', '', severity, f'{signals.source}: {count} samples in '
                    f'{duration:.3g} s are too short to tell friction from inertia; record at '
                    f'least {SHORT:g} s and {FEWEST} samples, with motion both ways')]


def missing(signals, robot):
    """Return findings for numbers (Signals, RobotParams) that are not there."""
    found = []
    for j, joint in enumerate(signals.joints):
        flexible = not robot.arm.rigid[j]
        channels = [('link angle', signals.q_link[:, j], True),
                    ('torque', signals.tau_motor[2:, j], not flexible)]
        if flexible:
            no_twist = not np.isfinite(signals.tau_motor[2:, j]).any()
            channels.insert(1, ('motor angle', signals.q_motor[:, j], no_twist))
        for name, values, needed in channels:
            found += _holes(signals, joint, name, values, needed)
    return found


def _holes(signals, joint, name, values, needed):
    lost = np.flatnonzero(~np.isfinite(values))
    share = lost.size / len(values)
    if share == 1.0:
        severity = 'refuse' if needed else 'warn'
        text = (f'the {name} of {joint} was not recorded' + (
            '; nothing can be fitted without it' if needed else
            '; what it alone tells cannot be had: record it as well'))
    elif share >= 0.001 or lost.size > 10:
        severity = 'refuse' if share > 0.3 else 'warn'
        runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], ~np.isfinite(values), [0]]))))
        text = (f'the {name} of {joint} is no number in {lost.size} samples '
                f'({100 * share:.2g} %), {int(runs[::2].max())} in a row, first at '
                f'{signals.time[lost[0]]:.3f} s; leave that part out')
    else:
        return
    yield Finding('missing', joint, severity, f'{signals.source}: {text}')


def motion(signals):
    """
    Return findings of joints (Signals) that stand still or move one way only.

    Kinds 'still' and 'one_direction'.
    """
    found, still = [], []
    for j, joint in enumerate(signals.joints):
        q = signals.q_link[:, j]
        if np.isfinite(q).sum() < FEWEST:
            continue
        filtered, = smoothed(signals.time, [q], derivative_window(signals.time, q))
        if not len(filtered.value):
            continue
        noise = np.nanstd(np.diff(q)) / np.sqrt(2)
        if np.ptp(filtered.value) <= 3 * max(quantum(q), min(noise, np.ptp(filtered.value))):
            still.append((joint, float(np.nanmax(q) - np.nanmin(q))))
        else:
            found += _one_way(signals.source, joint, filtered)
    for joint, travel in still:
        found.append(Finding(
            'still', joint, 'refuse' if len(still) == len(signals.joints) else 'warn',
            f'{signals.source}: {joint} never moves (by {travel:.3g} rad at most, which its '
            'encoder hardly resolves); none of its parameters can be had from this recording'))
    return found


def _one_way(source, joint, filtered):
    steps = np.diff(filtered.value)[is_moving(filtered.first)[1:]]
    forward, backward = steps[steps > 0].sum(), -steps[steps < 0].sum()
    if min(forward, backward) >= ONE_WAY * max(forward, backward):
        return
    way, other = ('forward', 'backward') if forward > backward else ('backward', 'forward')
    yield Finding('one_direction', joint, 'warn', f'{source}: {joint} moves {way} only '
                  f'({max(forward, backward):.3g} rad against {min(forward, backward):.2g}): '
                  f'friction.{joint}.{other} cannot be had, nor friction be told from a constant '
                  'torque; add motion the other way')


def rates(signals):
    """Return findings of rates, of a Signals, that are not the derivative of their angle."""
    found = []
    for j, joint in enumerate(signals.joints):
        for side, q, dq in signals.sides(j):
            judged = derivative_slope(signals.time, q, dq)
            if judged is None or (0.85 < judged[0] < 1.15 and judged[1] > 0.9):
                continue
            slope, fit = judged
            mild = 0.7 < slope < 1.4 and fit > 0.8
            found.append(Finding(
                'velocity', joint, 'warn' if mild else 'refuse', f'{signals.source}: the {side} '
                f'velocity of {joint} is not the derivative of its angle but {slope:.3g} times '
                f'it (correlation {fit:.2f}); correct unit, sign or time, or leave the velocity '
                'out'))
    return found


def broken(signals):
    """
    Return findings of single samples (Signals) that cannot be motion.

    Kinds 'jump' (angle) and 'frozen' (samples repeated while the joint moves).
    """
    found, rows = [], _repeated_rows(signals)
    caught = [np.empty((0, 2), dtype=int)]
    for j in range(len(signals.joints)):
        q, top = signals.q_link[:, j], _top_step(signals.q_link[:, j])
        caught.append(_while_moving(q, rows, max(0.6 * quantum(q), 0.05 * top)))
    rows = np.unique(np.concatenate(caught), axis=0)
    found += _frozen(signals, '', 'all channels stay', rows)
    for j, joint in enumerate(signals.joints):
        for side, q, _ in signals.sides(j):
            top, unit = _top_step(q), quantum(q)
            grain = max(unit, 3 * _noise(q))
            runs = _while_moving(q, _runs(np.diff(q) == 0), max(3 * grain, 0.05 * top))
            if not found or found[0].joint:
                found += _frozen(signals, joint, f'the {side} angle of {joint} stays', runs)
            held = np.concatenate([rows[:, 1], runs[:, 1]])
            found += _jumps(signals, joint, side, q, (top, unit), held)
    return found


def _top_step(q):
    """Return about how far the angle moves at most in one sample."""
    across = np.abs(q[2 * _BESIDE:] - q[:-2 * _BESIDE]) / (2 * _BESIDE)
    across = across[np.isfinite(across)]
    # a jump adds but a tenth of itself to this
    return 1.5 * float(across.max()) if across.size else 0.0


def _noise(q):
    """Return about the standard deviation of the noise of an angle (T,)."""
    bends = np.abs(np.diff(q, 2))
    bends = bends[np.isfinite(bends)]
    return float(np.median(bends)) / (0.6745 * np.sqrt(6)) if bends.size else 0.0


def _runs(equal):
    """Return (first, last) sample of each run (R, 2) of samples equal to the one before."""
    edges = np.diff(np.concatenate([[False], equal, [False]]).astype(np.int8))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


def _repeated_rows(signals):
    """Return the runs of samples repeated in every channel, where a joint's always change else."""
    same = np.ones(len(signals.time) - 1, dtype=bool)
    lively = np.zeros(len(signals.joints), dtype=bool)
    for j in range(len(signals.joints)):
        angles = [signals.q_link[:, j], signals.q_motor[:, j]]
        others = [values for values in (signals.dq_link[:, j], signals.dq_motor[:, j],
                                        signals.tau_motor[:, j]) if np.isfinite(values).any()]
        lively[j] = len(others) > 1 and all(_never_repeats(values) for values in others)
        for values in [*angles, *others]:
            if np.isfinite(values).any():
                same &= np.diff(values) == 0
    return _runs(same) if lively.any() else np.empty((0, 2), dtype=int)


def _never_repeats(values):
    """Tell whether a signal (T,) hardly ever takes a value again, apart from standing still."""
    changed = values[1:20000][np.diff(values[:20000]) != 0]
    return len(np.unique(changed)) > max(0.8 * len(changed), FEWEST / 2)


def _while_moving(q, runs, step):
    """Return the runs on both sides of which the angle goes the same way by ``step`` a sample."""
    runs = runs[(runs[:, 0] >= _BESIDE) & (runs[:, 1] + _BESIDE < len(q))]
    before = (q[runs[:, 0]] - q[runs[:, 0] - _BESIDE]) / _BESIDE
    after = (q[runs[:, 1] + _BESIDE] - q[runs[:, 1]]) / _BESIDE
    last, following = (q[runs[:, 0]] - q[runs[:, 0] - 1], q[runs[:, 1] + 1] - q[runs[:, 1]])
    same_way = (before * after > 0) & (before * last > 0) & (before * following > 0)
    moving = (np.minimum(np.abs(before), np.abs(after)) > step) & same_way
    # a joint that comes to rest and starts again has slow samples on both sides
    abrupt = np.maximum(np.abs(last), np.abs(following)) > 0.5 * np.abs(before)
    return runs[moving & abrupt]


def _caught_up(q, runs, steps, odd):
    """Reduce in place how odd (T-1,) the steps after frozen runs are that only catch up."""
    runs = runs[(runs[:, 0] >= _BESIDE) & (runs[:, 1] + 1 + _BESIDE < len(q))]
    first, last = runs.T
    before = (q[first] - q[first - _BESIDE]) / _BESIDE
    after = (q[last + 1 + _BESIDE] - q[last + 1]) / _BESIDE
    expected = 0.5 * (before + after) * (last - first + 1)
    odd[last] = np.minimum(odd[last], np.abs(steps[last] - expected))


def _frozen(signals, joint, what, runs):
    count = int(np.sum(runs[:, 1] - runs[:, 0]))
    share = count / len(signals.time)
    if count < 5 or share < 0.002:
        return
    longest = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    span = signals.time[longest[1]] - signals.time[longest[0]]
    yield Finding('frozen', joint, 'refuse' if share > 0.3 else 'warn',
                  f'{signals.source}: {what} the same in {count} samples ({100 * share:.2g} %) '
                  f'in the middle of motion, longest {1e3 * span:.4g} ms at '
                  f'{signals.time[longest[0]]:.3f} s: samples are repeated; record the source '
                  'at its own rate')


def _jumps(signals, joint, side, q, scales, held):
    top, unit = scales
    steps = np.diff(q)
    steps = np.where(np.isfinite(steps), steps, 0.0)
    elapsed = np.diff(signals.time)
    steps *= np.minimum(signals.period / elapsed, 1.0)
    if len(steps) < 20:
        return
    padded = np.pad(steps, 2, mode='edge')
    around = np.median([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    odd = np.abs(steps - around)
    limit = max(3 * np.quantile(odd, 0.99), 4 * unit, 2 * top)
    _caught_up(q, _runs(steps == 0), steps, odd)
    jumps = np.setdiff1d(np.flatnonzero(odd > limit), held)
    # where the clock is wrong, so are the steps
    trusted = np.pad(elapsed, 2, mode='edge')
    trusted = np.min([trusted[:-4], trusted[1:-3], elapsed, trusted[3:-1], trusted[4:]], axis=0)
    jumps = jumps[(trusted[jumps] > 0.5 * signals.period)
                  & (elapsed[jumps] < 5 * signals.period)]
    if jumps.size:
        worst = jumps[np.argmax(odd[jumps])]
        yield Finding('jump', joint, 'refuse', f'{signals.source}: the {side} angle of {joint} '
                      f'jumps {jumps.size} times, most by {q[worst + 1] - q[worst]:.4g} rad in '
                      f'one sample at {signals.time[worst + 1]:.3f} s (at full speed it moves '
                      f'{top:.2g}); unwrap the angle, or cut the recording there: a clock '
                      'that was set back by whole periods looks like this too')
