# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Null simulations: what a recording would look like if nothing were missing.

The model is simulated under the recorded torque plus what keeps its motors on the recorded motion,
and a gentle push that keeps links that are seen there: a link that stood stands, one that crept
creeps. Torque, push and motion then fit the model exactly, whatever it lacks. Read through the
same encoders and put through the same filters, such a run shows noise, rounding, and the filters'
own errors at every reversal.

Noise of the readings enters times inertia and stiffness (errors in variables), which would favour
light arms. Two null simulations of one motion, not one noise, differ by nothing else: sums, slopes
and curvature are cleared of their difference, linear in all parameters.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.compiled import compiled
from gms_flex_control.data.signal_analysis import quantum
from gms_flex_control.discrepancy.motion import make_motion
from gms_flex_control.discrepancy.nuisance import OF_SHAPE
from gms_flex_control.discrepancy.residuals import fresh_state
from gms_flex_control.discrepancy.samples import encoder_step
from gms_flex_control.discrepancy.whitening import Band, Grams
from gms_flex_control.dynamics import chain
from gms_flex_control.effects import base as sig
from gms_flex_control.effects.registry import bounds_of
from gms_flex_control.errors import SimulationError
from gms_flex_control.simulation import plant
import numpy as np

BANDWIDTH = 30.0      # of the motors' hold on the motion [rad/s]
_ALONE = 60.0         # likewise, where nothing but the motor holds the link
_OF_LINKS = 15.0      # likewise, of the push [rad/s]
_DAMPED = 1.4         # twice the damping ratio of both
_OF_RATE = 0.3        # of the sample rate: so much it is at most [rad]
STEP = 4e-4           # of the integration [s]
NUISANCE_STEP = 0.01  # relative change of a nuisance parameter, for its derivative
_WILD = 4.0           # times the squared torque that the recording lacks: driven wild
_MOSTLY = 0.3         # of the squares of a derivative: noise shows more than the model does


@compiled
def simulate_along(states, command, supply, time, period, substeps, gains, constants, state, work,
                   held, pushed, link, motor) -> None:
    """
    Fill torques and angles (T, n) of a run along ``motion`` (T, 6, n).

    ``held`` are those of the actuators, ``pushed`` those that links are held with; of ``gains``
    (4, n) the first two hold motors, the others links: per angle and per rate. Those of rigid
    joints are accelerations, of which the inertia of all links at that pose makes torques: a light
    link would swing otherwise, since others give way.
    """
    samples, n = command.shape
    flexible = constants.chain.flexible
    wanted, bias, needed = np.empty(n), np.empty(n), np.empty(n)
    any_rigid = False
    for j in range(n):
        any_rigid = any_rigid or not flexible[j]
    ahead = 0.5 * period / substeps  # semi-implicit angles run half a step ahead of their rates
    for k in range(samples):
        for j in range(n):
            work.signals[j, sig.SUPPLY] = supply[k]
        plant.sensed(state, state.applied, time[k], period, constants, work)
        for j in range(n):
            link[k, j] = work.signals[j, sig.SENSED_LINK] - ahead * state.dq_link[j]
            motor[k, j] = work.signals[j, sig.SENSED_MOTOR] - ahead * state.dq_motor[j]
            rows = 3 if flexible[j] else 0
            wanted[j] = (gains[0, j] * (states[k, rows, j] - state.q_motor[j])
                         + gains[1, j] * (states[k, rows + 1, j] - state.dq_motor[j]))
            held[k, j] = command[k, j]
            if flexible[j]:
                held[k, j] += wanted[j]
                wanted[j] = 0.0
            pushed[k, j] = (gains[2, j] * (states[k, 0, j] - state.q_link[j])
                            + gains[3, j] * (states[k, 1, j] - state.dq_link[j]))
            work.outside[j] = pushed[k, j]
        if any_rigid:
            chain.rigid_body(state.q_link, state.dq_link, wanted, constants.chain, work.chain,
                             bias, needed)
            for j in range(n):
                if not flexible[j]:
                    held[k, j] += needed[j]
        plant.advance(state, held[k], time[k], period, substeps, constants, work)


