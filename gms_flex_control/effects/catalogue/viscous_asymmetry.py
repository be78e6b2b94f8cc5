# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Viscous friction that differs by direction."""

from dataclasses import replace

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_LINK, FRICTION
from gms_flex_control.params.friction import StribeckParams
import numpy as np


class ViscousAsymmetry(Term):
    """F -> F + slope abs(v): viscous friction is larger by slope forward, smaller backward."""

    name = 'viscous_asymmetry'
    stage = Stage.FRICTION
    evidence = 'link rate'
    confusable = ('friction_asymmetry',)
    discriminated_by = 'motion both ways over a range of speeds of 1 to 5'
    replaces = 'viscous_asymmetry'
    parameters = (Parameter('slope', 'N m s/rad',
                            'viscous friction added forward, taken off backward',
                            typical=lambda s: 0.2 * s.friction / s.speed),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction / s.speed))

    @staticmethod
    def in_friction(steady, direction, values) -> StribeckParams:
        return replace(steady, viscous=np.maximum(
            steady.viscous + direction * values[0], 0.0))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[FRICTION] += p[0] * abs(s[DQ_LINK])
