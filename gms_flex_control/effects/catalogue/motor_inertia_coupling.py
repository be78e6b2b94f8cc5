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
    no link before it: nothing happens there.
    """

    name = 'motor_inertia_coupling'
    stage = Stage.LINK
    evidence = 'link acceleration'
    confusable = ()
    tells = 'fast motion of this joint with the one before it held, and free'
    parameters = (
        Parameter('inertia', 'kg m^2', 'coupling inertia S, rotor inertia times gear ratio'),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.3 * scales.inertia)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (scales.inertia,)

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        if s[sig.JOINT] > 0.5:
            s[sig.LINK_TORQUE - sig.WIDTH] -= p[0] * s[sig.DDQ_MOTOR]
            s[sig.MOTOR_TORQUE] -= p[0] * s[sig.DDQ_LINK - sig.WIDTH]
