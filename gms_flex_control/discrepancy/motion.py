# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A recorded motion at the samples of the equations: every few of the recording, filtered."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

from gms_flex_control import records
from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.discrepancy import samples as sampling
from gms_flex_control.dynamics import chain
from gms_flex_control.effects.base import Scales, Travel
import numpy as np
from scipy.ndimage import convolve1d, maximum_filter1d, minimum_filter1d

WORKING_PERIOD = 4e-3  # sample at which the equations are formed, if the recording is finer [s]
_STANDING = 0.2        # a link stands that its encoder does not see move for so long [s]
_ONE_COUNT = 1.5       # counts: the reading goes to and fro between two
_DEVIATIONS = 6.0      # of noise: so far apart readings of a link at rest lie
_MOST_KEPT = 16        # torques along a motion that are kept


@dataclass(frozen=True, eq=False)
class Motion:
    """
    One measured motion of n joints as the equations take it.

    The equations are formed at S samples, every ``factor`` of the T samples of the recording;
    readings and held torques reach them through one symmetric filter, so none is wasted.
    """

    samples: sampling.Samples
    factor: int               # samples of the recording per sample of the equations
    time: np.ndarray          # (S,) [s]
    period: float             # [s]
    states: np.ndarray        # (S, 6, n) smoothed motion there
    second: np.ndarray        # (S, 2, n) filtered second differences of readings [rad/s^2]
    drive: np.ndarray         # (S, n) the torque commands behind the same filter [N m]
    torsion_rest: np.ndarray  # (S, n) torsion as read, filtered, less the smoothed one [rad]
    standing: np.ndarray      # (S, n) whether the encoder sees the link stand, bool
    known: np.ndarray         # (S,) whether all angles around were read, bool
    torque: tuple = ()        # what distinguishes its torque from the one recorded
    _kept: dict = field(repr=False, default_factory=dict)

    def once(self, key, make) -> Any:
        """Return what ``make`` returns, of the last few keys without calling it again."""
        found = self._kept.pop(key, None)
        found = make() if found is None else found
        self._kept[key] = found  # the latest one asked for is last
        for old in list(self._kept)[:-_MOST_KEPT]:
            self._kept.pop(old, None)
        return found

    def carrying(self, constants) -> np.record:
        """Return the kernels' record of a model with the load that was carried."""
        if self.samples.load is None:
            return constants
        boxed = records.boxed(constants)
        boxed['chain'][0] = chain.carrying(constants.chain, self.samples.load)
        return boxed[0]

    def through_filter(self, torque) -> np.ndarray:
        """Return torques (T, n) held over samples as the equations see them, shape (S, n)."""
        return thinned(analysis.held_triangle(torque), self.factor)

    @cached_property
    def settled(self) -> np.ndarray:
        """Return which samples (S,) were read and are settled after smoothing, bool."""
        middle, half = 0.5 * (self.time[0] + self.time[-1]), 0.5 * np.ptp(self.time)
        return self.known & (np.abs(self.time - middle) < half - analysis.SETTLED)

    @cached_property
    def push(self) -> np.ndarray:
        """Return what pushed the links, as the equations see it (S, n) [N m]."""
        return self.through_filter(self.samples.pushed)

    def with_torque(self, way, change) -> Self:
        """Return the Motion with other held torques (T, n) [N m], as ``change`` makes them."""
        torque = (*self.torque, way)

        def made():
            command = change(self.samples.command)
            return replace(self, samples=replace(self.samples, command=command),
                           drive=self.through_filter(command), torque=torque)
        return self.once(('torque', *torque), made)


def thinned(values, factor) -> np.ndarray:
    """Return every ``factor``-th of values (T, ...) behind two triangles of that length."""
    if factor == 1:
        return values
    triangle = np.convolve(np.ones(factor), np.ones(factor))
    kernel = np.convolve(triangle, triangle)
    return np.ascontiguousarray(
        convolve1d(values, kernel / kernel.sum(), axis=0, mode='nearest')[::factor])


def filtered_alike(torque, weight) -> np.ndarray:
    """Return sampled torques (S, n) as filtered ones, ``weight`` on both neighbours."""
    out = torque.copy()
    out[1:-1] += weight * (torque[:-2] - 2.0 * torque[1:-1] + torque[2:])
    return out