def null_readings(motion, constants) -> Callable:
    """
    Return a function that takes a generator and returns a null simulation, a Motion.

    That is what a model makes of a recording, read through like encoders.
    All of them read the same run. SimulationError if the model runs away.
    """
    constants, samples = motion.carrying(constants), motion.samples
    links, n = constants.chain, len(samples.joints)
    inertia = np.where(links.flexible, links.motor_inertia, 1.0)
    own, bandwidth = chain.own_inertia(links)[0] * links.flexible, np.full(n, BANDWIDTH)
    for link in samples.unseen:
        own[link.joint] = 0.0
        bandwidth[link.joint] = np.clip(_OF_RATE / samples.period, BANDWIDTH, _ALONE)
    gains = np.stack([inertia * bandwidth ** 2, _DAMPED * inertia * bandwidth,
                      own * _OF_LINKS ** 2, _DAMPED * own * _OF_LINKS])
    state, first = fresh_state(constants), samples.states[0]
    state.q_link[:], state.dq_link[:], state.q_motor[:], state.dq_motor[:] = first[[0, 1, 3, 4]]
    held, pushed, link, motor = np.empty((4, *samples.command.shape))
    simulate_along(samples.states, samples.command, samples.supply, samples.time, samples.period,
                   max(1, round(samples.period / STEP)), gains, constants, state,
                   plant.workspace(n), held, pushed, link, motor)
    readings = np.stack([link, motor], axis=1)
    if not np.all(np.isfinite(readings)):
        raise SimulationError(f'{samples.source}: the model runs away along the recorded motion; '
                              'its inertia, stiffness and friction are not those of this robot')

    def read(rng):
        angles = np.empty_like(readings)
        for side in range(2):
            for j in range(n):
                angles[:, side, j] = _read(readings[:, side, j], samples.readings[:, side, j],
                                           samples.noise[side, j], rng)
        return make_motion(samples.simulated(angles, held, pushed))
    return read


def is_followed(likelihood, model) -> bool:
    """
    Return whether a null simulation of a Fitted keeps to the recorded motion.

    One that lacks more torque than the recording does, beyond what drives make, goes its own
    way: it shows what a model does that is driven wild, not what noise does.
    """
    whitener = likelihood.whitener
    try:
        runs = likelihood.null_simulations(model.robot, model.x)(
            np.random.default_rng(likelihood.seed) for _ in likelihood.motions)
    except SimulationError:
        return False
    own = whitener.behind_low_pass(likelihood.unexplained(runs, model.robot, model.x))
    most = np.maximum(whitener.in_motion([one ** 2 for one in likelihood.torque(model)]),
                      likelihood.largest_noise ** 2)
    return bool(np.all(whitener.in_motion([one ** 2 for one in own])
                       <= _WILD * most))  # not where it is not finite


def _read(angle, like, noise, rng):
    """Return an angle (T,) as an encoder gives it that gave ``like`` (T,)."""
    step = encoder_step(like, noise)
    own = np.sqrt(max(noise ** 2 - quantum(like) ** 2 / 12.0, 0.0))
    shift = step * rng.uniform()
    noisy = angle + own * rng.standard_normal(len(angle))
    return np.round((noisy + shift) / step) * step - shift if step > 0.0 else noisy


class NullRuns(NamedTuple):
    """Null simulations of a model."""

    robot: object       # RobotParams
    x: np.ndarray       # (P,) nuisance parameters
    clean: tuple        # of runs, each a list of residual torques (S, 2 n) of a recording [N m]
    pair: tuple         # of two runs, each a list of Motion
    bands: list         # of Band, one for each recording
    by_step: list = ()  # spectra of the pair, see `stepped`


def null_runs(likelihood, robot, x, count) -> NullRuns:
    """Return ``count`` null simulations of a model."""
    simulated = likelihood.null_simulations(robot, x)

    def run(k):
        made = simulated(np.random.default_rng([likelihood.seed, k]) for _ in likelihood.motions)
        return made if k < 2 else None, likelihood.unexplained(made, robot, x)
    runs, clean = zip(*likelihood.pool.map(run, range(count)), strict=True)
    bands = [Band(len(one.time), one.period, one.known) for one in likelihood.motions]
    return NullRuns(robot, x, clean, runs[:2], bands)


