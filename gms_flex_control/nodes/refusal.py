# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Why a message is not acted on: numbers, lengths and names that make no sense."""

import math

# Beyond these a number is a fault, though it is finite: 1e308 overflows in any law.
LARGEST_STATE = 1e6        # [rad, rad/s]
LARGEST_TORQUE = 1e9       # [N m]
LARGEST_DERIVATIVE = 1e15  # of a reference, up to the fourth [rad/s^4]
_ROWS = ('q', 'dq', 'ddq', 'd3q', 'd4q')
_NAMED = 8  # joint names in a sentence; a message may have a million


class RefusedError(ValueError):
    """A message that is not acted on; the sentence says why."""


def all_finite(values):
    """Return whether no number is NaN or infinite; fast for a handful of them."""
    # NaN and both infinities turn the sum into NaN or infinity
    return math.isfinite(sum(values)) or all(math.isfinite(value) for value in values)


def first_bad(values, limit):
    """Return the index of the first number that is not within +-``limit``; None if all are."""
    # a sum that is finite has no NaN in it, for which min and max are of no use
    if not values or (math.isfinite(sum(values)) and -limit <= min(values)
                      and max(values) <= limit):
        return None
    return next((k for k, value in enumerate(values) if not abs(value) <= limit), None)


def _some(names):
    more = f' and {len(names) - _NAMED} more' if len(names) > _NAMED else ''
    return ', '.join(name[:80] for name in names[:_NAMED]) + more


def order_of(wanted, names, what='joint states'):
    """
    Return where each of the ``wanted`` joints stands among ``names`` of ``what``.

    Raises
    ------
    RefusedError
        If one is missing or stands there twice; other names do not matter.

    """
    order = []
    for name in wanted:
        count = names.count(name)
        if count == 0:
            raise RefusedError(f'{what} lack {name!r} (have {_some(names)}); '
                               'check joints and motors in the robot file')
        if count > 1:
            raise RefusedError(f'{what} name {name!r} more than once')
        order.append(names.index(name))
    return order


def refuse_bad_reference(data, effort, n):
    """Raise RefusedError, with row, joint and index, for a bad number in a reference."""
    limits = (((0, n, LARGEST_TORQUE),) if effort else
              ((0, 2 * n, LARGEST_STATE), (2 * n, 5 * n, LARGEST_DERIVATIVE)))
    for begin, end, limit in limits:
        bad = first_bad(data[begin:end], limit)
        if bad is not None:
            row, joint = divmod(begin + bad, n)
            name = 'effort' if effort else _ROWS[row]
            raise RefusedError(f'reference has {name} {data[begin + bad]} for joint {joint + 1} '
                               f'(data[{begin + bad}])')
