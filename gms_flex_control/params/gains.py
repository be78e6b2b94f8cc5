# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Gains of the cascade controller and of its friction observer."""

from dataclasses import dataclass

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.checks import freeze_arrays, require_finite, require_shape
import numpy as np

COMPENSATIONS = ('none', 'gms_paper', 'gms', 'stribeck', 'lugre', 'gms_desired', 'gms_adaptive',
                 'disturbance_observer')


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerParams:
    """
    Gains per joint and the kind of friction compensation.

    Parameters
    ----------
    compensation : str
        ``none``; ``gms_paper``, the paper's observer, corrected, with tanh; ``gms``, the better
        one: sign of the last motion, command filter on the estimate, bounded observer gain.
        For comparison ``stribeck``, ``lugre``, ``gms_desired`` (driven by the reference),
        ``gms_adaptive`` and ``disturbance_observer``; see control.compensation.
    kd_link, lambda_link : ndarray, shape (n_joints,)
        K_D1 [N m s/rad] and Lambda_1 [1/s] of the link law (11).
    kd_motor, lambda_motor : ndarray, shape (n_joints,)
        K_D2 [N m s/rad] and Lambda_2 [1/s] of the motor law (27).
    observer_gain : ndarray, shape (n_joints,)
        k_e, how strongly the tracking error corrects slipping blocks.
    sign_slope : ndarray, shape (n_joints,)
        k_v of r(v) = tanh(k_v v), modes gms_paper and stribeck [s/rad].
    filter_bandwidth : ndarray, shape (n_joints,)
        Natural frequency of the command filter on the friction estimate, all modes but
        none and gms_paper [rad/s].
    torque_limit : ndarray, shape (n_joints,)
        Largest motor torque the controller asks for [N m].

    Raises
    ------
    ParameterError
        If a gain is not finite or has the wrong sign, or the compensation is unknown.

    """

    compensation: str
    kd_link: np.ndarray
    lambda_link: np.ndarray
    kd_motor: np.ndarray
    lambda_motor: np.ndarray
    observer_gain: np.ndarray
    sign_slope: np.ndarray
    filter_bandwidth: np.ndarray
    torque_limit: np.ndarray

    def __post_init__(self):
        if self.compensation not in COMPENSATIONS:
            raise ParameterError(f"compensation must be one of {', '.join(COMPENSATIONS)}, "
                                 f'got {self.compensation!r}')
        freeze_arrays(self, skip=('compensation',))
        for name in ('kd_link', 'lambda_link', 'kd_motor', 'lambda_motor', 'observer_gain',
                     'sign_slope', 'filter_bandwidth', 'torque_limit'):
            value = getattr(self, name)
            require_shape(name, value, self.kd_link.shape)
            require_finite(name, value, at_least=0.0)
        for name in ('filter_bandwidth', 'sign_slope'):
            require_finite(name, getattr(self, name), above=0.0)
