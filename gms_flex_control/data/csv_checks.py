# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What looks wrong in an imported log; each finding names the column and the line."""

import re
from typing import NamedTuple

from gms_flex_control.data.csv_map import (
    canonical,
    FORCE,
    LENGTH,
    POSITION,
    POSITION_OF,
    TORQUE,
    UNITS,
)
from gms_flex_control.data.signal_analysis import (
    derivative_slope,
    derivative_window,
    friction_columns,
    is_moving,
    quantum,
    sign_fit,
    smoothed,
)
import numpy as np

# what a velocity is of the derivative of its position when units were mixed up
_MIX_UPS = {57.29578: 'deg/s taken as rad/s', 1 / 57.29578: 'rad/s taken as deg/s',
            9.549297: 'rpm taken as rad/s', 1 / 9.549297: 'rad/s taken as rpm',
            6.0: 'rpm taken as deg/s', 1 / 6.0: 'deg/s taken as rpm',
            6.283185: 'rad/s taken as turn/s or the like', 1000.0: 'a factor of 1000',
            1e-3: 'a factor of 1000'}
# beyond these something looks wrong
_PERIOD = (1e-5, 0.5)    # median of a time column [s]
_GAP = 5.0               # periods without a sample
_SPAN = 100.0            # of a position [rad]
_JUMP_LEAST = 3.5        # steps of the encoder,
_JUMP_USUAL = 5.0        # times the 99 % quantile of all steps
_JUMP_AROUND = 4.0       # and times the steps around it
_TURN = 0.05             # a jump this near to a turn is one, relative
_SLOPE = (0.85, 1.15)    # of a velocity over the derivative of its position,
_CORRELATION = 0.9       # and how much alike they are at least
_MIX_UP = 0.1            # a slope this near to one of _MIX_UPS is one, relative
_SIDES = (0.5, 2.0)      # way of the motor over that of the link, where the two
_ALIKE = 0.97            # move alike: a soft joint deflects as far as it moves
_FEWEST_STEPS = 10       # of a position that can jump
_FEWEST = 100            # samples with angle and torque for a judgement of the torque,
_FEWEST_MOVING = 40      # of them (smoothed) in motion
_TRAVEL = 20.0           # steps of the encoder gone at least
_LEFT = 0.01             # share of the torque's variance that motion may explain
_EXPLAINED = 0.5         # share of that which it explains,
_REVERSED = 0.3          # so much more of it with the sign reversed
_DRIVEN = 0.5             # of the size of its power: a torque that does so much work drives
_FRICTION = (1e-5, 1e5)  # of a recorded machine [N m]


class Suspicion(NamedTuple):
    """One thing that looks wrong."""

    kind: str   # 'gap', 'empty', 'constant', 'jump', 'velocity', 'unit', 'scale', 'rate', 'sign'
    place: str  # for instance 'axis1.link_position'
    text: str   # a sentence


def suspicions(table, import_map, time, keep, joints) -> list:
    """
    Return what looks wrong in a log, a list of Suspicion.

    Of a CsvTable (for line numbers) and its ImportMap; ``time`` (T,) [s] and the rows ``keep``
    (T,) of the table, ``joints`` the values in SI per joint and channel (dicts of (T,)).
    """
    lines = table.lines[keep]
    found = list(_sampling(time, lines, import_map.time.rate is None))
    for joint, values in zip(import_map.joints, joints, strict=True):
        for name, channel in joint.channels.items():
            place = f'{joint.name}.{name}'
            if channel.estimate is None:
                what = f'{place} (column {channel.column!r})'
                found += _name_and_unit(what, place, channel)
                found += _values(what, place, values[name], lines)
                if channel.quantity == 'position':
                    found += _jumps(what, place, time, values[name], lines, channel)
                elif name in POSITION_OF and POSITION_OF[name] in values:
                    found += _derivative(what, place, time, values[POSITION_OF[name]],
                                         values[name])
        found += _sides(joint.name, values)
        found += _mixed_units(joint)
    for judged in _torques(import_map, time, joints):
        found += _torque(judged)
    return found


def _sampling(time, lines, has_column):
    steps = np.diff(time)
    period = float(np.median(steps))
    if has_column and not _PERIOD[0] <= period <= _PERIOD[1]:
        yield Suspicion('rate', 'time', f'the median period is {period:.4g} s; is the unit of '
                        'the time column right?')
    gaps = np.flatnonzero(steps > _GAP * period)
    if gaps.size:
        worst = gaps[np.argmax(steps[gaps])]
        yield Suspicion('gap', 'time', f'{gaps.size} gaps of more than {_GAP:g} periods, the '
                        f'longest {steps[worst]:.4g} s before line {lines[worst + 1]}')


