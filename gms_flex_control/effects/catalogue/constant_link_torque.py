# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Constant torque on the link, as from a cable."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import LINK_TORQUE


class ConstantLinkTorque(Term):
    """x += bias."""

    name = 'constant_link_torque'
    stage = Stage.LINK
    evidence = 'link rate'
    confusable = ('spring_offset', 'friction_asymmetry')
    declared_from = 0.3       # levels that differ by direction are nearly a constant torque
    discriminated_by = 'motion both ways over the whole range, with rests between'
    fed_forward = True
    estimated_with_arm = True
    parameters = (Parameter('bias', 'N m', 'torque', typical=lambda s: 0.3 * s.friction),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[LINK_TORQUE] += p[0]
