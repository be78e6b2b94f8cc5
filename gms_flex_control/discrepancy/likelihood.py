# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What models leave of recordings, held out or not, and how likely recordings are under a model.

Whitened residuals are normal where nothing is missing. The noise level of a group is not known,
only that it is not below that of null simulations; the most likely one is used. So what drives
and loads add, white or coloured, counts as noise, and a rest at which friction is anything up to
break-away does not count as much as motion does.
"""

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial
import os
from typing import NamedTuple, Self

from gms_flex_control.discrepancy.motion import scales_of
from gms_flex_control.discrepancy.nuisance import (
    acting,
    as_recorded,
    nuisances_of,
    of_recordings,
    OfRecording,
    recorded,
    tuned,
)
from gms_flex_control.discrepancy.null_simulation import (
    EncoderNoise,
    NUISANCE_STEP,
    null_readings,
    null_runs,
    stepped,
    with_torque_noise,
)
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.thresholds import LARGEST_NOISE, PRACTICAL_FLOOR, UNSEEN
from gms_flex_control.discrepancy.torque_noise import drawn_noise
from gms_flex_control.discrepancy.whitening import Groups, Whitener, Whitening
from gms_flex_control.effects.base import Change, Scales
from gms_flex_control.effects.registry import find
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.simulation import plant
import numpy as np

_HIGHEST = (LARGEST_NOISE / PRACTICAL_FLOOR) ** 2  # variance of noise over null simulations
_NULL_RUNS = 9         # simulations in which nothing is missing
_MEASURED_BY = 6       # of these: by which residuals are whitened
_LEAST_SCALE, _MOST_SCALE = 0.1, 2.0  # of the torque that was commanded: drives give no more
_LOW = 4.0             # standard deviations of chi square: sums below are no merit of a model
_RATIO_STEP = 0.1      # of a relative change that an effect is
_MOST_ADDED = 3.0      # times what encoders add to the null simulations: as of twice the inertia


class Sums(NamedTuple):
    """Sums of squares by group, cleared of what encoder noise adds, and their cost."""

    groups: np.ndarray  # (G,)
    cost: float         # -2 log likelihood and -2 log prior, but for constants
    cleared: np.ndarray  # (G,) share of what noise adds that has been subtracted, 0 to 1


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model and how likely it is."""

    robot: object     # RobotParams, with effects
    x: np.ndarray     # (P,) nuisance parameters
    residuals: list   # of each recording, (S, 2 n) [N m]
    whitened: np.ndarray  # (R,) residuals, less what every null simulation shows
    sums: Sums        # of these

    @property
    def cost(self) -> float:
        """Return -2 log of likelihood times prior, but for constants."""
        return self.sums.cost


