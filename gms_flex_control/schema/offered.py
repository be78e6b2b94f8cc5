# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The range of a parameter that a slider is offered: about its value, unlike what is allowed."""

import math

REACH = 5.0             # times the value, at least
_ENDS = (1.0, 2.0, 5.0, 10.0)
_ROUNDING = 1.0 - 1e-9  # five times 0.2 ends at 1, whatever the last bit says


def offered_range(key, value):
    """
    Return the range that a slider for a live number is offered.

    Parameters
    ----------
    key : Key
        Of kind ``double``.
    value : float
        What holds now, within the range of the key.

    Returns
    -------
    tuple of float or None
        From the least value allowed to 5 to 12.5 times the present one, rounded to 1, 2 or 5
        times a power of ten, or to the largest allowed; to infinity where the value is 0 and so
        says nothing of its size. None for what may be negative without bound, such as an angle.

    Notes
    -----
    What is allowed has to fit a finger and a crane, eight powers of ten apart, and the sliders
    of rqt_reconfigure are linear, of 100 positions; where one end is infinite they follow the
    arc tangent, which resolves 0.02 to 60.

    """
    if math.isinf(key.lower):
        return None
    return key.lower, min(_above(REACH * value), key.upper) if value > 0.0 else math.inf


def _above(number):
    """Return the next 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(number))
    return next(end * power for end in _ENDS if end * power >= _ROUNDING * number)
