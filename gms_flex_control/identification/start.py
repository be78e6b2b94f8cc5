# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Where a fit begins: the friction map for the steady part, a wide spread for the rest."""

from typing import NamedTuple
import warnings

from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.steady import fit_stribeck, straight, Stribeck
import numpy as np

N_SPREAD = 8          # blocks with fixed yields that find the shape of the presliding curve
_LAG = 0.08           # of F_c over C: lag of sliding friction to begin with [s]
_FINEST = 0.25        # of an encoder step: smallest yield of the spread
_WIDEST = 0.3         # largest yield of the spread [rad], or the joint's travel
_FEWEST = 3           # windows of motion in a direction


class Start(NamedTuple):
    """
    Rough parameters of one joint.

    A Stribeck part as wide as the motion is fast bends like viscous friction: the cost has a
    local minimum with each in the other's place, and a fit begins from both.
    """

    forward: Stribeck
    backward: Stribeck
    attraction: float    # [N m/s]
    yields: np.ndarray   # (N_SPREAD,), of the spread [rad]
    straight: tuple      # of Stribeck, forward and backward: the Stribeck part is narrow

    def both(self):
        """Return steady parameters (4, 2) forward and backward, as fitted and as straight."""
        return tuple(np.array(pair).T for pair in ((self.forward, self.backward), self.straight))


def start_of(friction_map, travel, resolution, joint, source, level=None):
    """
    Return where the fit of a joint begins.

    Parameters
    ----------
    friction_map : FrictionMap
        Of the joint.
    travel : float
        Range of its angle [rad].
    resolution : float
        Encoder step or noise [rad].
    joint, source : str
        For messages.
    level : float, optional
        Friction to begin with where inertia and gravity are only roughly known, so that what
        is left of the torque can drive the joint instead of braking it [N m].

    Returns
    -------
    Start

    Raises
    ------
    IdentificationError
        If the joint hardly moves, or friction drives it instead of braking it.

    Warns
    -----
    UserWarning
        If ``level`` had to be taken.

    """
    directions, lines = [], []
    for sign, name in ((1.0, 'forward'), (-1.0, 'backward')):
        rows = np.sign(friction_map.velocity) == sign
        if (rows & friction_map.steady).sum() >= _FEWEST:
            rows &= friction_map.steady
        if rows.sum() < _FEWEST:
            raise IdentificationError(
                f'{source}: {joint} moves {name} in {rows.sum()} windows of a quarter second '
                f'only; friction has two directions: record motion both ways')
        torque = sign * friction_map.torque[rows]
        if np.median(torque) <= 0.0 and level is not None:
            warnings.warn(
                f'{source}: what inertia and gravity leave of the torque of {joint} drives its '
                f'{name} motion as often as it brakes it: other forces (links that act on each '
                'other, gravity) hide its friction; trust it only as far as the error on data '
                'held out', stacklevel=2)
            directions.append(Stribeck(1.02 * level, level, float(np.abs(
                friction_map.velocity[rows]).max()), 1e-3 * level))
            lines.append(directions[-1])
            continue
        if np.median(torque) <= 0.0:
            raise IdentificationError(
                f'{source}: friction of {joint} would drive its {name} motion (median '
                f'{np.median(torque):.4g} N m); check the sign of the torque, the inertia and '
                'gravity of the robot file')
        for fitted, fit in ((directions, fit_stribeck), (lines, straight)):
            fitted.append(fit(sign * friction_map.velocity[rows], torque))
    finest = max(_FINEST * resolution, 1e-6 * travel, 1e-9)
    widest = max(min(_WIDEST, travel), 20.0 * finest)
    return Start(*directions, attraction=directions[0].coulomb / _LAG,
                 yields=np.geomspace(finest, widest, N_SPREAD), straight=tuple(lines))
