# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Effects on what is read: encoders, the stamps of a recording, a base that moves with them."""

from gms_flex_control.effects import base as sig
from gms_flex_control.effects.base import Guess, linear, Parameter, Stage, Term, wave
import numpy as np


class EncoderSkew(Term):
    """Measured q_motor(t) -> q_motor(t - delay), to second order in the delay, rates to first."""

    name = 'encoder_skew'
    words = 'The two encoders of a joint are not read at the same time'
    stage = Stage.SENSOR
    evidence = 'motor rate'
    discriminated_by = 'motion at constant speeds, slow and fast, both ways'
    needs_link_encoder = True
    parameters = (Parameter('delay', 's', 'by which the motor side is older than the link side',
                            lower=-0.05, upper=0.05, typical=3e-3),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.0005))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.SENSED_MOTOR] -= p[0] * (s[sig.DQ_MOTOR] - 0.5 * p[0] * s[sig.DDQ_MOTOR])
        s[sig.SENSED_MOTOR_RATE] -= p[0] * s[sig.DDQ_MOTOR]


class LinkEncoderEccentricity(Term):
    """measured q_link += amplitude sin(q_link + phase)."""

    name = 'link_encoder_eccentricity'
    words = 'Link encoder mounted off centre'
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
        s[sig.SENSED_LINK] += p[0] * np.sin(s[sig.Q_LINK] + p[1])
        s[sig.SENSED_LINK_RATE] += p[0] * np.cos(s[sig.Q_LINK] + p[1]) * s[sig.DQ_LINK]


# samples: drives report the torque at an instant, or that which follows, half a one or one late
_CUSTOMARY = 1.2


class RecordingDelay(Term):
    """
    Measured q(t) -> q(t - delay) of all links and motors, to second order in the delay.

    Their rates are so to first order. A fault of the recording: the drives act in time, torques
    are merely stamped early against the angles (delay above zero) or late (below).
    """

    name = 'recording_delay'
    words = 'Torques and angles of the recording that were not stamped at the same time'
    stage = Stage.SENSOR
    whole_arm = True
    evidence = 'time since reversal'
    similar = ('actuator_lag', 'input_delay')
    discriminated_by = ('fast motion of each joint in turn: drives are late one by one, a '
                        'recording at once')
    of_feedback = True
    of_recording = True
    torque_delay = staticmethod(lambda values: values[0])
    parameters = (Parameter('delay', 's', 'by which all angles are older than the torques',
                            lower=-0.02, upper=0.02, typical=3e-3),)
    guesses = staticmethod(lambda s: linear(0.0005))

    @staticmethod
    def is_custom(values, period, commanded) -> bool:
        return not commanded and 0.0 < values[0] < _CUSTOMARY * period

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        for j in range(int(s[sig.JOINTS])):
            k = sig.WIDTH * j
            s[k + sig.SENSED_LINK] -= p[0] * (s[k + sig.DQ_LINK] - 0.5 * p[0] * s[
                k + sig.DDQ_LINK])
            s[k + sig.SENSED_MOTOR] -= p[0] * (s[k + sig.DQ_MOTOR] - 0.5 * p[0] * s[
                k + sig.DDQ_MOTOR])
            s[k + sig.SENSED_LINK_RATE] -= p[0] * s[k + sig.DDQ_LINK]
            s[k + sig.SENSED_MOTOR_RATE] -= p[0] * s[k + sig.DDQ_MOTOR]


class BaseFlexibility(Term):
    """
    inertia (b'' + 2 damping w b' + w^2 b) = F - u; both encoders of the joint read b less.

    The angles of link and motor count from the resting base, so the motion of the base shows in
    what is measured: an inertia torque -M b'' on all links after it. ``frequency`` is that of
    the base alone. Exact for a torque held over a sample; friction acts between
    joint and base.
    """

    name = 'base_flexibility'
    words = 'A base that gives way under the torque of a joint'
    stage = Stage.SENSOR
    memory_size = 2
    evidence = 'link acceleration'
    discriminated_by = 'short pulses of torque with the arm at rest'
    needs_link_encoder = True
    acts_along_motion = False  # needs torques that only a simulation has
    parameters = (
        Parameter('frequency', 'Hz', 'natural frequency w / 2 pi', lower=0.0,
                  searched=(1.0, 20.0)),  # beyond, nothing is looked at: it would stand for a lag
        Parameter('inertia', 'kg m^2', 'inertia of the base about the joint', lower=0.0),
        Parameter('damping', '1', 'damping ratio', lower=0.0, upper=0.99,
                  searched=(0.0, 0.3)))  # more is no resonance of a structure

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
            rest = (s[sig.FRICTION] - s[sig.TORQUE]) / (p[1] * w * w)
            swing = w * np.sqrt(1.0 - p[2] * p[2])
            x, rate = memory[0] - rest, memory[1]
            cosine, sine = np.cos(swing * dt), np.sin(swing * dt) / swing
            decay = np.exp(-p[2] * w * dt)
            memory[0] = rest + decay * (x * cosine + (rate + p[2] * w * x) * sine)
            memory[1] = decay * (rate * cosine - (p[2] * w * rate + w * w * x) * sine)
            s[sig.SENSED_LINK] -= memory[0]
            s[sig.SENSED_MOTOR] -= memory[0]
            s[sig.SENSED_LINK_RATE] -= memory[1]
            s[sig.SENSED_MOTOR_RATE] -= memory[1]
            s[sig.BASE] += memory[0]
            s[sig.BASE_RATE] += memory[1]