def _name_and_unit(what, place, channel):
    named = unit_in_name(channel.column, channel.quantity) if isinstance(
        channel.column, str) else None
    if named and named != channel.unit and channel.unit not in ('pwm', 'A'):
        yield Suspicion('unit', place, f'{what} is mapped as {channel.unit!r} but its name '
                        f'says {named!r}')


def unit_in_name(column, quantity) -> str | None:
    """
    Return the unit a column's name such as ``'speed [rpm]'`` ends in, None if it has none.

    Only units of ``quantity``, a key of ``UNITS``, are looked for.
    """
    text = column.strip().lower().replace('²', '2')
    bracket = re.search(r'[\[(]\s*([^\])]*?)\s*[\])]\s*$', text)
    parts = re.split(r'[_\s.]+', text)
    candidates = [bracket.group(1)] if bracket else [
        '_'.join(parts[-count:]) for count in (3, 2, 1) if len(parts) > count]
    for candidate in candidates:
        if candidate in ('m', 'n', 'a', 'ma') and not bracket:
            continue  # q_m is rather the motor's angle than metres
        for known in UNITS[quantity]:
            if canonical(candidate).lower() == known.lower():
                return known
    return None


def _values(what, place, values, lines):
    empty = np.flatnonzero(np.isnan(values))
    if empty.size:
        yield Suspicion('empty', place, f'{what} has no number in {empty.size} of {len(values)} '
                        f'rows, first in line {lines[empty[0]]}')
    known = values[np.isfinite(values)]
    if known.size and np.ptp(known) == 0:
        yield Suspicion('constant', place, f'{what} is {known[0]:.6g} throughout; is it the '
                        'right column?')


