# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The compensations that are compared, and under which conditions."""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.experiment.believed import scaled_friction
from gms_flex_control.tuning.uncertainty import draw
import numpy as np

PAPER_OBSERVER_GAIN = 0.01  # k_e (paper, section 6)
# mode of the controller: how it is called in tables
CONTESTANTS = {
    'none': 'none',
    'stribeck': 'static Stribeck',
    'lugre': 'LuGre',
    'gms_paper': 'GMS as in the paper',
    'gms': 'GMS, better',
    'gms_desired': 'GMS of desired motion',
    'disturbance_observer': 'disturbance observer',
    'gms_adaptive': 'adaptive GMS'}
NOMINAL, DRAWN = 'nominal', 'drawn'
RATE, COUNTS = 500.0, 20_000.0


class Condition(NamedTuple):
    """How the plant differs from what is believed, and how it is sampled."""

    name: str
    group: str              # conditions of one group are told together
    friction: float = 1.0   # times what is believed
    stiffness: float = 1.0
    mass: float = 1.0
    counts: float | None = None   # of the encoders; None: as the robot's file says
    rate: float | None = None     # [Hz]; None: as asked
    draw: int | None = None       # number of a robot drawn at random


def conditions(draws):
    """
    Return the conditions of the comparison.

    Parameters
    ----------
    draws : int
        How many robots are drawn with all parameters off at once.

    Returns
    -------
    list of Condition

    """
    found = [Condition(NOMINAL, NOMINAL)]
    for group, name, spread in (('friction', 'friction', 0.3), ('K', 'stiffness', 0.2),
                                ('M', 'mass', 0.3)):
        found += [Condition(f'{group} {100 * sign * spread:+.0f} %', group,
                            **{name: 1.0 + sign * spread}) for sign in (-1.0, 1.0)]
    found += [Condition(f'{counts} counts', f'{counts} counts', counts=float(counts))
              for counts in (4096, 16384, 65536)]
    found += [Condition(f'{rate} Hz', f'{rate} Hz', rate=float(rate)) for rate in (200, 1000)]
    return found + [Condition(f'drawn {k}', DRAWN, draw=k) for k in range(draws)]


def plant_of(robot, condition, seed):
    """
    Return the robot as it really is under a condition.

    Parameters
    ----------
    robot : RobotParams
        As believed.
    condition : Condition
        What differs.
    seed : int
        Of the draws; every compensation meets the same robots.

    Returns
    -------
    RobotParams

    """
    if condition.draw is not None:
        return draw(robot, {}, np.random.default_rng([seed, condition.draw]))[0]
    arm = replace(robot.arm, stiffness=robot.arm.stiffness * condition.stiffness,
                  mass=robot.arm.mass * condition.mass,
                  inertia=robot.arm.inertia * condition.mass)
    found = replace(robot, arm=arm, friction=scaled_friction(robot.friction, condition.friction))
    if condition.counts is not None:
        found = replace(found, encoder=replace(robot.encoder, counts=condition.counts))
    return found


def gains_of(gains, mode):
    """Return gains for a mode; the paper's observer has the paper's k_e."""
    if mode == 'gms_paper':
        gains = replace(gains, observer_gain=np.full_like(gains.observer_gain,
                                                          PAPER_OBSERVER_GAIN))
    return replace(gains, compensation=mode)
