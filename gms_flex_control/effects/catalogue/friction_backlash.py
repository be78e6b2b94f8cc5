# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Play between a joint and what rubs."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import Guess
from gms_flex_control.effects.signals import FRICTION, Q_LINK
import numpy as np

_FORCE = 0.1  # of static friction, of a guess


class FrictionBacklash(Term):
    """
    Friction behind a play: F += force dz(z, half_gap) / reach, where abs(z) <= half_gap + reach.

    z follows the link. After a reversal there is no such friction until the play is crossed; it
    then grows over the reach. Of a joint with a spring this is `Backlash`.
    """

    name = 'friction_backlash'
    stage = Stage.FRICTION
    memory_size = 3           # angle before, whether there is one, z
    evidence = 'time since reversal'
    confusable = ('friction_hysteresis',)
    discriminated_by = 'many reversals of several sizes, smaller and larger than the play'
    parameters = (
        Parameter('force', 'N m', 'torque once it slips', lower=0.0,
                  typical=lambda s: 0.3 * s.friction),
        Parameter('half_gap', 'rad', 'half width of the play', lower=0.0,
                  typical=lambda s: 0.1 * (s.highest - s.lowest)),
        Parameter('reach', 'rad', 'displacement beyond the play at which it slips', lower=0.0,
                  typical=lambda s: 0.1 * (s.highest - s.lowest)))

    @staticmethod
    def guesses(scales) -> list:
        span, size = scales.highest - scales.lowest, _FORCE * scales.friction
        if not (scales.rigid and span):
            return []
        return [Guess(((size, gap, reach),), lambda c, gap=gap, reach=reach: (
                      c[0] * size, gap, reach), 0.0)
                for gap in span * np.geomspace(3e-3, 0.1, 4)
                for reach in span * np.geomspace(3e-3, 0.1, 3)]

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        moved = (s[Q_LINK] - memory[0]) * memory[1]
        memory[0], memory[1] = s[Q_LINK], 1.0
        gap, reach = p[1], p[2]
        if reach > 0.0:
            memory[2] = min(max(memory[2] + moved, -gap - reach), gap + reach)
            s[FRICTION] += p[0] / reach * (memory[2] - min(max(memory[2], -gap), gap))
