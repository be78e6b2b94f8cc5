# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Viscous friction that differs by direction."""

from dataclasses import replace

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_LINK, FRICTION
import numpy as np


class ViscousAsymmetry(Term):
    """F -> F + slope abs(v): viscous friction is larger by slope forward, smaller backward."""

    name = 'viscous_asymmetry'
    stage = Stage.FRICTION
    evidence = 'link rate'
    confusable = ('friction_asymmetry',)
    tells = 'motion both ways over a range of speeds of 1 to 5'
    replaces = 'viscous_asymmetry'
    parameters = (
        Parameter('slope', 'N m s/rad', 'viscous friction added forward, taken off backward'),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1 * scales.friction / scales.speed)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.2 * scales.friction / scales.speed,)

    @classmethod
    def in_friction(cls, steady, direction, values):
        """Return the friction parameters of one direction with the effect in them."""
        return replace(steady, viscous=np.maximum(
            steady.viscous + direction * values[0], 0.0))

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[FRICTION] += p[0] * abs(s[DQ_LINK])