def stepped(likelihood, null) -> NullRuns:
    """Return NullRuns with its pair's spectra, each nuisance `NUISANCE_STEP` off, then none."""
    def spectra(step):
        return [[band.spectra(residual) for band, residual in zip(
            null.bands, likelihood.residuals(run, null.robot, null.x + step), strict=True)]
            for run in null.pair]
    count = len(null.x)
    return null._replace(by_step=list(likelihood.pool.map(
        spectra, (*(NUISANCE_STEP * np.eye(count)), np.zeros(count)))))


def with_torque_noise(likelihood, null) -> NullRuns:
    """
    Return NullRuns whose pair has torque noise where links are computed from torques.

    It enters their angles, and so, like noise of encoders, times inertia and stiffness.
    """
    computed = [likelihood.robot.joints.index(joint) for joint in likelihood.unseen]
    size = np.zeros((len(likelihood.motions), likelihood.robot.n_joints))
    size[:, computed] = likelihood.noise[:, computed]
    if not size.any():
        return null

    def noisy(k, m):
        rng = np.random.default_rng([likelihood.seed, 10, k, m])
        motion = null.pair[k][m]
        drawn = size[m] * rng.standard_normal(motion.samples.command.shape)
        return motion.with_torque(object(), lambda command: command + drawn)
    return stepped(likelihood, null._replace(pair=[
        [noisy(k, m) for m in range(len(likelihood.motions))] for k in range(len(null.pair))]))


# --- what encoder noise adds --------------------------------------------------------------------


