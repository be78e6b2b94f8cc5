# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Stop met beyond an angle: a one-sided spring."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import LINK_TORQUE, Q_LINK


class EndStop(Term):
    """x -= stiffness (q_link - angle) beyond the angle, on its side of zero."""

    name = 'end_stop'
    stage = Stage.LINK
    parameters = (
        Parameter('angle', 'rad', 'where it begins'),
        Parameter('stiffness', 'N m/rad', 'stiffness of the stop', lower=0.0),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        depth = s[Q_LINK] - p[0]
        if depth * p[0] > 0.0:
            s[LINK_TORQUE] -= p[1] * depth
