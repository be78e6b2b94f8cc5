# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
By how much each effect of the catalogue would lower the cost of a model.

All guesses are put along the measured motion once, at small sizes. The decrease of the cost is
then linear algebra.
"""

from typing import NamedTuple

from gms_flex_control.data.signal_analysis import standing_out
from gms_flex_control.discrepancy.evidence import NormalEquations
from gms_flex_control.discrepancy.fitting import informative, numbers_of, prior_of
from gms_flex_control.effects.base import Guess, HIGHEST_ORDER, Stage, Term
from gms_flex_control.effects.registry import find, names
from gms_flex_control.params.robot import EffectSpec, WHOLE_ARM, with_effects
import numpy as np

_AT_BOUND = 0.99      # of what is plausible of a nuisance parameter: it can give no more
_NEW = 1e-6           # of the squares of a guess's derivatives: nothing else makes so much of them
_EXACT = 8            # effects of joints whose decrease is found within bounds, either way
_MOST_TRIED = 40      # guesses, to find so many: some have a ladder of sizes
_AT_ONCE = 64         # derivatives, kept in single precision, that are taken in double at once


class Ranked(NamedTuple):
    """A hypothesis and what it takes off the cost."""

    decrease: float      # decrease of the cost, all else re-tuned
    spec: EffectSpec

    @property
    def key(self) -> tuple[str, str]:
        """Return (effect, joint)."""
        return self.spec.name, self.spec.joint


def _fine_orders(likelihood, model):
    """Return the orders of waves over the motor angle finer than any guess, tuple per joint."""
    left = likelihood.unexplained(likelihood.motions, model.robot, model.x)
    n, found = model.robot.n_joints, []
    for j in range(n):
        at = j if model.robot.arm.rigid[j] else n + j
        found.append(tuple(standing_out(
            [one.states[:, 3, j] for one in likelihood.motions], [rows[:, at] for rows in left],
            [one.states[:, 4, j] for one in likelihood.motions], HIGHEST_ORDER)))
    return found


def guesses_of(likelihood, excluded=(), fine=None, only=None) -> list:
    """Return what is looked for, list of (effect, joint or the whole arm, Guess)."""
    robot, found = likelihood.robot, []
    commanded = all(motion.samples.commanded for motion in likelihood.motions)
    for name in sorted(set(names()).difference(excluded)):
        kind = find(name)
        if (kind.needs_commands and not commanded
                or kind.needs_chain and robot.arm.kind == 'decoupled'):
            continue
        for at, joint in enumerate([WHOLE_ARM] if kind.whole_arm else robot.joints):
            unseen = likelihood.unseen if kind.whole_arm else joint in likelihood.unseen
            if only is not None and (name, joint) not in only or (
                    unseen and kind.needs_link_encoder):
                continue
            scales = likelihood.scales_of(joint)._replace(fine_orders=fine[at] if fine else ())
            lower, upper = kind.search_bounds(at, robot)
            if kind.torque_delay and robot.n_joints == 1 and commanded:
                upper = [0.0]  # of a single joint a drive that is late does the same
            found += [(name, joint, allowed(guess, lower, upper))
                      for guess in kind.guesses(scales)]
    return found


def allowed(guess, lower, upper) -> Guess:
    """Return a Guess whose values keep within the bounds of an effect's parameters."""
    size = guess.probes[0][0]
    if guess.is_linear and size > 0.0:  # its coefficient has bounds, too
        guess = guess._replace(lowest=max(guess.lowest, lower[0] / size),
                               highest=min(guess.highest, upper[0] / size))

    def within(c):
        wanted = guess.values(c)[0]
        return min(upper[0] / wanted, 1.0) if wanted > 0.0 else 1.0
    return guess._replace(values=lambda c: tuple(np.clip(guess.values(c), lower, upper).tolist()),
                          within=within)


def may_join(spec, robot, known) -> bool:
    """
    Return whether an effect may be added to a robot: not twice, and none that undoes another.

    The torque constant together with the stiffness would scale a whole joint, which no motion
    distinguishes from other torque: the trivial solution would minimise the cost. The first
    effects, ``known`` many, have a size that nothing moves, so they undo none.
    """
    if any(one.key == spec.key for one in robot.effects):
        return False
    rigid = spec.joint in robot.joints and robot.arm.rigid[robot.joints.index(spec.joint)]
    there = {one.name for one in robot.effects[known:] if one.joint == spec.joint}
    return not there & set(find(spec.name).excludes(bool(rigid)))


