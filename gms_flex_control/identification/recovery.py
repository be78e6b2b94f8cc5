# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How well an experiment on a simulated robot gives back the friction that is in it."""

import math
from typing import NamedTuple

from gms_flex_control.experiment.identification_simulated import simulate_identification
from gms_flex_control.identification.beside import known_values, presliding_difference
from gms_flex_control.identification.identify import identify
from gms_flex_control.identification.result import Estimate, Interval
import numpy as np


class Trial(NamedTuple):
    """One identification of a robot that is known."""

    seed: int
    estimates: tuple   # of (Estimate, true value), those of friction of all joints
    blocks: tuple      # number of blocks chosen for each joint
    curve: tuple       # largest error of the presliding curve of each joint, over F_s
    seconds: float


class Recovered(NamedTuple):
    """One parameter over all trials."""

    name: str
    true: float
    middle: float      # median estimate
    worst: float       # largest relative error
    covered: float     # share of intervals that hold the truth; NaN without any
    told: float        # share of trials with an interval
    trials: int


class TrialItem(NamedTuple):
    """A trial to be done, perhaps in another process; see `trial`."""

    plan: object
    robot: object
    believed: object
    gains: object
    seed: int
    rate: float
    torque_noise: float


def try_item(item):
    """Return the Trial of a TrialItem as `as_values` does."""
    *setting, seed, rate, torque_noise = item
    return as_values(trial(*setting, seed, rate=rate, torque_noise=torque_noise))


def as_values(one):
    """Return a Trial as plain values for JSON, from which `from_values` makes it again."""
    pairs = [[*estimate._replace(value=_written(estimate.value),
                                 interval=[*map(_written, estimate.interval)]), _written(true)]
             for estimate, true in one.estimates]
    return {**one._asdict(), 'estimates': pairs, 'blocks': [*map(int, one.blocks)],
            'curve': [*map(_written, one.curve)]}


def _written(number):
    """Return a float; as text what JSON has no number for."""
    return float(number) if math.isfinite(number) else str(float(number))


def from_values(values):
    """Return the Trial of what `as_values` returned."""
    pairs = []
    for *fields, true in values['estimates']:
        estimate = Estimate(*fields)
        pairs.append((estimate._replace(
            value=float(estimate.value), interval=Interval(*map(float, estimate.interval)),
            flags=tuple(estimate.flags)), float(true)))
    return Trial(**{**values, 'estimates': tuple(pairs), 'blocks': tuple(values['blocks']),
                    'curve': tuple(map(float, values['curve']))})


def trial(plan, robot, believed, gains, seed, *, rate, torque_noise, options=None):
    """
    Simulate an experiment and identify it.

    Parameters
    ----------
    plan : IdentificationPlan
        The experiment.
    robot, believed : RobotParams
        The robot as it is, and as controller and identification believe it to be.
    gains : ControllerParams
        Of the controller.
    seed : int
        Of noise and of where within a count the links begin.
    rate : float
        Samples per second [Hz].
    torque_noise : float
        Of the recorded torque [N m].
    options : Options, optional
        Of the identification.

    Returns
    -------
    Trial

    """
    take = simulate_identification(plan, robot, gains, seed, rate=rate,
                                   torque_noise=torque_noise, model=believed)
    found = identify([take], believed, options=options)
    pairs = []
    for result in found.joints:
        known = known_values(robot, found.robot, result.joint)
        pairs += [(estimate, known[estimate.name]) for estimate in result.estimates
                  if estimate.name in known]
    return Trial(seed, tuple(pairs),
                 tuple(next(c.n_blocks for c in result.candidates if c.chosen)
                       for result in found.joints),
                 tuple(presliding_difference(result, robot)[0] for result in found.joints),
                 found.seconds)


def recovered(trials):
    """
    Return how each parameter came out over all trials.

    Parameters
    ----------
    trials : sequence of Trial
        At least one.

    Returns
    -------
    tuple of Recovered
        Block stiffnesses only from trials with as many blocks as the truth.

    """
    groups = {}
    for one in trials:
        for estimate, true in one.estimates:
            groups.setdefault(estimate.name, []).append((estimate, true))
    rows = []
    for name, pairs in groups.items():
        values = np.array([estimate.value for estimate, _ in pairs])
        truth = np.array([true for _, true in pairs])
        holds = [e.interval.low <= true <= e.interval.high for e, true in pairs
                 if np.isfinite(e.interval).all()]
        rows.append(Recovered(
            name, float(truth[0]), float(np.median(values)),
            float(np.max(np.abs(values / truth - 1.0))),
            float(np.mean(holds)) if len(holds) else np.nan, len(holds) / len(pairs),
            len(pairs)))
    return tuple(rows)
