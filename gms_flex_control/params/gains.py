# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Gains of the cascade controller and of its friction observer."""

from dataclasses import dataclass, fields

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.checks import freeze_arrays, require_finite, require_shape
import numpy as np

# gms_paper is the paper's observer, corrected, with tanh; gms the better one, with the sign of the
# last motion, a command filter on the estimate and a bounded gain; see control.compensation
COMPENSATIONS = ('none', 'gms_paper', 'gms', 'stribeck', 'lugre', 'gms_desired', 'gms_adaptive',
                 'disturbance_observer')


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerParams:
    """
    Gains per joint and the kind of friction compensation.

    ParameterError if a gain is not finite or has the wrong sign, or the compensation is unknown.
    """

    compensation: str             # one of COMPENSATIONS
    kd_link: np.ndarray           # (n,) K_D1 of the link law (11) [N m s/rad]
    lambda_link: np.ndarray       # (n,) Lambda_1 [1/s]
    kd_motor: np.ndarray          # (n,) K_D2 of the motor law (27) [N m s/rad]
    lambda_motor: np.ndarray      # (n,) Lambda_2 [1/s]
    observer_gain: np.ndarray     # (n,) k_e: how much the tracking error corrects slipping blocks
    sign_slope: np.ndarray        # (n,) k_v of r(v) = tanh(k_v v), gms_paper and stribeck [s/rad]
    filter_bandwidth: np.ndarray  # (n,) of the command filter on the friction estimate [rad/s]
    torque_limit: np.ndarray      # (n,) largest motor torque the controller asks for [N m]

    def __post_init__(self):
        if self.compensation not in COMPENSATIONS:
            raise ParameterError(f"compensation must be one of {', '.join(COMPENSATIONS)}, "
                                 f'got {self.compensation!r}')
        freeze_arrays(self, skip=('compensation',))
        for name in GAINS:
            value = getattr(self, name)
            require_shape(name, value, self.kd_link.shape)
            require_finite(name, value, at_least=0.0)
        for name in ('filter_bandwidth', 'sign_slope'):
            require_finite(name, getattr(self, name), above=0.0)


# with a value per joint, as a controller file has them
GAINS = tuple(one.name for one in fields(ControllerParams) if one.name != 'compensation')
