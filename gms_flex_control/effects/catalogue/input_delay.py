# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Dead time between the command and the torque."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import sizes
from gms_flex_control.effects.signals import TORQUE

_SLOTS = 32  # commands that can be on their way


class InputDelay(Term):
    """
    u(t) -> u(t - delay), the mean over the step, exact for held commands.

    Commands that change more often than 30 times within the delay are held that long.
    """

    name = 'input_delay'
    stage = Stage.ACTUATOR
    memory_size = 2 + 2 * _SLOTS  # time, newest slot, (since when, torque) of each slot
    evidence = 'time since reversal'
    confusable = ('actuator_lag', 'recording_delay')
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