class Residuals:
    """
    What models leave unexplained of recordings (Motions), whitened by null simulations.

    ``robot`` is as believed, known effects included; ``seed`` is of the null simulations;
    ``particular`` are nuisance parameters of the recordings, beside those of the robot.
    """

    def __init__(self, motions, robot, seed=0, particular=()):
        self.motions, self.robot, self.seed = tuple(motions), robot, seed
        self._own = plant.constants_of(replace(robot, effects=()))
        self.nuisances = nuisances_of(robot) + particular
        self.pool = ThreadPoolExecutor(  # models that run away warn of nothing in its threads
            os.cpu_count() or 1, initializer=partial(np.seterr, all='ignore'))
        self._scales = scales_of(self.motions, robot)
        self._simulate(robot, np.zeros(len(self.nuisances)))

    @property
    def groups(self) -> Groups:
        """Return the groups of whitened residuals."""
        return self.whitener.groups

    @property
    def whitenings(self) -> tuple[Whitening, ...]:
        """Return the Whitening of each recording."""
        return self.whitener.whitenings

    @property
    def coulomb(self) -> np.ndarray:
        """Return Coulomb friction (n,), the mean of both directions [N m]."""
        friction = self.robot.friction
        return 0.5 * (friction.forward.coulomb + friction.backward.coulomb)

    @property
    def largest_noise(self) -> np.ndarray:
        """Return the most that is called noise behind the low-pass, by equation (2 n,) [N m]."""
        return LARGEST_NOISE * np.tile(self.coulomb, 2)

    @property
    def unseen(self) -> set[str]:
        """Return the joints whose links have no encoder, set of str."""
        return {motion.samples.joints[link.joint] for motion in self.motions
                for link in motion.samples.unseen}

    @property
    def caution(self) -> float:
        """Return times as many standard errors as usual that held-out data must show."""
        return UNSEEN if self.unseen else 1.0

    def scales_of(self, joint) -> Scales:
        """Return the Scales of a joint, those of the first for the whole arm."""
        joints = self.robot.joints
        return self._scales[joints.index(joint) if joint in joints else 0]

    def level_of(self, joint) -> float:
        """Return Coulomb friction of a joint, the least of all for the whole arm [N m]."""
        joints = self.robot.joints
        return float(self.coulomb[joints.index(joint)] if joint in joints else self.coulomb.min())

    # --- null simulations --------------------------------------------------------------------

    def _simulate(self, robot, x):
        """Make the null simulations of a model, without torque noise, and whiten by them."""
        self.null = self._null_runs(robot, x)
        self._whiten(np.zeros((len(self.motions), 2 * robot.n_joints)))

    def _null_runs(self, robot, x):
        return null_runs(self, robot, x, _NULL_RUNS)

    def null_simulations(self, robot, x) -> Callable:
        """
        Return a function that takes a generator for each recording and returns Motions.

        SimulationError if the model runs away.
        """
        acted, constants = self.acted(self.motions, robot, x)
        readings = [null_readings(motion, constants) for motion in acted]
        return lambda generators: [
            as_recorded(read(rng), motion, other, robot) for read, rng, motion, other in zip(
                readings, generators, self.motions, acted, strict=True)]

    def _whiten(self, noise):
        """Whiten by the null simulations, with torque noise (M, 2 n) in them."""
        self.noise, floor = noise, PRACTICAL_FLOOR * np.tile(self.coulomb, 2)
        runs = [[residual + drawn_noise(self, m, np.random.default_rng([self.seed, 7, k, m]))
                 for m, residual in enumerate(run)] for k, run in enumerate(self.null.clean)]
        self.whitener = Whitener(self.motions, [
            Whitening(np.stack(clean[_NULL_RUNS - _MEASURED_BY:]), motion.period, floor,
                      motion.known)
            for motion, clean in zip(self.motions, zip(*runs, strict=True), strict=True)])
        clean = np.stack([self.whitener.whiten(run) for run in runs])
        # what filters leave at every reversal, say, though nothing is missing: so they do of the
        # recording, whose residuals scatter by that of this mean as well
        self.usual, count = clean.mean(axis=0), len(clean)
        self.clean = (clean - self.usual) * np.sqrt((count + 1) / (count - 1))

    # --- torques -----------------------------------------------------------------------------

    def constants(self, robot, x) -> np.record:
        """Return the kernels' record of a robot with its nuisance parameters at ``x``."""
        mine = x[:len(self.nuisances)]  # recordings held out have none of their own
        return tuned(plant.constants_of(robot), self.nuisances, mine, self._own)

    def acted(self, motions, robot, x) -> tuple:
        """Return motions with the torques that acted, and the kernels' record of their robot."""
        motions, own = acting(motions, robot)
        return motions, self.constants(own, x)

    def recorded(self, motions, x) -> list:
        """Return motions cleared of what nuisance parameters (P,) make particular about each."""
        particular = [(one, float(value)) for one, value in zip(self.nuisances, x, strict=False)
                      if value != 0.0 and isinstance(one, OfRecording)]
        own = [tuple(pair for pair in particular if pair[0].recording == m)
               for m in range(len(motions))]
        return [recorded(motion, values) if values else motion
                for motion, values in zip(motions, own, strict=True)]

    def as_robot(self, x) -> np.ndarray:
        """Return nuisance parameters (P,), 0 where they are those of recordings."""
        return np.array([0.0 if isinstance(one, OfRecording) else value
                         for one, value in zip(self.nuisances, x, strict=False)])

    def residuals(self, motions, robot, x) -> list:
        """Return residual torques per unit of commanded torque, (S, 2 n) of each motion [N m]."""
        scale = np.ones(2 * robot.n_joints)
        for spec in robot.effects:
            factor = find(spec.name).torque_scale(spec.values, self._scales[0].supply)
            if factor != 1.0:
                j = robot.joints.index(spec.joint)
                driven = not robot.arm.rigid[j] and spec.joint not in self.unseen
                scale[j + robot.n_joints * driven] *= np.clip(factor, _LEAST_SCALE, _MOST_SCALE)
        return [left / scale for left in self.unexplained(self.recorded(motions, x), robot, x)]

    def unexplained(self, motions, robot, x) -> list:
        """Return residual torques as `residuals`, of motions as they are, (S, 2 n) each [N m]."""
        acted, constants = self.acted(motions, robot, x)
        return [unexplained(motion, constants) for motion in acted]

    def torque(self, model) -> list:
        """Return the residual torques of a model behind the low-pass, (S', 2 n) each [N m]."""
        return self.whitener.behind_low_pass(self.residuals(self.motions, model.robot, model.x))


