# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How well parameters of a robot are known: relative standard deviations, by kind and joint."""

from typing import NamedTuple


class Kind(NamedTuple):
    """One kind of known parameter, and how well it is known where nothing else is stated."""

    sd: float          # relative standard deviation
    description: str


# data sheets and weighing for masses and springs, repeated identification for friction
KINDS = {
    'inertia': Kind(0.015, 'inertia of the link, or coupling of the arm (under arm)'),
    'gravity': Kind(0.015, 'mass moment of the link under gravity'),
    'stiffness': Kind(0.015, 'stiffness of the spring'),
    'motor_inertia': Kind(0.015, 'inertia of the motor'),
    'damping': Kind(0.05, 'damping of the spring'),
    'level': Kind(0.02, 'level of friction, both directions together'),
    'asymmetry': Kind(0.02, 'difference of the levels of both directions'),
    'viscous': Kind(0.025, 'viscous friction, both directions together'),
    'viscous_asymmetry': Kind(0.025, 'difference of viscous friction of both directions'),
    'static': Kind(0.015, 'static friction beside the level'),
    'velocity': Kind(0.12, 'Stribeck velocity'),
    'attraction': Kind(0.15, 'attraction of slipping blocks'),
    'blocks': Kind(0.08, 'stiffness of the friction blocks')}
LEAST, MOST = 1e-4, 10.0   # standard deviations that may be stated
