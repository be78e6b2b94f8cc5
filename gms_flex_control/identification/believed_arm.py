# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The arm that friction is fitted beside: as described, but for what recordings show of it.

A link that is 2 % heavier than described weighs more than a good joint rubs; friction that is
fitted as if links and springs were exact takes the difference for its own.
"""

from collections.abc import Sequence
from dataclasses import replace

from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import rms
from gms_flex_control.identification.arm_regression import ArmRegression, driven_arm
from gms_flex_control.identification.assumed_robot import only_joints
from gms_flex_control.identification.inertial_parameters import (
    all_parameters,
    base_of,
    IN_PLANE,
    sizes_of_body,
)
from gms_flex_control.identification.objective import friction_along
from gms_flex_control.identification.robust_regression import heavy_tailed
from gms_flex_control.identification.segments import driven
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import known_to, RobotParams
import numpy as np

_DIFFERENT = 12.0   # independent errors along recordings: motion repeats, and what a model lacks
_LEAST_SD = 1e-4    # of a base parameter, as of a body of the whole mass: one of 0 has none
_SHOWN = 0.9        # of the torque that links and friction leave, where links are as described:
#                     described rightly they leave 0.97 and more, 1 % off 0.85 and less
_NUMBERS = ('mass', 'com', 'inertia', 'motor_inertia', 'stiffness')


def believed_arm(recordings: Sequence[Recording], robot: RobotParams, thetas: dict | None = None,
                 beside: ArmParams | None = None) -> ArmParams:
    """
    Return the arm that recordings show, hardly farther from the described one than it is known.

    That is the described one unless another explains the torque far better. Base parameters and
    springs have priors by the `uncertainty` of the robot. ``thetas`` are
    parameters of friction by joint, where it was fitted, beside an arm.
    """
    def friction(segment, joints, period):
        torque = np.zeros(segment.torque.shape)
        for j, joint in enumerate(joints):
            if joint in thetas:
                k = robot.joints.index(joint)
                scale = 1.0 if robot.arm.rigid[k] else robot.arm.stiffness[k] / beside.stiffness[k]
                torque[:, j] = scale * friction_along(segment, j, thetas[joint], period)
        return torque
    known = friction if thetas else None
    if robot.arm.kind != 'decoupled':
        return _within_belief(recordings, robot, known)
    arms = [_within_belief([one.of_joints([joint]) for one in recordings],
                           only_joints(robot, [joint]), known) for joint in robot.joints]
    return replace(robot.arm, **{name: np.concatenate([getattr(one, name) for one in arms])
                                 for name in _NUMBERS})


def _within_belief(recordings, robot, friction):
    arm, sides = driven_arm(recordings, robot)
    if not all(driven(one, sides).all() for one in recordings):
        return robot.arm
    springs = np.array(sides) == 'spring'
    base = (base_of(arm, numbers=IN_PLANE) if robot.arm.frames is None
            else base_of(arm, recordings[0].coupling))
    fit = _WithinBelief(recordings, robot, sides, arm, base, friction=friction,
                        spring_sd=known_to(robot, 'stiffness') * springs)
    fit.solve()
    if not fit.is_shown():
        return robot.arm
    return replace(fit.nearest[0], stiffness=np.where(
        springs, robot.arm.stiffness / fit.scale, robot.arm.stiffness))


class _WithinBelief(ArmRegression):
    """The regression with links, and springs, that are known: each within heavy-tailed priors."""

    _settles = False

    def __init__(self, recordings, robot, sides, arm, base, **options):
        super().__init__(recordings, robot, sides, arm, base, **options)
        self._memory = len(self._rows.block) / _DIFFERENT
        ten = np.where(np.arange(10) < 4, known_to(robot, 'gravity')[:, None],
                       known_to(robot, 'inertia')[:, None])
        known = np.append(ten.ravel(), known_to(robot, 'motor_inertia')[arm.rigid])
        self._sd = np.maximum(
            np.linalg.norm(base.combination * all_parameters(arm) * known, axis=1),
            _LEAST_SD * sizes_of_body(arm)[base.lead])

    def _precision(self):
        precision, layout = super()._precision(), self._layout
        precision[layout.links] = heavy_tailed(self._at.links - self._links, self._sd)
        for part in (layout.links, layout.scales):
            precision[part] *= self._memory
        return precision

    def is_shown(self) -> bool:
        """Return whether some joint's torque is explained far better than as described."""
        found = self._at
        beside = self._unexplained()
        self._at = replace(found, links=self._links, scale=np.ones(len(found.scale)))
        described, self._at = self._unexplained(), found
        return bool(np.any(beside < _SHOWN * described))

    def _unexplained(self):
        """Return rms torques that neither links nor friction explain (n,) [N m]."""
        rest = []
        for j in range(len(self._at.scale)):
            _, left, rows = self._left(j)
            own = self._own(j, rows)
            rest.append(rms(left - own @ np.linalg.lstsq(own, left, rcond=1e-10)[0]))
        return np.array(rest)
