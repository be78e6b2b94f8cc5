# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Populations of hidden robots: what is drawn otherwise than at home, one row each.

A population changes one thing (those with noise: beliefs as well). Kind and seed give the same
robot with the same effects in it wherever neither gravity nor motion differ, but for sizes that
are relative to a run: further numbers come from a generator of the population's own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from bench.hidden_robots import mujoco_plant, plants, truth
import numpy as np
from scipy.signal import lfilter

CORNERS = (2.0, 20.0)  # of coloured torque noise, one drawn for each joint [Hz]
# standard deviation of what is believed, relative; of a robot a factor from SPREAD of it
WIDTHS = {'inertia': 0.015, 'motor_inertia': 0.015, 'stiffness': 0.015, 'level': 0.015,
          'viscous': 0.025, 'blocks': 0.08, 'velocity': 0.12, 'attraction': 0.15}
SPREAD, FARTHEST = (0.5, 1.5), 3.5  # nothing is farther off than so many deviations


def gaussian_errors(rng):
    """Return a function (kind, *shape) that draws relative errors, normal, of `WIDTHS`."""
    deviation = {kind: width * rng.uniform(*SPREAD) for kind, width in WIDTHS.items()}

    def draw(kind, *shape):
        return deviation[kind] * np.clip(rng.standard_normal(shape), -FARTHEST, FARTHEST)
    return draw


@dataclass(frozen=True, kw_only=True)
class Population:
    """What is particular about the robots of a population; the defaults are those of 'home'."""

    # what is believed, as `plants.draw_belief` takes it; None as at home, 1 to 3 % off
    beliefs: Callable | None = None
    # torque that the drives add, held over a sample, and that nobody records: standard deviation
    # as a part of F_s of its joint
    noise: float = 0.0
    # whether the noise is of first order, with a corner in `CORNERS`, or white
    coloured: bool = False
    counts: int | None = None  # of the encoders per revolution; None: drawn from `plants.COUNTS`
    velocity_cutoff: float = 50.0  # of the low-pass on the differenced angles [Hz]
    links_seen: bool = True  # whether links have encoders that are recorded
    gravity: bool = False  # whether the plane is tilted, as far as the robot's springs bear it
    rate: float = 500.0  # of control and recording [Hz]
    softness: float = 1.0  # times the gains of the motor law, so that the loop is stable
    motion: str = 'rich'  # one of `motions.MOTIONS`
    drive: Callable = truth.under_cascade  # controller and integrator, see `truth.simulate`
    without: tuple = ()  # effects that these robots cannot have
    tuning: bool = False  # whether the workflow may be tuned with it; the others are for reporting


_noisy = partial(Population, beliefs=gaussian_errors)
POPULATIONS = {
    'home': Population(tuning=True),
    'gaussian_beliefs': Population(beliefs=gaussian_errors, tuning=True),
    'beliefs_3': Population(beliefs=partial(plants.uniform_errors, low=0.03, high=0.09)),
    'beliefs_10': Population(beliefs=partial(plants.uniform_errors, low=0.1, high=0.3)),
    'noise_1': _noisy(noise=0.01),
    'noise_3': _noisy(noise=0.03),
    'noise_6': _noisy(noise=0.06, tuning=True),
    'noise_3_coloured': _noisy(noise=0.03, coloured=True),
    'noise_6_coloured': _noisy(noise=0.06, coloured=True),
    'encoders_coarse': Population(counts=4096, velocity_cutoff=15.0, softness=0.5),
    'encoders_fine': Population(counts=500000),
    'motors_only': Population(links_seen=False),
    'gravity': Population(gravity=True),
    'rate_100': Population(rate=100.0, softness=0.4),
    'rate_1000': Population(rate=1000.0),
    'pid': Population(drive=truth.under_pid),
    'slow': Population(motion='slow'),
    'paper_sinusoid': Population(motion='sinusoid'),
    'paper_polynomial': Population(motion='polynomial', tuning=True),
    'mujoco': Population(drive=mujoco_plant.under_cascade, without=(truth.CARRIED, truth.BASE)),
}


class Drives:
    """
    The torque noise of a robot's drives.

    ``deviation`` (n_joints,) is the standard deviation of the torque of a sample [N m], ``corner``
    (n_joints,) the frequency above which there is less [Hz], inf of white noise.
    """

    def __init__(self, rng, population, robot):
        friction, n = robot.friction, robot.n_joints
        self.deviation = population.noise * 0.5 * (
            friction.forward.static + friction.backward.static)
        self.corner = (np.exp(rng.uniform(*np.log(CORNERS), n)) if population.coloured
                       else np.full(n, np.inf))
        self._keep = np.exp(-2.0 * np.pi * self.corner / population.rate)

    def draw(self, rng, samples):
        """Return the torque of one run, (samples, n_joints) [N m]."""
        white = rng.standard_normal((samples, len(self.corner)))
        white[1:] *= np.sqrt(1.0 - self._keep ** 2)  # so that it is stationary from the start
        return self.deviation * np.stack(
            [lfilter([1.0], [1.0, -keep], one) for keep, one in
             zip(self._keep, white.T, strict=True)], axis=1)


def belief_errors(robot, believed):
    """
    Return how far a robot of two joints in a plane is from what is believed, (n_joints,) each.

    Relative, truth / belief - 1, as effects of the catalogue state it, by kind. ``link_inertia``
    is that of a link about its joint with the mass it carries, ``coupling`` that of both links
    together; friction is the mean of both directions, and an ``asymmetry`` half their difference.
    """
    arm, steady = robot.arm, robot.friction
    other, thought = believed.arm, believed.friction

    def both(name):
        return np.array([getattr(true, name) / getattr(belief, name) - 1.0 for true, belief in (
            (steady.forward, thought.forward), (steady.backward, thought.backward))])

    own, cross = plants.base_parameters(arm)
    own_thought, cross_thought = plants.base_parameters(other)
    return {
        'stiffness': arm.stiffness / other.stiffness - 1.0,
        'motor_inertia': arm.motor_inertia / other.motor_inertia - 1.0,
        'link_inertia': own / own_thought - 1.0,
        'coupling': np.full(robot.n_joints, cross / cross_thought - 1.0),
        'level': both('coulomb').mean(axis=0), 'static': both('static').mean(axis=0),
        'asymmetry': 0.5 * (both('coulomb')[0] - both('coulomb')[1]),
        'viscous': both('viscous').mean(axis=0), 'velocity': both('velocity').mean(axis=0),
        'viscous_asymmetry': 0.5 * (both('viscous')[0] - both('viscous')[1]),
        'blocks': (steady.stiffness / thought.stiffness - 1.0).mean(axis=1),
        'attraction': steady.attraction / thought.attraction - 1.0}
