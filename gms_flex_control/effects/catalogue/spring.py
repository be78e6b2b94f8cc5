# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Effects on the spring between motor and link."""

from dataclasses import replace

from gms_flex_control.effects import base as sig
from gms_flex_control.effects.base import (
    Change,
    linear,
    Parameter,
    shapes,
    sizes,
    Stage,
    Term,
    wave,
)
from gms_flex_control.params.robot import RobotParams
import numpy as np


class StiffnessError(Change):
    """K -> K (1 + ratio)."""

    name = 'stiffness_error'
    words = 'Joint stiffness other than believed'
    evidence = 'torsion'
    similar = ('stiffness_drift',)
    discriminated_by = 'a longer recording, or one before and one after warming up'
    replaces = 'stiffness'
    parameters = (Parameter('ratio', '1', 'relative error', lower=-0.99, relative=True,
                            typical=0.2),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.1))
    excludes = staticmethod(lambda rigid: () if rigid else ('torque_gain',))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        stiffness = robot.arm.stiffness.copy()
        stiffness[joint] *= 1.0 + values[0]
        return replace(robot, arm=replace(robot.arm, stiffness=stiffness))


class StiffnessDrift(Term):
    """s -> s (1 + ratio t / duration), and as at its end after the duration."""

    name = 'stiffness_drift'
    words = 'Spring that changes over the run, as by warming'
    stage = Stage.SPRING
    evidence = 'time'
    similar = ('stiffness_error',)
    discriminated_by = 'a longer recording, or one before and one after warming up'
    parameters = (
        Parameter('ratio', '1', 'relative change over the duration', relative=True, typical=0.2),
        Parameter('duration', 's', 'time in which the change happens', lower=0.0, fixed=True))
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.1, s.duration))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[1] > 0.0:
            s[sig.SPRING] *= 1.0 + p[0] * min(s[sig.TIME] / p[1], 1.0)


class SpringCubic(Term):
    """s += cubic e^3."""

    name = 'spring_cubic'
    words = 'Spring that stiffens or softens with torsion'
    stage = Stage.SPRING
    evidence = 'torsion'
    discriminated_by = 'slow torque up to the largest, both ways, with the link held'
    parameters = (Parameter('cubic', 'N m/rad^3', 'cubic stiffness',
                            typical=lambda s: 0.1 * s.spring / s.torsion ** 3),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.1 * s.spring / s.torsion ** 3))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.SPRING] += p[0] * s[sig.TORSION] ** 3


class SpringDamping(Term):
    """s += damping (dq_motor - dq_link)."""

    name = 'spring_damping'
    words = 'Damping of the joint spring beyond the modelled one'
    stage = Stage.SPRING
    evidence = 'time since reversal'
    discriminated_by = 'free swings of the link with the motor held'
    parameters = (Parameter('damping', 'N m s/rad', 'damping of the torsion', lower=0.0,
                            typical=lambda s: 0.2 * (s.inertia * s.spring / s.torsion) ** 0.5),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.003, positive=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.SPRING] += p[0] * s[sig.TORSION_RATE]


class SpringHysteresis(Term):
    """s -> s + force z, where z from -1 to 1 follows the torsion over the yield."""

    name = 'spring_hysteresis'
    words = 'Rate-independent loss in the spring'
    stage = Stage.SPRING
    memory_size = 3
    evidence = 'torsion'
    discriminated_by = 'slow torque up and down to several heights, with the link held'
    parameters = (
        Parameter('force', 'N m', 'torque at which the element yields', lower=0.0,
                  typical=lambda s: 0.2 * s.friction),
        Parameter('yield', 'rad', 'torsion at which it yields', lower=0.0,
                  typical=lambda s: s.torsion))
    guesses = staticmethod(lambda s: [] if s.rigid else shapes(
        0.1 * s.friction, s.torsion * np.geomspace(0.02, 2.0, 8)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        e_before, torque, begun = memory[0], memory[1], memory[2]
        if begun > 0.0 and p[1] > 0.0:
            torque += p[0] / p[1] * (s[sig.TORSION] - e_before)
        memory[0], memory[1], memory[2] = s[sig.TORSION], min(max(torque, -p[0]), p[0]), 1.0
        s[sig.SPRING] += memory[1]


class SpringOffset(Term):
    """e -> e + offset."""

    name = 'spring_offset'
    words = 'Rest position of the spring away from zero'
    stage = Stage.TORSION
    evidence = 'torsion'
    similar = ('constant_link_torque',)
    discriminated_by = 'a recording with another load, or with the link held'
    needs_link_encoder = True
    parameters = (Parameter('offset', 'rad', 'torsion of the unloaded spring, negative',
                            typical=lambda s: 0.2 * s.torsion),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.05 * s.torsion))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.TORSION] += p[0]


class Backlash(Term):
    """The spring carries no torque within the gap: e -> dz(e, half_gap)."""

    name = 'backlash'
    words = 'Play in the transmission'
    stage = Stage.TORSION
    evidence = 'torsion'
    similar = ('actuator_deadzone',)
    discriminated_by = 'slow reversals under load, and with the link free'
    parameters = (Parameter('half_gap', 'rad', 'half width of the play', lower=0.0,
                            typical=lambda s: 0.2 * s.torsion),)
    guesses = staticmethod(
        lambda s: [] if s.rigid else sizes(s.torsion * np.geomspace(0.01, 0.6, 12)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        e = s[sig.TORSION]
        s[sig.TORSION] = e - min(max(e, -p[0]), p[0])
        if -p[0] < e < p[0]:
            s[sig.TORSION_RATE] = 0.0


class KinematicError(Term):
    """e -> e + amplitude sin(2 q_motor + phase)."""

    name = 'kinematic_error'
    words = 'Position error of a strain-wave gear, twice per motor revolution'
    stage = Stage.TORSION
    evidence = 'motor angle'
    similar = ('torque_ripple',)
    discriminated_by = 'the same motion under another load'
    needs_link_encoder = True
    parameters = (
        Parameter('amplitude', 'rad', 'amplitude of the error', lower=0.0,
                  typical=lambda s: 0.1 * s.torsion),
        Parameter('phase', 'rad', 'phase at q_motor = 0'))
    guesses = staticmethod(lambda s: [] if s.rigid else wave(0.02 * s.torsion))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.TORSION] += p[0] * np.sin(2.0 * s[sig.Q_MOTOR] + p[1])
