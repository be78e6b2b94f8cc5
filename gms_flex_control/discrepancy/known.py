# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Parameters a user knows, but never exactly: re-tuned with every hypothesis, within their doubt.

Each knob is a relative change of numbers the model has; whatever moves one beyond its bounds is
no inaccuracy any more but an effect with a name, such as stiffness_error.
"""

from typing import NamedTuple

import numpy as np


class Knob(NamedTuple):
    """One relative change of known parameters."""

    name: str
    joint: int            # -1 for the whole arm
    doubt: float          # largest relative change
    fields: tuple         # of (part, field, index) of the kernels' record
    signs: tuple          # +1 or -1 for each field

    def apply(self, constants, value):
        """Change a record of simulation.plant.constants_of in place by ``value``."""
        for (part, field, index), sign in zip(self.fields, self.signs, strict=True):
            getattr(getattr(constants, part), field)[index] *= 1.0 + sign * value


class RotorKnob(NamedTuple):
    """One relative change of the motor inertia of a rigid joint, which several numbers share."""

    joint: int
    doubt: float          # largest relative change
    name = 'motor_inertia'
    fields = (('chain', 'motor_inertia', ...), ('chain', 'rigid_inertia', ...))

    def apply(self, constants, value):
        """Change a record of simulation.plant.constants_of in place by ``value``."""
        own, seen = constants.chain.motor_inertia, constants.chain.rigid_inertia
        toward = constants.chain.inverse[self.joint]
        seen += value * own[self.joint] * np.outer(toward, toward)  # theta is not the joint's
        own[self.joint] *= 1.0 + value


DOUBT = {'inertia': 0.045, 'gravity': 0.045, 'stiffness': 0.045, 'motor_inertia': 0.045,
         'level': 0.045, 'asymmetry': 0.03, 'viscous': 0.045, 'viscous_asymmetry': 0.045,
         'static': 0.03, 'velocity': 0.1, 'attraction': 0.3, 'blocks': 0.1, 'damping': 0.1}

MOST_DOUBT = 0.8  # nothing that a model has vanishes altogether

# effects that are larger errors of what a knob re-tunes, which then rests
REPLACED = {'stiffness_error': 'stiffness', 'motor_inertia_error': 'motor_inertia',
            'coulomb_error': 'level', 'viscous_error': 'viscous', 'stribeck_error': 'static',
            'presliding_error': 'blocks', 'friction_asymmetry': 'asymmetry'}


def knobs_of(constants, doubt):
    """
    Return the knobs of a robot.

    Parameters
    ----------
    constants : numpy.record
        Of simulation.plant.constants_of.
    doubt : dict of str to float
        Largest relative change of each kind.

    Returns
    -------
    tuple of Knob and RotorKnob

    """
    chain, friction, knobs = constants.chain, constants.friction, []
    n = len(chain.motor_inertia)

    def add(kind, joint, *fields, signs=None):
        knobs.append(Knob(kind, joint, doubt[kind], fields, signs or (1,) * len(fields)))

    heavy = np.any(chain.gravity != 0.0)
    for i in range(n):
        # what link i has of mass times distance: gravity and its coupling to every link before
        moment = [('chain', 'coupling', pair) for k in range(i) if chain.coupling[k, i] != 0.0
                  for pair in ((k, i), (i, k))]
        if heavy and chain.moment[i] != 0.0:
            add('gravity', i, *moment, ('chain', 'moment', i))
        elif moment:
            add('inertia', -1, *moment, ('chain', 'moment', i))
        if chain.coupling[i, i] != 0.0:
            add('inertia', i, ('chain', 'coupling', (i, i)))
    for j in range(n):
        if chain.flexible[j]:
            add('stiffness', j, ('chain', 'stiffness', j))
            add('motor_inertia', j, ('chain', 'motor_inertia', j))
        elif chain.motor_inertia[j] > 0.0:
            knobs.append(RotorKnob(j, doubt['motor_inertia']))
        if chain.damping[j] > 0.0:
            add('damping', j, ('chain', 'damping', j))
        level = [('friction', name, (row, j)) for row in (0, 1) for name in ('static', 'coulomb')]
        add('level', j, *level)
        add('asymmetry', j, *level, signs=(1, 1, -1, -1))
        for kind, signs in (('viscous', (1, 1)), ('viscous_asymmetry', (1, -1))):
            add(kind, j, *(('friction', 'viscous', (row, j)) for row in (0, 1)), signs=signs)
        above = (1.0 - doubt['static']) * friction.static[:, j] >= friction.coulomb[:, j]
        if above.all():  # else it may fall below Coulomb friction; stribeck_error lifts it
            add('static', j, *(('friction', 'static', (row, j)) for row in (0, 1)))
        for row in (0, 1):
            add('velocity', j, ('friction', 'velocity', (row, j)))
        add('attraction', j, ('friction', 'attraction', j))
        add('blocks', j, ('friction', 'stiffness', j))
    return tuple(knobs)


def tuned(constants, knobs, values):
    """Return a copy of constants with knobs at ``values`` (P,)."""
    copy = constants.copy()
    for knob, value in zip(knobs, values, strict=True):
        if value != 0.0:
            knob.apply(copy, value)
    return copy
