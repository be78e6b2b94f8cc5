# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Encoders and the velocity estimate made from them."""

from dataclasses import dataclass

from gms_flex_control.params.checks import freeze_arrays, require_finite, require_shape
import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class EncoderParams:
    """
    What is measured on both sides of the joints.

    Parameters
    ----------
    counts : ndarray, shape ()
        Counts per revolution of every encoder; 0 is an ideal one.
    noise : ndarray, shape ()
        Standard deviation added before the counting [rad].
    velocity_cutoff : ndarray, shape ()
        Cut-off of the low-pass on the differenced angle [Hz]; 0 reads the true velocity.

    Raises
    ------
    ParameterError
        If a value is negative or not finite.

    """

    counts: np.ndarray = 0.0
    noise: np.ndarray = 0.0
    velocity_cutoff: np.ndarray = 0.0

    def __post_init__(self):
        freeze_arrays(self)
        for name in ('counts', 'noise', 'velocity_cutoff'):
            value = getattr(self, name)
            require_shape(f'encoder {name}', value, ())
            require_finite(f'encoder {name}', value, at_least=0.0)