class Likelihood(Residuals):
    """
    The likelihood of models along recordings, and its derivatives.

    Nuisance parameters are those of the robot and of the recordings. ``cautious``: derivatives
    count only where they are not mostly encoder noise, as those by the inertia of a joint that
    stands: else the noise of two null simulations may steer a fit. Other parameters are those of
    Residuals.
    """

    def __init__(self, motions, robot, seed=0, cautious=False):
        self._cautious = cautious
        super().__init__(motions, robot, seed, of_recordings(motions, robot))

    @cached_property
    def sd(self) -> np.ndarray:
        """Return standard deviations of the nuisance parameters by their priors (P,)."""
        return np.array([one.sd for one in self.nuisances])

    @property
    def known(self) -> int:
        """Return how many effects of any model are no discovery."""
        return len(self.robot.effects)

    # --- noise -------------------------------------------------------------------------------

    def _null_runs(self, robot, x):
        return stepped(self, super()._null_runs(robot, x))

    def _whiten(self, noise):
        """Whiten by the null simulations, with torque noise (M, 2 n) in them."""
        super()._whiten(noise)
        misread = with_torque_noise(self, self.null)
        self.pair = misread.pair
        self.encoder_noise = EncoderNoise(
            self, self.null.robot, self.null.x,
            [[self.whitener.whiten_spectra(run) for run in pair] for pair in misread.by_step],
            self._cautious)

    def simulated_as(self, model) -> Self:
        """Return the Likelihood whose null simulations are those of a Fitted, without noise."""
        other = copy(self)
        other._simulate(model.robot, model.x)
        return other

    def with_noise(self, noise) -> Self:
        """Return the Likelihood with white torque noise (M, 2 n) in its null simulations."""
        other = copy(self)
        other._whiten(noise)
        return other

    def learn_noise(self, guesses) -> set[tuple[str, str]]:
        """
        Learn how encoder noise shows in effects whose only guess is linear, and return them.

        ``guesses`` are (effect, joint, Guess); those returned (effect, joint).
        """
        ways = Counter(guess[:2] for guess in guesses)
        linear = [(name, joint, guess.probes[0]) for name, joint, guess in guesses
                  if guess.is_linear and ways[name, joint] == 1]

        def learn(one):
            name, joint, values = one
            kind, sets = find(name), [(0, values)]
            if issubclass(kind, Change):  # its further ratios, one by one
                sets += [(k, tuple(_RATIO_STEP * (np.arange(len(values)) == k)))
                         for k in range(1, len(values)) if kind.parameters[k].unit == '1']
            self.encoder_noise.learn(self, EffectSpec(name=name, joint=joint, values=values), sets)
        list(self.pool.map(learn, linear))
        return {one[:2] for one in linear}

    # --- likelihood --------------------------------------------------------------------------

    def sums(self, whitened, robot, x, exact=False) -> Sums:
        """
        Return the Sums of a model.

        ``exact``: what noise adds is simulated, not extrapolated from where it last was.
        """
        of_noise, groups = self.encoder_noise, self.groups
        noise = of_noise.anchored(robot, x, lambda: np.subtract(
            *self.of_pair(robot, x))) if exact else of_noise.along(robot, x)
        own = 0.5 * of_noise.own_sums
        added, most = 0.5 * groups.sums(noise ** 2) - own, _MOST_ADDED * own
        whole = groups.sums(whitened ** 2)
        # a recording that is quieter than null simulations has less noise to be cleared of
        share = np.minimum(whole / np.maximum(own + added, 1e-300), 1.0)
        chance = groups.count - _LOW * np.sqrt(2.0 * groups.count)
        least = np.minimum(whole, np.maximum(chance, 0.0))  # below, clearing is no merit
        cleared = np.maximum(whole - share * np.minimum(added, most), least)
        return Sums(cleared, self.misfit(cleared) + float(np.sum((x / self.sd) ** 2)),
                    share * ((cleared > least) & (added < most)))

    def misfit(self, sums) -> np.ndarray:
        """Return -2 log likelihood of sums (..., G) at the likeliest noise levels."""
        level = self.noise_levels(sums)
        return np.sum(self.groups.count * np.log(level) + np.asarray(sums) / level, axis=-1)

    def noise_levels(self, sums) -> np.ndarray:
        """Return the likeliest variances of the groups: null simulations' to drives' at worst."""
        return np.clip(np.asarray(sums) / self.groups.count, 1.0, _HIGHEST)

    def weights(self, sums) -> np.ndarray:
        """Return the weights of residuals (R,) at the likeliest noise levels of sums (G,)."""
        return (1.0 / self.noise_levels(sums))[self.groups.group]

    def noise_slopes(self, model, weight, numbers=()) -> np.ndarray:
        """Return what encoder noise adds to informative downhill slopes, (C,) or (C, K)."""
        return (self.encoder_noise.jacobian(model.robot, numbers)
                * self.encoder_noise.informative(model.robot, numbers)
                ) @ self.noise_cleared(model, weight).T

    def noise_cleared(self, model, weight) -> np.ndarray:
        """Return the noise that sums are cleared of, so weighted (R,) or (K, R)."""
        return 0.5 * weight * model.sums.cleared[self.groups.group] * self.encoder_noise.along(
            model.robot, model.x)

    def noise_added(self, model) -> np.ndarray:
        """Return what encoder noise adds to squares of residuals (R,) beyond null simulations."""
        noise = self.encoder_noise
        return 0.5 * model.sums.cleared[self.groups.group] * (
            noise.along(model.robot, model.x) ** 2 - noise.own ** 2)

    def change(self, begun, robot, x) -> np.ndarray:
        """Return the whitened residuals of a model (R,) less those of a Fitted."""
        return self.whitener.whiten([one - other for one, other in zip(
            self.residuals(self.motions, robot, x), begun.residuals, strict=True)])

    def of_pair(self, robot, x) -> list:
        """Return whitened residuals (R,) of a model along two null simulations of one motion."""
        return [self.whitener.whiten(self.residuals(run, robot, x)) for run in self.pair]

    def fitted(self, robot, x) -> Fitted:
        """Return a model as it is, a Fitted."""
        residuals = self.residuals(self.motions, robot, x)
        whitened = self.whitener.whiten(residuals) - self.usual
        return Fitted(robot, x, residuals, whitened, self.sums(whitened, robot, x))

    def exact(self, model) -> Fitted:
        """Return a Fitted with what encoder noise adds simulated: others are compared with it."""
        return replace(model, sums=self.sums(model.whitened, model.robot, model.x, exact=True))

    def resting(self, robot) -> np.ndarray:
        """Return which nuisance parameters (P,) an effect of a model replaces, bool."""
        replaced = {(find(spec.name).replaces, robot.joints.index(spec.joint))
                    for spec in robot.effects[self.known:] if find(spec.name).replaces}
        return np.array([(one.name, one.joint) in replaced for one in self.nuisances], dtype=bool)

    def each(self, function, jobs) -> np.ndarray:
        """Return what a function gives of each job, in threads, stacked."""
        return np.array(list(self.pool.map(function, jobs)))

    def jacobian(self, model) -> np.ndarray:
        """Return derivatives (P, R) of the residuals of a Fitted by nuisance parameters."""
        def column(i):
            at = model.x.copy()
            at[i] += NUISANCE_STEP
            return self.change(model, model.robot, at) / NUISANCE_STEP
        return self.each(column, range(len(model.x))).reshape(len(model.x), len(model.whitened))
