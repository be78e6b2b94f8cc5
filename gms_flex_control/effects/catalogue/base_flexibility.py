# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A base that gives way under the torque of a joint."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import Guess
from gms_flex_control.effects.signals import FRICTION, SENSED_LINK, SENSED_MOTOR, TORQUE
import numpy as np


class BaseFlexibility(Term):
    """
    inertia (b'' + 2 damping w b' + w^2 b) = F - u; both encoders of the joint read b less.

    The angles of link and motor count from the resting base, so the motion of the base shows in
    what is measured: an inertia torque -M b'' on all links after it. ``frequency`` is that of
    the base alone. Exact for a torque held over a sample; friction follows the true angle.
    """

    name = 'base_flexibility'
    stage = Stage.SENSOR
    memory_size = 2
    evidence = 'link acceleration'
    discriminated_by = 'short pulses of torque with the arm at rest'
    needs_link_encoder = True
    acts_along_motion = False  # needs torques that only a simulation has
    parameters = (
        Parameter('frequency', 'Hz', 'natural frequency w / 2 pi', lower=0.0),
        Parameter('inertia', 'kg m^2', 'inertia of the base about the joint', lower=0.0),
        Parameter('damping', '1', 'damping ratio', lower=0.0, upper=0.99))

    @staticmethod
    def guesses(scales) -> list:
        heavy = 5.0 * scales.link_inertia
        return [Guess(((frequency, heavy, 0.05),),
                      lambda c, frequency=frequency: (
                          frequency, heavy / np.clip(c[0], 0.02, 20.0), 0.05), 0.0)
                for frequency in np.geomspace(3.0, 15.0, 9)]

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        w = 2.0 * np.pi * p[0]
        if w > 0.0 and p[1] > 0.0:
            rest = (s[FRICTION] - s[TORQUE]) / (p[1] * w * w)
            swing = w * np.sqrt(1.0 - p[2] * p[2])
            x, rate = memory[0] - rest, memory[1]
            cosine, sine = np.cos(swing * dt), np.sin(swing * dt) / swing
            decay = np.exp(-p[2] * w * dt)
            memory[0] = rest + decay * (x * cosine + (rate + p[2] * w * x) * sine)
            memory[1] = decay * (rate * cosine - (p[2] * w * rate + w * w * x) * sine)
            s[SENSED_LINK] -= memory[0]
            s[SENSED_MOTOR] -= memory[0]