class Dictionary:
    """
    The whitened residuals of all guesses along the recordings of a Likelihood.

    Columns are taken at ``model``, a Fitted; ``excluded`` and ``only`` as of `guesses_of`.
    """

    def __init__(self, likelihood, model, excluded=(), only=None):
        self._likelihood = likelihood
        self.guesses = guesses_of(likelihood, excluded, _fine_orders(likelihood, model), only)
        self._specs = [EffectSpec(name=name, joint=joint, values=values)
                       for name, joint, guess in self.guesses for values in guess.probes]
        self.derivatives = np.empty((len(self._specs), len(model.whitened)), dtype=np.float32)

        def fill(k):
            self.derivatives[k] = likelihood.change(model, with_effects(
                model.robot, self._specs[k]), model.x)
        list(likelihood.pool.map(fill, range(len(self._specs))))
        self._clear_noise(likelihood.learn_noise(self.guesses))
        self._places = np.cumsum([0, *(len(guess.probes) for _, _, guess in self.guesses)])
        self._own = list(likelihood.pool.map(self._products_of, range(len(self.guesses))))

    def _products_of(self, i):
        """Return the products by group (G, K, K) of the K derivatives of a guess."""
        groups = self._likelihood.groups
        part = groups.ordered(self.derivatives[self._places[i]:self._places[i + 1]].astype(float))
        return groups.products(part, part)

    def _clear_noise(self, learned):
        """Clear derivatives that encoder noise, known of ``learned``, hides."""
        noise = self._likelihood.encoder_noise
        for column, spec in zip(self.derivatives, self._specs, strict=True):
            column *= noise.informative_of(spec)[np.argmax(np.asarray(spec.values) != 0.0)]
        self._unknown = ~np.array([spec.key in learned or _is_of_torque(spec.name)
                                   for spec in self._specs], dtype=bool)

    def _noise_along(self, direction):
        """Return the products (K,) of the noise in all derivatives with a direction (R,)."""
        noise, of_effect = self._likelihood.encoder_noise, {}
        for spec in self._specs:
            if spec.key not in of_effect:
                of_effect[spec.key] = np.sum(
                    noise.of_effect(spec) * noise.informative_of(spec) * direction, axis=1)
        return np.array([np.asarray(spec.values) @ of_effect[spec.key] for spec in self._specs])

    def _products(self, others):
        """Return the products (K, N) of derivatives with others (N, R), in double precision."""
        parts = (self.derivatives[k:k + _AT_ONCE]
                 for k in range(0, len(self.derivatives), _AT_ONCE))
        return np.concatenate([np.empty((0, len(others))), *self._likelihood.pool.map(
            lambda part: part @ others.T, parts)])

    def decreases(self, model, jacobian, plausible=np.inf, even=False) -> tuple:
        """
        Return what guesses take off the cost, bounds left aside (G,), and noise (K,).

        Noise levels are those of the model, or ``even``: an effect that explains all of a group
        whose level is high for want of it takes off little by the former.
        """
        likelihood = self._likelihood
        numbers = numbers_of(likelihood, model.robot)
        prior = prior_of(likelihood, model, numbers)
        free = prior.free
        free[:len(model.x)] &= np.abs(model.x) < _AT_BOUND * plausible * likelihood.sd
        sums = likelihood.groups.count if even else model.sums.groups
        weight, levels = likelihood.weights(sums), 1.0 / likelihood.noise_levels(sums)
        root, pull = np.sqrt(weight), np.sqrt(prior.pull)
        jacobian = informative(likelihood, model, jacobian)
        # priors are residuals of their own
        own = np.concatenate([jacobian * root, np.diag(pull)], axis=1)[free]
        rows = np.concatenate([model.whitened * root, pull * prior.values])
        basis, triangle = np.linalg.qr(own.T)
        left = (rows - basis @ (basis.T @ rows))[:len(root)]
        along = self._products(root * np.vstack([basis[:len(root)].T, left]))
        along, right = along[:, :-1], along[:, -1]
        own_noise = likelihood.noise_slopes(model, weight, numbers)
        shared = along @ np.linalg.lstsq(triangle.T, own_noise[free], rcond=1e-10)[0]
        # where it was not learned, noise adds what it adds to all that makes the column: a
        # friction that varies with place is friction
        noise = np.where(self._unknown, shared, self._noise_along(
            likelihood.noise_cleared(model, weight)))
        right = noise - shared - right
        decreases = np.zeros(len(self.guesses))
        for i, (first, last) in enumerate(zip(self._places[:-1], self._places[1:], strict=True)):
            mine, whole = along[first:last], np.tensordot(levels, self._own[i], 1)
            gram = whole - mine @ mine.T
            if np.trace(gram) > _NEW * np.trace(whole):
                decreases[i] = right[first:last] @ np.linalg.lstsq(
                    gram, right[first:last], rcond=1e-10)[0]
        return np.where(np.isfinite(decreases), decreases, 0.0), noise

    def ranked(self, model, jacobian, plausible=np.inf) -> list:
        """Return the hypotheses with the largest decreases, no effect of a joint twice."""
        likelihood, best, tried = self._likelihood, {}, set()
        normal = NormalEquations(likelihood, model, jacobian, plausible)
        for even in (False, True):
            decreases, noise = self.decreases(model, jacobian, plausible, even)
            found = set()
            for i in np.argsort(-decreases)[:_MOST_TRIED]:
                name, joint, guess = self.guesses[i]
                if len(found) == _EXACT or decreases[i] <= 0.0:
                    break
                part = slice(self._places[i], self._places[i + 1])
                if i in tried or not may_join(self._specs[part.start], model.robot,
                                              likelihood.known):
                    continue
                found.add((name, joint))
                tried.add(i)
                minimum = normal.beside(self.derivatives[part].astype(float), noise[part],
                                        guess.lowest, guess.highest)
                share = guess.within(minimum.added)
                decrease = (normal.alone.cost - minimum.cost if np.any(minimum.added) else 0.0) * (
                    share * (2.0 - share))
                if decrease > best.get((name, joint), Ranked(0.0, None)).decrease:
                    values = tuple(float(v) for v in guess.values(minimum.added))
                    best[name, joint] = Ranked(
                        decrease, EffectSpec(name=name, joint=joint, values=values))
        return sorted(best.values(), key=lambda one: -one.decrease)

    def largest(self, model, jacobian) -> dict:
        """Return what each hypothesis takes off, bounds left aside, by (effect, joint)."""
        found = {}
        for (name, joint, _), decrease in zip(
                self.guesses, self.decreases(model, jacobian)[0], strict=True):
            found[name, joint] = max(found.get((name, joint), 0.0), float(decrease))
        return found


def _is_of_torque(name):
    """Return whether an effect changes the torque that was asked for, which has no noise."""
    kind = find(name)
    return issubclass(kind, Term) and kind.stage == Stage.ACTUATOR