def weight_of_neighbours(factor) -> float:
    """Return the weight with which `filtered_alike` is the filter of `Motion`."""
    return (1.0 / 6.0 + (factor ** 2 - 1.0) / 3.0) / (2.0 * factor ** 2)


def motion_of(recording, robot) -> Motion:
    """Return the Motion of a Recording; arguments and errors as of `samples_of`."""
    return make_motion(sampling.samples_of(recording, robot))


def make_motion(samples, factor=None) -> Motion:
    """Return the Motion of Samples, its equations every `WORKING_PERIOD` or ``factor`` samples."""
    period = samples.period
    factor = factor or max(int(WORKING_PERIOD / period * (1.0 + 1e-6)), 1)
    thin = np.ascontiguousarray(samples.states[::factor])
    link, motor = samples.readings[:, 0], samples.readings[:, 1]
    window = analysis.odd_window(analysis.RATE_WINDOW / period)
    torsion = thinned(filtered_alike(motor - link, 1.0 / 12.0), factor)
    return Motion(
        samples=samples, factor=factor, time=np.ascontiguousarray(samples.time[::factor]),
        period=period * factor, states=thin,
        second=thinned(analysis.second_difference(samples.readings, period), factor),
        drive=thinned(analysis.held_triangle(samples.command), factor),
        torsion_rest=torsion - filtered_alike(
            thin[:, 3] - thin[:, 0], weight_of_neighbours(factor)),
        standing=standing(link, samples.noise[0], period)[::factor],
        known=minimum_filter1d(samples.known, window + 4 * factor)[::factor])


def at_full_rate(motion) -> Motion:
    """Return a Motion with its equations formed at every sample of the recording."""
    return make_motion(motion.samples, factor=1)


def standing(angle, noise, period) -> np.ndarray:
    """Return when encoders of noise (n,) see links (T, n) stand, bool (T, n) [rad]."""
    window = max(round(_STANDING / period), 3)
    spread = (maximum_filter1d(angle, window, axis=0) - minimum_filter1d(angle, window, axis=0))
    step = np.array([sampling.encoder_step(column, own)
                     for column, own in zip(angle.T, noise, strict=True)])
    return spread <= np.maximum(_ONE_COUNT * step, _DEVIATIONS * noise)


def scales_of(motions, robot) -> list:
    """Return the Scales of each joint over all recordings."""
    arm, found = robot.arm, []
    for j in range(robot.n_joints):
        link, rate, motor = (np.concatenate([one.states[:, row, j] for one in motions])
                             for row in (0, 1, 3))
        torque = np.concatenate([one.samples.command[:, j] for one in motions])
        torsion = 0.0 if arm.rigid[j] else float(np.std(motor - link))  # without the offset
        spring = float(arm.stiffness[j] * torsion) if torsion > 0.0 else float(np.std(torque))
        speed = max(float(np.sqrt(np.mean(rate ** 2))), 1e-6)
        found.append(Scales(
            friction=float(np.mean([side.static[j] + side.viscous[j] * speed for side in (
                robot.friction.forward, robot.friction.backward)])),
            torque=float(np.abs(torque).max()), spring=spring, torsion=torsion, speed=speed,
            inertia=float(arm.motor_inertia[j]), link_inertia=float(arm.link_inertia[j]),
            mass=float(arm.mass.sum()), travel=Travel(
                float(link.min()), float(link.max()), float(np.ptp(motor))),
            duration=float(max(one.time[-1] - one.time[0] for one in motions)),
            supply=min(float(one.samples.supply.mean()) for one in motions),
            count=max(sampling.encoder_step(one.samples.readings[:, 0, j], one.samples.noise[0, j])
                      for one in motions),
            presliding=_presliding(robot.friction, j),
            in_space=arm.frames is not None))
    return found


def _presliding(friction, joint):
    """Return the displacement at which the softest block of a joint slips, 0 without any."""
    level = friction.weight[joint] * friction.forward.coulomb[joint]
    stiffness = friction.stiffness[joint]
    acts = stiffness > 0.0
    return float(np.max(level[acts] / stiffness[acts], initial=0.0))
