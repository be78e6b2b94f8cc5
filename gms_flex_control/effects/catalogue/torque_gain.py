# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Torque constant other than believed."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import TORQUE


class TorqueGain(Term):
    """u -> u (1 + gain_error)."""

    name = 'torque_gain'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    confusable = ()
    tells = 'a known weight hung on the link'
    parameters = (
        Parameter('gain_error', '1', 'relative error'),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1)

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[TORQUE] *= 1.0 + p[0]
