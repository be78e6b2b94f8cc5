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
    tells = 'motion both ways over the whole range, with rests between'
    fed_forward = True
    estimated_with_arm = True
    parameters = (
        Parameter('bias', 'N m', 'torque'),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1 * scales.friction)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.3 * scales.friction,)

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[LINK_TORQUE] += p[0]
