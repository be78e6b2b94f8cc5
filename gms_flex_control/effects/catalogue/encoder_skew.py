# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The two encoders of a joint are not read at the same time."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DDQ_MOTOR, DQ_MOTOR, SENSED_MOTOR


class EncoderSkew(Term):
    """Measured q_motor(t) -> q_motor(t - delay), to second order in the delay."""

    name = 'encoder_skew'
    stage = Stage.SENSOR
    evidence = 'motor rate'
    discriminated_by = 'motion at constant speeds, slow and fast, both ways'
    needs_link_encoder = True
    parameters = (Parameter('delay', 's', 'by which the motor side is older than the link side',
                            lower=-0.05, upper=0.05, typical=3e-3),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.0005))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[SENSED_MOTOR] -= p[0] * (s[DQ_MOTOR] - 0.5 * p[0] * s[DDQ_MOTOR])
