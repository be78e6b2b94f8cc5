# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Torque that follows the voltage of the supply."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import Guess
from gms_flex_control.effects.signals import SUPPLY, TORQUE


class SupplySag(Term):
    """u -> u (1 + ratio (V - nominal)); nothing where the voltage V is not known."""

    name = 'supply_sag'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    discriminated_by = 'the same motion at two voltages of the supply'
    needs_supply = True
    parameters = (
        Parameter('ratio', '1/V', 'relative fall of the torque constant per volt less', lower=0.0,
                  typical=lambda s: 1.0 / s.supply),
        Parameter('nominal', 'V', 'voltage at which the torque is as asked for', lower=0.0))
    torque_scale = staticmethod(lambda values, supply: 1.0 + values[0] * (supply - values[1]))

    @staticmethod
    def guesses(scales) -> list:
        if scales.supply <= 0.0:
            return []
        volts, size = scales.supply, 0.05

        def values(c):
            """Return ratio and nominal of a sum of two sags about voltages 1 V apart."""
            ratio = c[0] + c[1]
            shift = c[1] / ratio if abs(c[1]) < 0.5 * volts * abs(ratio) else 0.0
            return ratio * size, volts - shift
        return [Guess(((size, volts), (size, volts - 1.0)), values)]

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if s[SUPPLY] > 0.0:
            s[TORQUE] *= 1.0 + p[0] * (s[SUPPLY] - p[1])
