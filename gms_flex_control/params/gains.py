# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Gains of the cascade controller and of its friction observer."""

from dataclasses import dataclass

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.key import freeze_arrays, keys_of, LARGEST, number, require_ranges
import numpy as np

# gms_paper is the paper's observer, corrected, with tanh; gms the better one, with the sign of the
# last motion, a command filter on the estimate and a bounded gain; see control.compensation
COMPENSATIONS = ('none', 'gms_paper', 'gms', 'stribeck', 'lugre', 'gms_desired', 'gms_adaptive',
                 'disturbance_observer')


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerParams:
    """Gains (n_joints,) each, and the compensation; ParameterError if one is impossible."""

    compensation: str  # one of COMPENSATIONS
    kd_link: np.ndarray = number('K_D1 of the link law', 'N m s/rad', lower=0.0, upper=LARGEST,
                                 live=True)  # Eq. (11)
    lambda_link: np.ndarray = number('Lambda_1 of the link law', '1/s', lower=0.0, upper=1e4,
                                     live=True)
    kd_motor: np.ndarray = number('K_D2 of the motor law', 'N m s/rad', lower=0.0, upper=LARGEST,
                                  live=True)  # Eq. (27)
    lambda_motor: np.ndarray = number('Lambda_2 of the motor law', '1/s', lower=0.0, upper=1e4,
                                      live=True)
    observer_gain: np.ndarray = number(
        'k_e, correction of slipping blocks by the tracking error', '', 1.0, 0.0, 1e6, live=True)
    sign_slope: np.ndarray = number(
        'k_v of tanh(k_v v), gms_paper and stribeck only', 's/rad', 50.0, 1e-3, 1e6, live=True)
    filter_bandwidth: np.ndarray = number(
        'command filter on the friction estimate, all modes but none and gms_paper', 'rad/s',
        100.0, 1e-3, 1e5, live=True)
    torque_limit: np.ndarray = number('largest motor torque', 'N m', lower=0.0, upper=LARGEST,
                                      live=True)

    def __post_init__(self):
        if self.compensation not in COMPENSATIONS:
            raise ParameterError(f"compensation must be one of {', '.join(COMPENSATIONS)}, "
                                 f'got {self.compensation!r}')
        freeze_arrays(self, skip=('compensation',))
        require_ranges(self, self.kd_link.shape)


GAINS = tuple(key.name for key in keys_of(ControllerParams))  # with a value per joint
