# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
First guesses of an effect: small sizes whose torques are looked for in what a model leaves.

An effect that is linear in its parameters needs one guess; one that is not gives several, of
which the data choose, and a fit goes on from there.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

HIGHEST_ORDER = 48.0  # of waves over the motor angle that are guessed; data show finer ones


class Travel(NamedTuple):
    """Between which angles a link moved, and how far its motor turned."""

    lowest: float   # [rad]
    highest: float  # [rad]
    turned: float   # between the motor's lowest and highest angle [rad]

    @property
    def span(self) -> float:
        """Return how far the link moved [rad]."""
        return self.highest - self.lowest


class Scales(NamedTuple):
    """What a recording and its model set as usual sizes on one joint."""

    friction: float   # F_s and viscous friction at that speed, mean of both directions [N m]
    torque: float     # largest command [N m]
    spring: float     # standard deviation of the spring torque [N m]
    torsion: float    # standard deviation of the torsion [rad]; 0 where rigid
    speed: float      # rms of the link's rate [rad/s]
    inertia: float    # J [kg m^2]
    link_inertia: float  # about the joint [kg m^2]
    travel: Travel
    duration: float   # [s]
    supply: float = 0.0  # mean voltage of the supply [V]; 0 where it is not known
    fine_orders: tuple = ()  # of waves over the motor angle that stand out [1/rad]
    mass: float = 1.0  # of all links [kg]
    count: float = 0.0  # of the coarsest encoder of the link [rad]; 0 where readings have no steps
    presliding: float = np.inf  # displacement at which the softest block slips [rad]
    in_space: bool = False  # other joints feel the inertia of its link, and none its motor's

    @property
    def rigid(self) -> bool:
        """Return whether the joint has no spring."""
        return self.torsion <= 0.0


class Guess(NamedTuple):
    """One way an effect might act: columns of a linear problem, and what its numbers mean."""

    probes: tuple              # values of all parameters of the effect, one set per column
    values: Callable           # coefficients -> values of all parameters
    lowest: float = -np.inf    # of every coefficient
    highest: float = np.inf
    within: Callable = lambda c: 1.0  # coefficients -> share that the bounds allow, 0 to 1

    @property
    def is_linear(self) -> bool:
        """Return whether the effect is proportional to its first parameter."""
        size = self.probes[0][0]
        return len(self.probes) == 1 and size != 0.0 and self.values([0.5])[0] == 0.5 * size


def linear(size, *fixed, positive=False) -> list[Guess]:
    """Return the guess of an effect proportional to its first parameter, list of one."""
    return [Guess(((size, *fixed),), lambda c: (c[0] * size, *fixed),
                  0.0 if positive else -np.inf)]


def wave(size, *fixed) -> list[Guess]:
    """
    Return the guess of an effect that adds like ``size sin(... + phase)``, list of one.

    The phase is its last parameter; ``fixed`` are those between. Two columns a quarter apart hold
    every phase, of sines as of cosines.
    """
    return [Guess(((size, *fixed, 0.0), (size, *fixed, 0.5 * np.pi)),
                  lambda c: (size * np.hypot(c[0], c[1]), *fixed,
                             float(np.arctan2(c[1], c[0]))))]


def waves(size, orders) -> list[Guess]:
    """Return the guesses of `wave` for each order, the parameter after the size."""
    return [guess for order in orders for guess in wave(size, order)]


def orders(span, highest, lowest=1.0) -> np.ndarray:
    """Return orders within bounds that motion over a span [rad] can distinguish."""
    step = np.clip(np.pi / max(span, 1e-6), 0.25, 1.0)
    return np.arange(lowest, highest + 0.5 * step, step)


def sizes(values, *fixed) -> list[Guess]:
    """Return guesses of an effect that is not linear in its first parameter, one per value."""
    return [Guess(((value, *fixed),), lambda c, value=value: (value, *fixed), 0.0, 3.0)
            for value in values]


def shapes(size, values, positive=True) -> list[Guess]:
    """Return guesses linear in the first parameter for each value of the second."""
    return [Guess(((size, value),), lambda c, value=value: (c[0] * size, value),
                  0.0 if positive else -np.inf)
            for value in values]