def _jumps(what, place, time, values, lines, channel):
    """Find single steps far above those around them."""
    known = values[np.isfinite(values)]
    if known.size and np.ptp(known) > _SPAN:
        yield Suspicion('scale', place, f'{what} spans {np.ptp(known):.4g} '
                        f'rad with unit {channel.unit!r} and gear_ratio '
                        f'{channel.gear_ratio:g}; are both right?')
    steps = np.abs(np.diff(values)) * np.median(np.diff(time)) / np.diff(time)
    steps[np.isnan(steps)] = 0.0
    if len(steps) < _FEWEST_STEPS or not steps.any():
        return
    smallest = steps[steps > 0].min()
    padded = np.pad(steps, 2)
    around = np.median([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    limit = np.maximum(_JUMP_USUAL * np.quantile(steps, 0.99), _JUMP_LEAST * smallest)
    jumps = np.flatnonzero((steps > limit) & (steps > _JUMP_AROUND * around))
    if jumps.size:
        worst = jumps[np.argmax(steps[jumps])]
        size = values[worst + 1] - values[worst]
        turn = 2 * np.pi * abs(channel.scale) / channel.gear_ratio
        wrapped = abs(abs(size) / turn - 1) < _TURN
        hint = '; one turn: set unwrap: true' if wrapped else ''
        yield Suspicion('jump', place, f'{what} jumps {jumps.size} times, most in line '
                        f'{lines[worst + 1]}: {size:.4g} rad{hint}')


def _derivative(what, place, time, position, velocity):
    """Compare what a velocity adds up to with the way really gone."""
    judged = derivative_slope(time, position, velocity)
    if judged is None:
        return
    slope, fit = judged
    related, right = abs(fit) > _CORRELATION, _SLOPE[0] < abs(slope) < _SLOPE[1]
    if related and right and slope > 0:
        return
    cause = 'the sign is the other way round' if related and right else ''
    for factor, words in _MIX_UPS.items():
        if related and abs(abs(slope) / factor - 1) < _MIX_UP:
            cause = words + (', and the other sign' if slope < 0 else '')
    yield Suspicion('velocity', place, f'{what} is not the derivative of its position: '
                    f'{slope:.4g} times it, correlation {fit:.3f}'
                    + (f' ({cause}?)' if cause else ''))


def _sides(joint, values):
    link, motor = values.get('link_position'), values.get('motor_position')
    if motor is None:
        return
    good = np.isfinite(link) & np.isfinite(motor)
    if not good.any():
        return
    x, y = link[good] - np.mean(link[good]), motor[good] - np.mean(motor[good])
    if not (x.any() and y.any()):
        return
    slope = float(np.dot(x, y) / np.dot(x, x))
    alike = slope * np.dot(x, y) / np.dot(y, y)
    if not _SIDES[0] < slope < _SIDES[1] and alike > _ALIKE:
        yield Suspicion('scale', f'{joint}.motor_position', f'{joint}: the motor moves '
                        f'{slope:.5g} times as far as the link; check sign, unit and gear_ratio '
                        '(motor angles are those seen at the joint)')


def _mixed_units(joint):
    """Find a linear position beside a torque, or an angle beside a force."""
    position = joint.channels['link_position']
    for name in ('torque', 'command'):
        channel = joint.channels.get(name)
        if channel is None or channel.gear_ratio != 1 or position.gear_ratio != 1:
            continue
        if position.unit in LENGTH and channel.unit in TORQUE and TORQUE[
                channel.unit] and channel.unit not in FORCE:
            yield Suspicion('unit', f'{joint.name}.{name}', f'{joint.name}: the position is in '
                            f'{position.unit!r} but {name} in {channel.unit!r}; give the force '
                            'at the slide: gear_ratio: 2 pi over the lead of the screw [rad/m]')
        elif position.unit in POSITION and position.unit not in LENGTH and channel.unit in FORCE:
            yield Suspicion('unit', f'{joint.name}.{name}', f'{joint.name}: the position is an '
                            f'angle ({position.unit!r}) but {name} a force ({channel.unit!r}); '
                            'give the torque: scale: the lever arm [m]')


class _Judged(NamedTuple):
    """What a torque says of its joint."""

    place: str
    what: str
    fit: object       # sign_fit of inertia, Coulomb and viscous friction
    friction: float   # at the largest speed [N m]
    speed: float      # [rad/s]
    work: float       # of the torque, over that of the size of its power


def _torques(import_map, time, joints):
    """Yield a _Judged for every torque or command beside enough motion."""
    for joint, values in zip(import_map.joints, joints, strict=True):
        name = 'torque' if 'torque' in values else 'command'
        if name not in values:
            continue
        q, tau = values.get('motor_position', values['link_position']), values[name]
        if min(np.isfinite(q).sum(), np.isfinite(tau).sum()) < _FEWEST:
            continue
        others = [other.get('motor_position', other['link_position'])
                  for other in joints if other is not values]
        angle, torque, *beside = smoothed(time, [q, tau, *others], derivative_window(time, q))
        rows = is_moving(angle.first)
        if rows.sum() < _FEWEST_MOVING or np.ptp(angle.value) < _TRAVEL * quantum(q):
            continue
        # gravity, springs and balancers may pull either way
        free = [np.ones(int(rows.sum())), angle.value[rows], np.sin(angle.value[rows]),
                np.cos(angle.value[rows]), *(other.second[rows] for other in beside)]
        fit = sign_fit(torque.value[rows], [angle.second[rows], *friction_columns(
            angle.first[rows])], free)
        if fit.left > _LEFT:
            speed = float(np.abs(angle.first).max())
            power = torque.value[rows] * angle.first[rows]
            yield _Judged(f'{joint.name}.{name}', f'{joint.name}.{name} (column '
                          f'{joint.channels[name].column!r})', fit,
                          float(fit.weights[1] + fit.weights[2] * speed), speed,
                          float(np.sum(power) / max(np.sum(np.abs(power)), 1e-300)))


def _torque(judged):
    """Find a torque that accelerates and overcomes friction only with its sign reversed."""
    fit = judged.fit
    if (fit.opposite > _EXPLAINED and fit.opposite > fit.as_is + _REVERSED
            and judged.work < _DRIVEN):
        yield Suspicion('sign', judged.place, f'{judged.what} has the wrong sign: only reversed '
                        'does it accelerate the joint and overcome friction; set sign: -1')
    elif fit.as_is > _EXPLAINED and judged.friction > 0 and not (
            _FRICTION[0] < judged.friction < _FRICTION[1]):
        yield Suspicion('scale', judged.place, f'{judged.what} would mean a friction of '
                        f'{judged.friction:.3g} N m at {judged.speed:.2g} rad/s; check its unit '
                        'and gear_ratio')


def torque_remarks(import_map, time, joints) -> list[str]:
    """
    Return what friction the torques amount to, sentences for a user who knows the machine.

    Arguments as `suspicions`.
    """
    levels = [f'{judged.place} {judged.friction:.2g} N m at {judged.speed:.2g} rad/s'
              for judged in _torques(import_map, time, joints)
              if judged.fit.as_is > _EXPLAINED and judged.friction > 0]
    return levels and [f'friction by the motion, about: {"; ".join(levels)}. If that is not the '
                       'size of this machine, check unit and gear_ratio']
