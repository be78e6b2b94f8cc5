# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Units in which torques and angles are told: those of a desk arm, or of a press."""

from typing import NamedTuple

import numpy as np


class Scale(NamedTuple):
    """A unit, and how many of it one SI unit is."""

    unit: str
    factor: float

    def told(self, value):
        """Return a value in SI units as a number of this unit, three digits; '-' if it is none."""
        return f'{self.factor * value:.3g}' if np.isfinite(value) else '-'


_TORQUES = ((0.9, Scale('mN m', 1e3)), (900.0, Scale('N m', 1.0)), (np.inf, Scale('kN m', 1e-3)))
_ANGLES = ((0.9, Scale('mrad', 1e3)), (np.inf, Scale('rad', 1.0)))


def torque_scale(values):
    """Return the Scale that suits torques (any shape) [N m]."""
    return _suiting(_TORQUES, values)


def angle_scale(values):
    """Return the Scale that suits angles (any shape) [rad]."""
    return _suiting(_ANGLES, values)


def _suiting(scales, values):
    sizes = np.abs(np.asarray(values, dtype=float))
    largest = float(np.max(sizes, where=np.isfinite(sizes), initial=0.0))
    return next(scale for limit, scale in scales if largest < limit)
