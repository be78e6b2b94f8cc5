# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Friction that errs in a parameter of the model, differs by direction, or drifts."""

from dataclasses import replace

from gms_flex_control.effects import base as sig
from gms_flex_control.effects.base import (
    Change,
    Guess,
    LEAST_RELATIVE,
    linear,
    Parameter,
    Stage,
    Term,
)
from gms_flex_control.params.robot import RobotParams, StribeckParams
import numpy as np


class CoulombError(Change):
    """F_s and F_c -> (1 + ratio) of them, in both directions; block stiffnesses stay."""

    name = 'coulomb_error'
    words = 'Level of the friction other than believed'
    evidence = 'link rate'
    similar = ('friction_drift', 'motor_coulomb')
    discriminated_by = 'the same motion at the beginning and at the end of a long run'
    replaces = 'level'
    parameters = (Parameter('ratio', '1', 'relative error', lower=-0.95, relative=True,
                            typical=0.3),)
    guesses = staticmethod(lambda s: linear(0.1))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        factor = np.ones(robot.n_joints)
        factor[joint] += values[0]
        return replace(robot, friction=robot.friction.each_way(
            lambda steady: steady.scaled(static=factor, coulomb=factor)))


class FrictionAsymmetry(Change):
    """
    F_s, F_c and viscous friction -> (1 + ratio) of them forward, (1 - ratio) backward.

    Not friction times the sign of the velocity: at rest that of a measured one is noise.
    """

    name = 'friction_asymmetry'
    words = 'Friction stronger one way than the other'
    evidence = 'link rate'
    similar = ('constant_link_torque', 'viscous_asymmetry')
    discriminated_by = 'motion both ways over the whole range, with rests between'
    replaces = 'asymmetry'
    parameters = (Parameter('ratio', '1', 'relative difference', lower=-0.95, upper=0.95,
                            typical=0.2, searched=(LEAST_RELATIVE, -LEAST_RELATIVE)),)
    guesses = staticmethod(lambda s: linear(0.1))

    @staticmethod
    def in_friction(steady, direction, values) -> StribeckParams:
        """Return the StribeckParams of one direction (1, -1), all levels scaled."""
        factor = 1.0 + direction * values[0]
        return steady.scaled(static=factor, coulomb=factor, viscous=factor)

    @classmethod
    def change(cls, robot, joint, values) -> RobotParams:
        ratio = values[0] * (np.arange(robot.n_joints) == joint)
        return replace(robot, friction=replace(robot.friction, **{
            side: cls.in_friction(getattr(robot.friction, side), direction, [ratio])
            for side, direction in (('forward', 1.0), ('backward', -1.0))}))


class FrictionDrift(Term):
    """F -> F (1 + ratio t / duration), and as at its end after the duration."""

    name = 'friction_drift'
    words = 'Friction that changes over the run, by warming or wear'
    stage = Stage.FRICTION
    evidence = 'time'
    similar = ('coulomb_error',)
    discriminated_by = 'the same motion at the beginning and at the end of a long run'
    parameters = (
        Parameter('ratio', '1', 'relative change over the duration', relative=True, typical=0.3),
        Parameter('duration', 's', 'time in which the change happens', lower=0.0, fixed=True))
    guesses = staticmethod(lambda s: linear(0.1, s.duration))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[1] > 0.0:
            s[sig.FRICTION] *= 1.0 + p[0] * min(s[sig.TIME] / p[1], 1.0)


class ViscousError(Term):
    """F -> F + slope v."""

    name = 'viscous_error'
    words = 'Slope of the friction over velocity other than believed'
    stage = Stage.FRICTION
    evidence = 'link rate'
    similar = ('quadratic_drag', 'motor_viscous')
    discriminated_by = 'faster motion, over a range of speeds of 1 to 5'
    replaces = 'viscous'
    least_is_value = True     # no viscous friction at all
    parameters = (Parameter('slope', 'N m s/rad', 'further viscous friction',
                            typical=lambda s: 0.3 * s.friction / s.speed),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction / s.speed))

    @classmethod
    def search_bounds(cls, joint_index, robot) -> tuple[list[float], list[float]]:
        """Return what is looked for, two lists: all of it may be gone either way."""
        steady = robot.friction.forward, robot.friction.backward
        return [-max(float(one.viscous[joint_index]) for one in steady)], [cls.parameters[0].upper]

    @staticmethod
    def in_friction(steady, direction, values) -> StribeckParams:
        """Return the StribeckParams of either direction with the slope in them."""
        return replace(steady, viscous=np.maximum(steady.viscous + values[0], 0.0))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.FRICTION] += p[0] * s[sig.DQ_LINK]


class ViscousAsymmetry(Term):
    """F -> F + slope abs(v): viscous friction is larger by slope forward, smaller backward."""

    name = 'viscous_asymmetry'
    words = 'Viscous friction that differs by direction'
    stage = Stage.FRICTION
    evidence = 'link rate'
    similar = ('friction_asymmetry',)
    discriminated_by = 'motion both ways over a range of speeds of 1 to 5'
    replaces = 'viscous_asymmetry'
    parameters = (Parameter('slope', 'N m s/rad',
                            'viscous friction added forward, taken off backward',
                            typical=lambda s: 0.2 * s.friction / s.speed),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction / s.speed))

    @staticmethod
    def in_friction(steady, direction, values) -> StribeckParams:
        """Return the StribeckParams of one direction (1, -1) with the slope in them."""
        return replace(steady, viscous=np.maximum(steady.viscous + direction * values[0], 0.0))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.FRICTION] += p[0] * abs(s[sig.DQ_LINK])


class StribeckError(Change):
    """F_s -> F_s + ratio F_c, in both directions, but never below F_c."""

    name = 'stribeck_error'
    words = 'Friction at low speed other than believed'
    evidence = 'link rate'
    similar = ('low_speed_friction',)
    discriminated_by = 'slow motion at many constant speeds'
    replaces = 'static'
    parameters = (Parameter('ratio', '1', 'further friction at rest over the Coulomb level',
                            lower=-0.95, relative=True, typical=0.3),)
    guesses = staticmethod(lambda s: linear(0.1))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        ratio = np.zeros(robot.n_joints)
        ratio[joint] = values[0]
        return replace(robot, friction=robot.friction.each_way(lambda steady: replace(
            steady, static=np.maximum(steady.static + ratio * steady.coulomb, steady.coulomb))))


_RESOLVED = 4  # counts of an encoder within which no block slips: fewer show no loop


class PreslidingError(Change):
    """k_i -> (1 + stiffness) k_i."""

    name = 'presliding_error'
    words = 'Friction before sliding other than believed'
    evidence = 'time since reversal'
    similar = ('friction_hysteresis',)
    discriminated_by = 'many small reversals, of a few mrad'
    replaces = 'blocks'
    parameters = (
        Parameter('stiffness', '1', 'relative error of all block stiffnesses', lower=-0.95,
                  typical=0.5),)

    @staticmethod
    def guesses(scales) -> list:
        """Return how it might be there, list of Guess; not where counts hide presliding."""
        if scales.count * _RESOLVED > scales.presliding:
            return []
        return [Guess(((-0.3,),), lambda c: (max(-0.3 * c[0], -0.9),))]

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        friction = robot.friction
        stiffness = friction.stiffness.copy()
        stiffness[joint] *= 1.0 + values[0]
        return replace(robot, friction=replace(friction, stiffness=stiffness))
