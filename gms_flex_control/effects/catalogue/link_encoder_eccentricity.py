# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Link encoder mounted off centre."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import wave
from gms_flex_control.effects.signals import Q_LINK, SENSED_LINK
import numpy as np


class LinkEncoderEccentricity(Term):
    """measured q_link += amplitude sin(q_link + phase)."""

    name = 'link_encoder_eccentricity'
    stage = Stage.SENSOR
    evidence = 'link angle'
    discriminated_by = 'whole revolutions without load'
    needs_link_encoder = True
    parameters = (
        Parameter('amplitude', 'rad', 'amplitude of the error', lower=0.0,
                  typical=lambda s: 0.1 * s.torsion),
        Parameter('phase', 'rad', 'phase at q_link = 0'))
    guesses = staticmethod(lambda s: [] if s.rigid else wave(0.02 * s.torsion))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[SENSED_LINK] += p[0] * np.sin(s[Q_LINK] + p[1])
