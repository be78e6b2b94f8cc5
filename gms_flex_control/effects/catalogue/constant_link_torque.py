# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Constant torque on the link, as from a cable."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import LINK_TORQUE


class ConstantLinkTorque(Term):
    """x += bias."""

    name = 'constant_link_torque'
    stage = Stage.LINK
    parameters = (
        Parameter('bias', 'N m', 'torque'),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[LINK_TORQUE] += p[0]
