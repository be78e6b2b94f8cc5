# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Effects of the drive: what its actuator makes of a command; inertia and losses of the motor."""

from dataclasses import replace
import math

from gms_flex_control.effects import base as sig
from gms_flex_control.effects.base import (
    Change,
    Guess,
    HIGHEST_ORDER,
    LEAST_RELATIVE,
    linear,
    orders,
    Parameter,
    sizes,
    Stage,
    Term,
    waves,
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
        """Return how it might be there; a rigid joint has the inertia of its link, too."""
        if scales.rigid and scales.link_inertia > 0.0 and not scales.in_space:
            return []
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
        """Return S times the cosine between the axes of the joint and of the one before."""
        if arm.frames is None or joint == 0:
            return values
        turning = not arm.frames.prismatic[joint - 1:joint + 1].any()
        return (turning * values[0] * arm.frames.rotation[joint][2, 2],)

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if s[sig.JOINT] > 0.5:
            s[sig.LINK_TORQUE - sig.WIDTH] -= p[0] * s[sig.DDQ_MOTOR]
            s[sig.MOTOR_TORQUE] -= p[0] * s[sig.DDQ_LINK - sig.WIDTH]


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
        s[sig.MOTOR_TORQUE] -= p[0] * s[sig.DQ_MOTOR]


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
        s[sig.MOTOR_TORQUE] -= p[0] * min(max(s[sig.DQ_MOTOR] * 1e3, -1.0), 1.0)


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
        s[sig.MOTOR_TORQUE] += p[0]


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
        s[sig.MOTOR_TORQUE] += p[0] * np.sin(p[1] * s[sig.Q_MOTOR] + p[2])


class SecondTorqueRipple(TorqueRipple):
    """As torque_ripple, of another order."""

    name, words = 'torque_ripple_2', 'A second ripple of motor or gear, of another order'
    similar = again = ()
    guesses = staticmethod(lambda s: [])  # those of the first


class ThirdTorqueRipple(SecondTorqueRipple):
    """As torque_ripple, of a third order."""

    name, words = 'torque_ripple_3', 'A third ripple of motor or gear, of yet another order'


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
        s[sig.TORQUE] *= 1.0 + p[0]


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
        s[sig.TORQUE] -= min(max(s[sig.TORQUE], -p[0]), p[0])


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
        s[sig.TORQUE] = min(max(s[sig.TORQUE], -p[0]), p[0])


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
            short, gone = memory[0] - s[sig.TORQUE], -np.expm1(-dt / p[0])
            memory[0] -= short * gone
            s[sig.TORQUE] += short * gone * p[0] / dt


_SLOTS = 32  # commands that can be on their way


class InputDelay(Term):
    """u(t) -> u(t - delay), the mean over the step, exact for commands held 1/30 delay or more."""

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
        if s[sig.TORQUE] != memory[3 + 2 * newest]:
            if memory[0] - memory[2 + 2 * newest] >= p[0] / (_SLOTS - 2):
                newest = (newest + 1) % _SLOTS
                memory[1], memory[2 + 2 * newest] = newest, memory[0]
            memory[3 + 2 * newest] = s[sig.TORQUE]
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
        s[sig.TORQUE] = total / dt


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
        """Return how it might be there, about the mean voltage if that was recorded."""
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
        if s[sig.SUPPLY] > 0.0:
            s[sig.TORQUE] *= 1.0 + p[0] * (s[sig.SUPPLY] - p[1])
