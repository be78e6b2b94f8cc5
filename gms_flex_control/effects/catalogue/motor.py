# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Effects on the motor side of a joint: its inertia, friction and torques."""

from dataclasses import replace
import math

from gms_flex_control.effects.base import (
    Change,
    HIGHEST_ORDER,
    linear,
    orders,
    Parameter,
    Stage,
    Term,
    waves,
)
from gms_flex_control.effects.signals import (
    DDQ_LINK,
    DDQ_MOTOR,
    DQ_MOTOR,
    JOINT,
    LINK_TORQUE,
    MOTOR_TORQUE,
    Q_MOTOR,
    WIDTH,
)
from gms_flex_control.params.robot import RobotParams
import numpy as np


class MotorInertiaError(Change):
    """J -> J (1 + ratio)."""

    name = 'motor_inertia_error'
    words = 'Motor inertia other than believed'
    evidence = 'link acceleration'
    discriminated_by = 'fast motion of the motor with the link held'
    replaces = 'motor_inertia'
    parameters = (Parameter('ratio', '1', 'relative error', lower=-0.99, relative=True,
                            typical=0.3),)
    excludes = staticmethod(lambda rigid: ('torque_gain',) if rigid else ())

    @staticmethod
    def guesses(scales) -> list:
        if scales.rigid and scales.link_inertia > 0.0 and not scales.in_space:
            return []  # the joint's inertia is that of its link, too
        return linear(0.1)

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        motor_inertia = robot.arm.motor_inertia.copy()
        motor_inertia[joint] *= 1.0 + values[0]
        return replace(robot, arm=replace(robot.arm, motor_inertia=motor_inertia))


class MotorInertiaCoupling(Term):
    """
    The mass matrix couples the motor with the link before: x_before -= S q2'', y -= S q1_before''.

    The accelerations are those of the substep before. That converges while S^2 < J / (M^-1)_11,
    which is when the mass matrix is positive definite, as every real one is. The first joint has
    no link before it: nothing happens there. In space S counts times the cosine between the axes
    of this joint and the one before, and not where either slides.
    """

    name = 'motor_inertia_coupling'
    words = 'Inertia between a motor and the link before its joint, which carries it'
    stage = Stage.LINK
    evidence = 'link acceleration'
    discriminated_by = 'fast motion of this joint with the one before it held, and free'
    parameters = (Parameter('inertia', 'kg m^2',
                            'coupling inertia S, rotor inertia times gear ratio',
                            typical=lambda s: s.inertia),)
    guesses = staticmethod(lambda s: linear(0.3 * s.inertia))

    @staticmethod
    def on_arm(values, arm, joint) -> tuple[float, ...]:
        if arm.frames is None or joint == 0:
            return values
        turning = not arm.frames.prismatic[joint - 1:joint + 1].any()
        return (turning * values[0] * arm.frames.rotation[joint][2, 2],)

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if s[JOINT] > 0.5:
            s[LINK_TORQUE - WIDTH] -= p[0] * s[DDQ_MOTOR]
            s[MOTOR_TORQUE] -= p[0] * s[DDQ_LINK - WIDTH]


class MotorViscous(Term):
    """y -= viscous dq_motor."""

    name = 'motor_viscous'
    words = 'Viscous friction of the motor side'
    stage = Stage.MOTOR
    evidence = 'motor rate'
    similar = ('viscous_error',)
    discriminated_by = 'fast motion of the motor with the link taken off'
    fed_forward = True
    parameters = (Parameter('viscous', 'N m s/rad', 'viscous coefficient', lower=0.0,
                            typical=lambda s: 0.2 * s.friction / s.speed),)
    # of a rigid joint it is viscous_error
    guesses = staticmethod(lambda s: [] if s.rigid else linear(
        0.1 * s.friction / s.speed, positive=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[MOTOR_TORQUE] -= p[0] * s[DQ_MOTOR]


class MotorCoulomb(Term):
    """y -= coulomb sgn(dq_motor), linear below 1e-3 rad/s so that it can hold."""

    name = 'motor_coulomb'
    words = 'Dry friction of the motor side'
    stage = Stage.MOTOR
    evidence = 'motor rate'
    similar = ('coulomb_error',)
    discriminated_by = 'slow motion of the motor with the link taken off'
    parameters = (Parameter('coulomb', 'N m', 'level', lower=0.0,
                            typical=lambda s: 0.3 * s.friction),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction, positive=True))
    holding_torque = staticmethod(lambda values: values[0])

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[MOTOR_TORQUE] -= p[0] * min(max(s[DQ_MOTOR] * 1e3, -1.0), 1.0)


class MotorTorqueBias(Term):
    """y += bias."""

    name = 'motor_torque_bias'
    words = 'Constant torque on the motor, as from an amplifier offset'
    stage = Stage.MOTOR
    evidence = 'motor rate'
    similar = ('constant_link_torque',)
    discriminated_by = 'a recording with another load, or with the link held'
    fed_forward = True
    parameters = (Parameter('bias', 'N m', 'torque', typical=lambda s: 0.3 * s.friction),)
    # of a rigid joint it is constant_link_torque
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.1 * s.friction))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[MOTOR_TORQUE] += p[0]


class TorqueRipple(Term):
    """y += amplitude sin(order q_motor + phase)."""

    name = 'torque_ripple'
    words = 'Ripple of motor or gear, periodic in the motor angle'
    stage = Stage.MOTOR
    evidence = 'motor angle'
    similar = ('kinematic_error',)
    again = ('torque_ripple_2', 'torque_ripple_3')
    discriminated_by = 'the same motion under another load'
    fed_forward = True
    parameters = (
        Parameter('amplitude', 'N m', 'amplitude', lower=0.0, typical=lambda s: 0.1 * s.friction),
        Parameter('order', '1', 'periods per revolution', lower=0.0,
                  searched=(1.5, math.inf)),  # a slower wave is a constant and a slope
        Parameter('phase', 'rad', 'phase at q_motor = 0'))
    guesses = staticmethod(lambda s: waves(
        0.05 * s.friction, (*orders(s.travel.turned, HIGHEST_ORDER, 2.0), *s.fine_orders)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[MOTOR_TORQUE] += p[0] * np.sin(p[1] * s[Q_MOTOR] + p[2])


class SecondTorqueRipple(TorqueRipple):
    """As torque_ripple, of another order."""

    name, words = 'torque_ripple_2', 'A second ripple of motor or gear, of another order'
    similar = again = ()
    guesses = staticmethod(lambda s: [])  # those of the first


class ThirdTorqueRipple(SecondTorqueRipple):
    """As torque_ripple, of a third order."""

    name, words = 'torque_ripple_3', 'A third ripple of motor or gear, of yet another order'
