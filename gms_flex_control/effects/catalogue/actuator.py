# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Effects between the command and the torque of a motor."""

from gms_flex_control.effects.base import (
    Guess,
    LEAST_RELATIVE,
    linear,
    Parameter,
    sizes,
    Stage,
    Term,
)
from gms_flex_control.effects.signals import SUPPLY, TORQUE
import numpy as np


class TorqueGain(Term):
    """u -> u (1 + gain_error)."""

    name = 'torque_gain'
    words = 'Torque constant other than believed'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    discriminated_by = 'a known weight hung on the link'
    # no drive gives more than twice its torque
    parameters = (Parameter('gain_error', '1', 'relative error', searched=(LEAST_RELATIVE, 1.0),
                            typical=0.2),)
    guesses = staticmethod(lambda s: linear(0.1))
    # together they would scale the whole joint
    excludes = staticmethod(lambda rigid: ('link_inertia_error', 'motor_inertia_error') if rigid
                            else ('stiffness_error',))
    torque_scale = staticmethod(lambda values, supply: 1.0 + values[0])

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[TORQUE] *= 1.0 + p[0]


class ActuatorDeadzone(Term):
    """u -> dz(u, deadzone)."""

    name = 'actuator_deadzone'
    words = 'Small commands that move nothing'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    similar = ('backlash',)
    discriminated_by = 'fast motion with small torque beside slow motion with large torque'
    needs_commands = True
    parameters = (Parameter('deadzone', 'N m', 'half width', lower=0.0,
                            typical=lambda s: 0.3 * s.friction),)
    guesses = staticmethod(lambda s: sizes(s.friction * np.geomspace(0.02, 1.0, 10)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[TORQUE] -= min(max(s[TORQUE], -p[0]), p[0])


_EXCEEDED = 0.8  # of the largest command: a limit above


class ActuatorSaturation(Term):
    """u -> clip(u, limit)."""

    name = 'actuator_saturation'
    words = 'Largest torque the actuator gives'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    discriminated_by = 'faster motion, which asks for torque well beyond the limit'
    needs_commands = True
    of_one_size = True
    parameters = (Parameter('limit', 'N m', 'largest torque either way', lower=0.0),)
    guesses = staticmethod(lambda s: sizes(s.torque * np.linspace(0.2, 0.95, 16)))
    # it acts near the peaks only, where any torque that is late or wrong looks like it
    hardly_acts = staticmethod(lambda values, scales: values[0] > _EXCEEDED * scales.torque)

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[TORQUE] = min(max(s[TORQUE], -p[0]), p[0])


class ActuatorLag(Term):
    """time_constant du/dt + u = command, the mean over the step, exact for a held command."""

    name = 'actuator_lag'
    words = 'First-order lag of the torque loop'
    stage = Stage.ACTUATOR
    memory_size = 1
    evidence = 'time since reversal'
    similar = ('input_delay', 'recording_delay')
    discriminated_by = 'torque that changes faster, up to a tenth of the sample rate'
    of_feedback = True
    needs_commands = True
    parameters = (Parameter('time_constant', 's', 'time constant', lower=0.0, typical=8e-3),)
    guesses = staticmethod(lambda s: sizes((0.001, 0.003, 0.006, 0.012, 0.02)))
    excludes = staticmethod(lambda rigid: ('input_delay',))  # their sum alone shows

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[0] > 0.0:
            short, gone = memory[0] - s[TORQUE], -np.expm1(-dt / p[0])
            memory[0] -= short * gone
            s[TORQUE] += short * gone * p[0] / dt


_SLOTS = 32  # commands that can be on their way


class InputDelay(Term):
    """
    u(t) -> u(t - delay), the mean over the step, exact for held commands.

    Commands that change more often than 30 times within the delay are held that long.
    """

    name = 'input_delay'
    words = 'Dead time between the command and the torque'
    stage = Stage.ACTUATOR
    memory_size = 2 + 2 * _SLOTS  # time, newest slot, (since when, torque) of each slot
    evidence = 'time since reversal'
    similar = ('actuator_lag', 'recording_delay')
    discriminated_by = 'torque that changes faster, up to a tenth of the sample rate'
    of_feedback = True
    needs_commands = True
    parameters = (Parameter('delay', 's', 'dead time', lower=0.0, upper=0.05, typical=8e-3),)
    guesses = staticmethod(lambda s: sizes((0.001, 0.003, 0.006, 0.012, 0.02)))
    excludes = staticmethod(lambda rigid: ('actuator_lag',))  # their sum alone shows

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[0] <= 0.0:
            return
        newest = int(memory[1])
        if s[TORQUE] != memory[3 + 2 * newest]:
            if memory[0] - memory[2 + 2 * newest] >= p[0] / (_SLOTS - 2):
                newest = (newest + 1) % _SLOTS
                memory[1], memory[2 + 2 * newest] = newest, memory[0]
            memory[3 + 2 * newest] = s[TORQUE]
        begin = memory[0] - p[0]
        end, total = begin + dt, 0.0
        until, slot = memory[0] + dt, newest
        while until > begin:
            since = memory[2 + 2 * slot]
            if since < end:
                total += memory[3 + 2 * slot] * (min(until, end) - max(since, begin))
            if since <= begin or since == 0.0:
                break
            until, slot = since, (slot - 1) % _SLOTS
        memory[0] += dt
        s[TORQUE] = total / dt


class SupplySag(Term):
    """u -> u (1 + ratio (V - nominal)); nothing where the voltage V is not known."""

    name = 'supply_sag'
    words = 'Torque that follows the voltage of the supply'
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
