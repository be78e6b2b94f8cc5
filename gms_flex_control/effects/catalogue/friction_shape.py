# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Friction that depends on what the model of friction does not know."""

import math

from gms_flex_control.effects import base as sig
from gms_flex_control.effects.base import (
    Guess,
    LEAST_RELATIVE,
    linear,
    orders,
    Parameter,
    shapes,
    Stage,
    Term,
    waves,
)
from gms_flex_control.params.key import SMALLEST
import numpy as np


class PositionFriction(Term):
    """F -> F (1 + ratio cos(order q_link + phase))."""

    name = 'position_friction'
    words = 'Friction that varies with the position of the link'
    stage = Stage.FRICTION
    evidence = 'link angle'
    discriminated_by = 'slow motion both ways over the whole range'
    fed_forward = True
    parameters = (
        Parameter('ratio', '1', 'relative variation', typical=0.2,
                  searched=(LEAST_RELATIVE, -LEAST_RELATIVE)),
        Parameter('order', '1', 'periods per revolution', lower=0.0, searched=(0.7, math.inf)),
        Parameter('phase', 'rad', 'phase at q_link = 0'))
    guesses = staticmethod(lambda s: waves(0.1, orders(s.travel.span, 6.0)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.FRICTION] *= 1.0 + p[0] * np.cos(p[1] * s[sig.Q_LINK] + p[2])


_STRAIGHT = 10.0  # times its speed: from there on the arc keeps its shape
_FASTEST = 2.0  # times the rms of a speed: about its largest in usual motion
_FINE = 1e-3   # of the range of angles: least reach of a guess


class LoadFriction(Term):
    """
    F -> F + ratio abs(s) z, where z from -1 to 1 follows the link over the reach.

    s is what the transmission carries: weight, inertia and friction of the link. Along a recording
    it follows from the motion where the joint is rigid: torque explains no torque.
    """

    name = 'load_friction'
    words = 'Friction that grows with the torque carried'
    stage = Stage.FRICTION
    memory_size = 3           # angle before, whether there is one, z
    evidence = 'torsion'
    discriminated_by = 'the same motion under another load'
    fed_forward = True
    # while a motor drives its link, less inertia beside friction per torque scales all that the
    # transmission carries and leaves the motion as it is
    excludes = staticmethod(lambda rigid: ('link_inertia_error',))
    parameters = (
        Parameter('ratio', '1', 'friction per torque carried', lower=0.0, upper=1.0,
                  typical=0.1),
        Parameter('reach', 'rad', 'displacement over which it changes its direction', lower=0.0,
                  typical=lambda s: s.count + _FINE * s.travel.span))

    @staticmethod
    def guesses(scales) -> list:
        """Return how it might be there, over the least reach that the encoder resolves."""
        reach = max(scales.count, _FINE * scales.travel.span)
        return linear(0.05, reach, positive=True) if reach > 0.0 else []

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        moved = (s[sig.Q_LINK] - memory[0]) * memory[1]
        memory[0], memory[1] = s[sig.Q_LINK], 1.0
        if p[1] > 0.0:
            memory[2] = min(max(memory[2] + moved / p[1], -1.0), 1.0)
            s[sig.FRICTION] += p[0] * abs(s[sig.SPRING]) * memory[2]


class LowSpeedFriction(Term):
    """
    F -> F (1 + ratio exp(-abs(v) / velocity)).

    Sign, and what friction is at rest, are those of the blocks. A Stribeck curve cannot rise with
    speed; this one does where the ratio is below zero.
    """

    name = 'low_speed_friction'
    words = 'Friction at low speed of another shape than the Stribeck curve'
    stage = Stage.FRICTION
    evidence = 'link rate'
    similar = ('shear_thinning', 'stribeck_error')
    discriminated_by = 'slow motion at many constant speeds'
    fed_forward = True
    parameters = (
        Parameter('ratio', '1', 'relative change as the speed nears zero', relative=True,
                  typical=0.3),
        Parameter('velocity', 'rad/s', 'speed over which it decays', lower=0.0,
                  typical=lambda s: 0.3 * s.speed))
    guesses = staticmethod(
        lambda s: shapes(0.1, s.speed * np.geomspace(0.03, 0.6, 5), positive=False))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[1] > 0.0:
            s[sig.FRICTION] *= 1.0 + p[0] * np.exp(-abs(s[sig.DQ_LINK]) / p[1])


class ShearThinning(Term):
    """
    F -> F + torque arc(abs(v)) / max(arc) sgn(v), arc(v) = asinh(v / velocity) less its chord.

    The shear stress of a lubricant grows as asinh of its rate (Eyring 1936, J. Chem. Phys. 4). The
    chord goes from rest to ``speed``: viscous friction as believed is a slope over such a range,
    which this effect bends.
    """

    name = 'shear_thinning'
    words = 'Viscous friction that grows less than in proportion to speed'
    stage = Stage.FRICTION
    evidence = 'link rate'
    similar = ('low_speed_friction',)
    discriminated_by = 'motion at many constant speeds, from slow to the fastest'
    fed_forward = True
    parameters = (
        Parameter('torque', 'N m', 'most by which friction exceeds a straight line', lower=0.0,
                  typical=lambda s: 0.2 * s.friction),
        Parameter('velocity', 'rad/s', 'speed about which viscosity begins to fall', lower=0.0,
                  typical=lambda s: s.speed),
        Parameter('speed', 'rad/s', 'speed up to which the line goes', lower=0.0, fixed=True))
    guesses = staticmethod(lambda s: shapes(
        0.1 * s.friction, s.speed * np.geomspace(0.1, 2.0, 4), _FASTEST * s.speed))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[1] > 0.0 and p[2] > 0.0:
            velocity = min(p[1], _STRAIGHT * p[2])
            v, most = s[sig.DQ_LINK] / velocity, p[2] / velocity
            slope = np.arcsinh(most) / most
            top = np.sqrt(1.0 / slope ** 2 - 1.0)  # where arc and chord are parallel
            s[sig.FRICTION] += p[0] * (np.arcsinh(v) - slope * v) / (np.arcsinh(top) - slope * top)


class QuadraticDrag(Term):
    """x -= drag dq abs(dq)."""

    name = 'quadratic_drag'
    words = 'Drag of a fluid'
    stage = Stage.LINK
    evidence = 'link rate'
    similar = ('viscous_error',)
    discriminated_by = 'faster motion, over a range of speeds of 1 to 5'
    fed_forward = True
    parameters = (Parameter('drag', 'N m s^2/rad^2', 'coefficient', lower=0.0,
                            typical=lambda s: 0.2 * s.friction / s.speed ** 2),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction / s.speed ** 2, positive=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.LINK_TORQUE] -= p[0] * s[sig.DQ_LINK] * abs(s[sig.DQ_LINK])


_ELEMENTS, _FINER = 4, 10.0 ** -0.5  # yields: 1, 0.32, 0.1 and 0.032 of the reach


class FrictionHysteresis(Term):
    """F -> F + force (z_1 + .. + z_4) / 4, z_i from -1 to 1 following the link over its reach."""

    name = 'friction_hysteresis'
    words = "Hysteresis before sliding that reaches farther, or is finer, than the model's blocks"
    stage = Stage.FRICTION
    memory_size = 2 + _ELEMENTS  # angle before, whether there is one, torque over force of each
    evidence = 'time since reversal'
    similar = ('friction_backlash', 'presliding_error')
    discriminated_by = 'many reversals of several sizes, from small ones to beyond the reach'
    fed_forward = True
    parameters = (
        Parameter('force', 'N m', 'torque of all elements once they yield', lower=0.0,
                  typical=lambda s: 0.3 * s.friction),
        Parameter('reach', 'rad', 'largest displacement at which one yields', lower=0.0,
                  typical=lambda s: 0.1 * s.travel.span))

    @staticmethod
    def guesses(scales) -> list:
        """Return how it might be there, over six reaches up to a fifth of the travel."""
        span = scales.travel.span
        return shapes(0.1 * scales.friction, span * np.geomspace(1e-3, 0.2, 6)) if span else []

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        moved, reach = (s[sig.Q_LINK] - memory[0]) * memory[1], p[1]
        memory[0], memory[1] = s[sig.Q_LINK], 1.0
        if reach > SMALLEST:
            for i in range(2, 2 + _ELEMENTS):
                memory[i] = min(max(memory[i] + moved / reach, -1.0), 1.0)
                s[sig.FRICTION] += p[0] / _ELEMENTS * memory[i]
                reach *= _FINER


_FORCE = 0.1  # of static friction, of a guess


class FrictionBacklash(Term):
    """
    Friction behind a play: F += force dz(z, half_gap) / reach, where abs(z) <= half_gap + reach.

    z follows the link. After a reversal there is no such friction until the play is crossed; it
    then grows over the reach. Of a joint with a spring this is `Backlash`.
    """

    name = 'friction_backlash'
    words = 'Play between a joint and what rubs'
    stage = Stage.FRICTION
    memory_size = 3           # angle before, whether there is one, z
    evidence = 'time since reversal'
    similar = ('friction_hysteresis',)
    discriminated_by = 'many reversals of several sizes, smaller and larger than the play'
    parameters = (
        Parameter('force', 'N m', 'torque once it slips', lower=0.0,
                  typical=lambda s: 0.3 * s.friction),
        Parameter('half_gap', 'rad', 'half width of the play', lower=0.0,
                  typical=lambda s: 0.1 * s.travel.span),
        Parameter('reach', 'rad', 'displacement beyond the play at which it slips', lower=0.0,
                  typical=lambda s: 0.1 * s.travel.span))

    @staticmethod
    def guesses(scales) -> list:
        """Return how it might be on a rigid joint, for several plays and reaches."""
        span, size = scales.travel.span, _FORCE * scales.friction
        if not (scales.rigid and span):
            return []
        return [Guess(((size, gap, reach),), lambda c, gap=gap, reach=reach: (
                      c[0] * size, gap, reach), 0.0)
                for gap in span * np.geomspace(3e-3, 0.1, 4)
                for reach in span * np.geomspace(3e-3, 0.1, 3)]

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        moved = (s[sig.Q_LINK] - memory[0]) * memory[1]
        memory[0], memory[1] = s[sig.Q_LINK], 1.0
        gap, reach = p[1], p[2]
        if reach > SMALLEST:
            memory[2] = min(max(memory[2] + moved, -gap - reach), gap + reach)
            s[sig.FRICTION] += p[0] / reach * (memory[2] - min(max(memory[2], -gap), gap))
