# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction parameters of n joints with N Maxwell-slip blocks each."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.key import (
    freeze_arrays,
    keys_of,
    number,
    of_joints,
    require_finite,
    require_ranges,
    require_shape,
    SMALLEST,
)
import numpy as np

WEIGHT_TOLERANCE = 1e-6  # of the sum of a joint's weights


@dataclass(frozen=True, kw_only=True, eq=False)
class StribeckParams:
    """
    Steady-state friction in one direction of motion, each (n_joints,) (Eq. 4 and Table 1).

    ParameterError if a value is not finite, out of range, or static lies below coulomb.
    """

    static: np.ndarray = number('static friction F_s', 'N m', lower=SMALLEST)
    coulomb: np.ndarray = number('Coulomb friction F_c', 'N m', lower=SMALLEST)
    velocity: np.ndarray = number('Stribeck velocity v_s', 'rad/s', lower=SMALLEST)
    viscous: np.ndarray = number('viscous friction sigma_2', 'N m s/rad', lower=0.0)

    def __post_init__(self):
        freeze_arrays(self)
        require_ranges(self, self.static.shape)
        if np.any(self.static < self.coulomb):
            raise ParameterError(
                f'static {self.static} is below coulomb {self.coulomb}: '
                'the Stribeck curve would rise with speed; were they swapped?')

    def scaled(self, **factors) -> 'StribeckParams':
        """Return it with some values, by their names, times a number or an array (n_joints,)."""
        return replace(self, **{name: factor * getattr(self, name)
                                for name, factor in factors.items()})


STRIBECK = tuple(key.name for key in keys_of(StribeckParams))


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionParams:
    """
    GMS friction of n joints with N blocks each (Eqs. 2 to 5, Tables 1 to 3).

    ``stiffness`` and ``weight`` are (n, N), ``attraction`` (n,): how fast a slipping block nears
    its level.

    ParameterError if a shape does not fit, a value is out of range or the weights do not sum to 1.
    """

    forward: StribeckParams   # for positive velocity
    backward: StribeckParams
    stiffness: np.ndarray = number('stiffness k_i of each block', 'N m/rad', lower=0.0,
                                   kind='double_array')
    weight: np.ndarray = number('share alpha_i of each block, sum 1', '1', lower=0.0,
                                kind='double_array')
    attraction: np.ndarray = number('C of the slipping blocks', 'N m/s', lower=SMALLEST)

    def __post_init__(self):
        freeze_arrays(self, skip=('forward', 'backward'))
        n = len(self.forward.static)
        require_shape('backward', self.backward.static, (n,))
        require_shape('attraction', self.attraction, (n,))
        if self.stiffness.ndim != 2 or len(self.stiffness) != n:
            raise ParameterError(f'block stiffness must have shape ({n}, n_blocks), '
                                 f'got {self.stiffness.shape}')
        require_shape('block weight', self.weight, self.stiffness.shape)
        require_finite('block stiffness', self.stiffness, at_least=0.0)
        require_finite('block weight', self.weight, at_least=0.0)
        require_finite('attraction', self.attraction, above=0.0)
        if not np.allclose(self.weight.sum(axis=1), 1.0, atol=WEIGHT_TOLERANCE):
            raise ParameterError(f'block weights must sum to 1 per joint, got sums '
                                 f'{self.weight.sum(axis=1)}; divide them by their sum')

    def each_way(self, change: Callable[[StribeckParams], StribeckParams],
                 **others) -> 'FrictionParams':
        """Return it with both directions changed by a function, and other fields replaced."""
        return replace(self, forward=change(self.forward), backward=change(self.backward),
                       **others)

    def of_joints(self, columns: list) -> 'FrictionParams':
        """Return the friction of some joints (list of int), in that order; one may come twice."""
        return of_joints(self, columns, forward=of_joints(self.forward, columns),
                         backward=of_joints(self.backward, columns))
