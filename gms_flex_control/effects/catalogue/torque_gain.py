# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Torque constant other than believed."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import TORQUE


class TorqueGain(Term):
    """u -> u (1 + gain_error)."""

    name = 'torque_gain'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    confusable = ()
    tells = 'a known weight hung on the link'
    parameters = (
        Parameter('gain_error', '1', 'relative error', relative=True),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.2,)

    @classmethod
    def excludes(cls, rigid):
        """Return what may not stand beside it, tuple of str."""
        return (('link_inertia_error', 'motor_inertia_error') if rigid
                else ('stiffness_error',))  # together they would scale the whole joint

    @classmethod
    def search_bounds(cls, joint_index, robot):
        """Return what is looked for, two lists: no drive gives more than twice its torque."""
        lower, _ = super().search_bounds(joint_index, robot)
        return lower, [1.0]

    @classmethod
    def torque_scale(cls, values, supply):
        """Return the factor of the whole torque."""
        return 1.0 + values[0]

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[TORQUE] *= 1.0 + p[0]
