# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Hysteresis before sliding that reaches farther, or is finer, than the model's blocks."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import shapes
from gms_flex_control.effects.signals import FRICTION, Q_LINK
import numpy as np

_ELEMENTS, _FINER = 4, 10.0 ** -0.5  # yields: 1, 0.32, 0.1 and 0.032 of the reach


class FrictionHysteresis(Term):
    """Four elasto-plastic elements on the link angle, of equal force, beside the blocks."""

    name = 'friction_hysteresis'
    stage = Stage.FRICTION
    memory_size = 2 + _ELEMENTS  # angle before, whether there is one, torque over force of each
    evidence = 'time since reversal'
    confusable = ('friction_backlash', 'presliding_error')
    discriminated_by = 'many reversals of several sizes, from small ones to beyond the reach'
    fed_forward = True
    parameters = (
        Parameter('force', 'N m', 'torque of all elements once they yield', lower=0.0,
                  typical=lambda s: 0.3 * s.friction),
        Parameter('reach', 'rad', 'largest displacement at which one yields', lower=0.0,
                  typical=lambda s: 0.1 * (s.highest - s.lowest)))

    @staticmethod
    def guesses(scales) -> list:
        span = scales.highest - scales.lowest
        return shapes(0.1 * scales.friction, span * np.geomspace(1e-3, 0.2, 6)) if span else []

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        moved, reach = (s[Q_LINK] - memory[0]) * memory[1], p[1]
        memory[0], memory[1] = s[Q_LINK], 1.0
        if reach > 0.0:
            for i in range(2, 2 + _ELEMENTS):
                memory[i] = min(max(memory[i] + moved / reach, -1.0), 1.0)
                s[FRICTION] += p[0] / _ELEMENTS * memory[i]
                reach *= _FINER
