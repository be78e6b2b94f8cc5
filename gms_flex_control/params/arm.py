# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Inertia, stiffness and gravity of an arm with flexible or rigid joints."""

from dataclasses import dataclass

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.checks import freeze_arrays, require_finite, require_shape
import numpy as np

KINDS = ('planar', 'decoupled')
AXES = ('rotary', 'linear')


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmParams:
    """
    Rigid-body and joint parameters of n joints.

    Parameters
    ----------
    kind : {'planar', 'decoupled'}
        A chain of links in one plane, or axes that do not act on each other.
    mass, length, com, inertia : ndarray, shape (n_joints,)
        Of each link: mass [kg], distance to the next joint [m], distance of its centre of mass
        from its own joint [m], inertia about the centre of mass [kg m^2]. A decoupled axis may
        give its whole inertia with mass 0.
    motor_inertia : ndarray, shape (n_joints,)
        J, reflected to the joint [kg m^2].
    stiffness, damping : ndarray, shape (n_joints,)
        K [N m/rad] and damping [N m s/rad] of the joint's spring; an infinite stiffness is a
        rigid joint, which has no motor side of its own.
    gravity : ndarray, shape (2,) or float
        Gravity in the plane (x, y) [m/s^2]; a number g stands for (0, -g). 0 is a horizontal
        plane.
    offset : ndarray, shape (n_joints,), optional
        Where a joint reads 0: angle of its link from the x axis, or in a chain from the link
        before it [rad]. Zeros by default.
    axes : {'rotary', 'linear'}
        What decoupled axes are; of linear ones m stands for rad, N for N m, kg for kg m^2.

    Raises
    ------
    ParameterError
        If a value is not finite, negative where it must not be, or the arm has no inertia.

    """

    kind: str
    mass: np.ndarray
    length: np.ndarray
    com: np.ndarray
    inertia: np.ndarray
    motor_inertia: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    gravity: np.ndarray = 0.0
    offset: np.ndarray | None = None
    axes: str = 'rotary'

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ParameterError(f"arm.kind must be one of {', '.join(KINDS)}, got {self.kind!r}")
        if self.axes not in AXES:
            raise ParameterError(f"arm.axes must be one of {', '.join(AXES)}, got {self.axes!r}")
        if self.axes == 'linear' and self.kind != 'decoupled':
            raise ParameterError(f'arm.axes linear needs arm.kind decoupled, got {self.kind}')
        if self.offset is None:
            object.__setattr__(self, 'offset', np.zeros(np.shape(self.stiffness)))
        freeze_arrays(self, skip=('kind', 'axes'))
        if self.gravity.shape == ():
            object.__setattr__(self, 'gravity', np.array([0.0, -float(self.gravity)]))
        require_shape('gravity', self.gravity, (2,))
        require_finite('gravity', self.gravity)
        for name in ('mass', 'length', 'com', 'inertia', 'motor_inertia', 'damping', 'offset'):
            require_shape(name, getattr(self, name), self.stiffness.shape)
        for name in ('mass', 'length', 'inertia', 'motor_inertia', 'damping'):
            require_finite(name, getattr(self, name), at_least=0.0)
        require_finite('com', self.com)
        require_finite('offset', self.offset)
        self._require_inertia()

    def _require_inertia(self):
        if not np.all(self.stiffness > 0.0):
            raise ParameterError(f'stiffness must be above 0 (.inf for a rigid joint), '
                                 f'got {self.stiffness}')
        flexible = ~self.rigid
        if np.any(self.motor_inertia[flexible] == 0.0):
            raise ParameterError(f'motor_inertia must be above 0 where the joint is flexible, '
                                 f'got {self.motor_inertia}; a rigid joint has stiffness .inf')
        about_joint = self.inertia + self.mass * self.com ** 2
        about_joint = about_joint + np.where(self.rigid, self.motor_inertia, 0.0)
        if np.any(about_joint <= 0.0):
            raise ParameterError(f'each link needs inertia or mass away from its joint, '
                                 f'got inertia {self.inertia}, mass {self.mass}, com {self.com}')

    @property
    def n_joints(self):
        """Return the number of joints."""
        return len(self.stiffness)

    @property
    def rigid(self):
        """Return which joints have no motor side of their own, bool (n_joints,)."""
        return np.isinf(self.stiffness)
