# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Tracking of robots that hardly differ.

Compensated well, what is left of an error is made of single events: a link that sticks a moment
too long. Whether one happens hangs on friction to a millionth, so one run says little; the median
over robots that differ by less than anyone could know says what to expect.
"""

from dataclasses import replace

from gms_flex_control.analysis.tracking import link_rms
from gms_flex_control.experiment.simulated import simulate
import numpy as np


def tracking_of_copies(plan, model, count=16, spread=1e-3, seed=0):
    """
    Return the tracking errors of robots whose friction differs a little.

    Parameters
    ----------
    plan : Plan
        Robot, motion and gains.
    model : RobotParams
        What the controller believes.
    count : int
        How many robots.
    spread : float
        Standard deviation of each stiffness of their blocks, relative.
    seed : int
        Of these; the same robots for every model.

    Returns
    -------
    ndarray, shape (count, n)
        Rms error of each link [rad].

    """
    rng, friction, errors = np.random.default_rng(seed), plan.robot.friction, []
    for _ in range(count):
        factor = 1.0 + spread * rng.standard_normal(friction.stiffness.shape)
        robot = replace(plan.robot, friction=replace(
            friction, stiffness=factor * friction.stiffness))
        own = replace(plan, robot=robot, model=model)
        errors.append(link_rms(simulate(own, 'copy')))
    return np.array(errors)