class EncoderNoise:
    """
    How encoder noise shows in R whitened residuals and in their derivatives.

    ``robot`` and ``x`` (P,) are of the null simulations, ``by_step`` pairs of (R,): both with each
    nuisance parameter `NUISANCE_STEP` off, the last as simulated. ``cautious``: no derivative is
    known where it is mostly noise.
    """

    def __init__(self, likelihood, robot, x, by_step, cautious=False):
        self._groups, self._known = likelihood.groups, likelihood.known
        self._robot, self._x = robot, x
        self._begun = by_step[-1]
        self.own = self._begun[0] - self._begun[1]
        self.own_sums = self._groups.sums(self.own ** 2)
        self._by_nuisance = np.empty((len(x), len(self.own)))
        self._informative = np.empty((len(x), len(self.own_sums)), dtype=bool)
        for i, pair in enumerate(by_step[:-1]):
            self._by_nuisance[i], self._informative[i] = self._shown(pair, NUISANCE_STEP)
        self._shapes = np.array([cautious or one.name in OF_SHAPE for one in likelihood.nuisances],
                                dtype=bool)
        self.grams = Grams(self._groups, self.known(self._by_nuisance))
        self._by_effect = {}  # (effect, joint): as `_shown`, a row for each parameter
        self._grams = None    # a Jacobian and its Grams, the last that were asked for
        self._anchors = {}    # effects that were added, all (effect, joint): effects, x and noise

    def _shown(self, pair, step):
        """Return how noise shows in the derivative by a ``step``, (R,), and in which groups."""
        noise = pair[0] - pair[1] - self.own
        hidden = (self._groups.sums(noise ** 2)
                  > 2.0 * _MOSTLY * self._groups.sums((pair[0] - self._begun[0]) ** 2))
        return noise / step, ~hidden

    def learn(self, likelihood, spec, linear) -> None:
        """Learn how noise shows in the derivatives by an effect (EffectSpec) at a small size."""
        shown = np.zeros((len(spec.values), len(self.own)))
        informative = np.ones((len(spec.values), len(self.own_sums)), dtype=bool)
        there = [one.key for one in self._robot.effects[self._known:]]
        for k, values in linear:
            effects = list(self._robot.effects)
            if spec.key in there:  # a second one would act on what the first made
                i = self._known + there.index(spec.key)
                own, (lower, upper) = effects[i].values, bounds_of(spec, self._robot)
                step = values[k] if lower[k] < own[k] + values[k] < upper[k] else -values[k]
                effects[i] = replace(spec, values=(*own[:k], own[k] + step, *own[k + 1:]))
            else:
                effects.append(replace(spec, values=values))
                step = values[k]
            shown[k], informative[k] = self._shown(likelihood.of_pair(
                replace(self._robot, effects=tuple(effects)), self._x), step)
        self._by_effect[spec.key] = shown, informative

    def of_effect(self, spec) -> np.ndarray:
        """Return how noise shows in the derivatives by parameters of an effect, or 0 (K, R)."""
        return self._by_effect.get(spec.key, (np.zeros((len(spec.values), 1)),))[0]

    def informative_of(self, spec) -> np.ndarray:
        """Return where residuals show parameters of an effect, not mostly noise, bool (K, R)."""
        found = self._by_effect.get(spec.key)
        return (np.ones((len(spec.values), 1), dtype=bool) if found is None
                else found[1][:, self._groups.group])

    def informative(self, robot, numbers) -> np.ndarray:
        """Return `informative_of` of nuisance parameters and numbers (C, R)."""
        return self._with_numbers(self._informative[:, self._groups.group], self.informative_of,
                                  robot, numbers)

    def known(self, jacobian) -> np.ndarray:
        """Return a Jacobian (C, R), 0 where a nuisance is of shape and residuals mostly noise."""
        known = jacobian.copy()
        for i in np.flatnonzero(self._shapes):
            known[i] *= self._informative[i][self._groups.group]
        return known

    def grams_of(self, jacobian) -> Grams:
        """Return the Grams of what is `known` of a Jacobian (C, R); the last are kept."""
        if self._grams is None or self._grams[0] is not jacobian:
            self._grams = jacobian, Grams(self._groups, self.known(jacobian))
        return self._grams[1]

    def jacobian(self, robot, numbers) -> np.ndarray:
        """Return how noise shows in derivatives by nuisances and numbers (C, R)."""
        return np.concatenate([self.grams.fixed, self.of_numbers(robot, numbers)])

    def of_numbers(self, robot, numbers) -> np.ndarray:
        """Return how noise shows in derivatives by numbers of effects (V, R)."""
        return self._with_numbers(self.grams.fixed[:0], self.of_effect, robot, numbers)

    def _with_numbers(self, nuisances, of_effect, robot, numbers):
        out = np.empty((len(nuisances) + len(numbers), len(self.own)), dtype=nuisances.dtype)
        out[:len(nuisances)] = nuisances
        for row, one in zip(out[len(nuisances):], numbers, strict=True):
            row[:] = of_effect(robot.effects[one.effect])[one.parameter]
        return out

    def along(self, robot, x) -> np.ndarray:
        """Return by how much residuals of both null simulations would differ for a model (R,)."""
        begun = self._robot.effects[self._known:], self._x, self.own
        effects, begin, noise = self._anchors.get(self._added(robot), begun)
        out = noise + (x - begin) @ self._by_nuisance
        for sign, specs in ((1.0, robot.effects[self._known:]), (-1.0, effects)):
            for spec in specs:
                if spec.key in self._by_effect:
                    out += sign * (np.asarray(spec.values) @ self.of_effect(spec))
        return out

    def anchored(self, robot, x, simulated) -> np.ndarray:
        """Return the difference (R,) ``simulated``, kept for models of the same effects."""
        effects, key = robot.effects[self._known:], self._added(robot)
        kept = self._anchors.get(key)
        if kept is None or kept[0] != effects or not np.array_equal(kept[1], x):
            kept = effects, x.copy(), simulated()
            if self.is_foreseen(robot):
                self._anchors[key] = kept
        return kept[2]

    def forget(self) -> None:
        """Foresee noise from the null simulation again, whatever was simulated since."""
        self._anchors.clear()

    def is_foreseen(self, robot) -> bool:
        """Return whether it is known how noise shows in all effects that were added."""
        return self._by_effect.keys() >= set(self._added(robot))

    def _added(self, robot):
        return tuple(spec.key for spec in robot.effects[self._known:])
