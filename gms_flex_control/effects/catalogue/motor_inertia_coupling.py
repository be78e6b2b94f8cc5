# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Inertia between a motor and the link before its joint, which carries it."""

from gms_flex_control.effects import signals as sig
from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear


class MotorInertiaCoupling(Term):
    """
    The mass matrix couples the motor with the link before: x_before -= S q2'', y -= S q1_before''.

    The accelerations are those of the substep before. That converges while S^2 < J / (M^-1)_11,
    which is when the mass matrix is positive definite, as every real one is. The first joint has
    no link before it: nothing happens there. In space S counts times the cosine between the axes
    of this joint and the one before, and not where either slides.
    """

    name = 'motor_inertia_coupling'
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
        if s[sig.JOINT] > 0.5:
            s[sig.LINK_TORQUE - sig.WIDTH] -= p[0] * s[sig.DDQ_MOTOR]
            s[sig.MOTOR_TORQUE] -= p[0] * s[sig.DDQ_LINK - sig.WIDTH]
