# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The search for what is missing: a beam over sets of effects, ordered by evidence.

The dictionary shows which effects would lower the cost most; only those are fitted in full.
Neighbours of a set have one effect more, another in the place of one, or one in the place of two.
"""

from itertools import combinations
from typing import NamedTuple

from gms_flex_control.discrepancy import fitting
from gms_flex_control.discrepancy.dictionary import Dictionary, guesses_of
from gms_flex_control.discrepancy.evidence import is_of_other_size, State, state_of
from gms_flex_control.discrepancy.thresholds import EVIDENCE, PLAUSIBLE
from gms_flex_control.params.robot import with_effects
import numpy as np

_BEAM = 2             # sets that are followed, while there are few effects
_FEW = 3              # effects: with more, one set is followed
_SHORTLIST = 3        # hypotheses that are better when they are fitted in full
_CLOSE = 0.25         # of the largest decrease: with less, no hypothesis is fitted
_NEARLY = 0.9         # of what an effect explains: a rival explains so much at a first guess
_FAR = 3.0            # standard deviations that a nuisance parameter moves: its effect is another
_ANEW = 2             # times that derivatives are then taken anew
_WAITS = 0.1          # of the evidence gained since noise was simulated: less may be its error
_ROUNDS = 4           # of adding, exchanging and taking derivatives anew


class Found(NamedTuple):
    """What the search ended with."""

    before: State      # nuisance parameters re-tuned as far as plausible, nothing added
    best: State        # with the effects found
    tried: tuple       # of State: all that were fitted
    first: tuple       # of Ranked: the best of the first scan, within bounds
    scan: dict         # (effect, joint) to decrease of the cost: all of it, bounds left aside
    dictionary: Dictionary
    nuisances: np.ndarray  # (P, R) derivatives by the nuisance parameters, of the last model
    hypotheses: int    # effects of joints that were looked for
    is_done: bool      # whether no effects wait for noise that is simulated with those found


def search(likelihood, most, excluded, begin, wait, say) -> Found:
    """
    Return the likeliest set of at most so many effects, but those ``excluded`` (names).

    What null simulations of a robot lack that is found in it, their noise lacks as well: it may be
    wrong by as much as a smaller effect gains. So effects that gain much less than those found may
    ``wait`` for null simulations with these, of which the Found of the search before is where the
    next one begins (else None). ``say`` is called with what is being done.
    """
    hunt = _Search(likelihood, excluded, begin, say)
    if begin is not None:
        hunt.take_up(begin)
    begun, improved = hunt.best, None
    for _ in range(_ROUNDS):
        before = hunt.best
        hunt.grow(most, begun if wait else None)
        is_done = not wait or len(hunt.best.model.robot.effects) == len(before.model.robot.effects)
        if not is_done:
            hunt.settle()
            break
        if hunt.best.key(likelihood.known) != improved:
            hunt.improve()
            improved = hunt.best.key(likelihood.known)
        hunt.settle()
        if hunt.best.evidence < before.evidence + EVIDENCE:
            break
    return Found(hunt.before, hunt.best, tuple(hunt.tried.values()), hunt.first, hunt.scan,
                 hunt.dictionary, hunt.nuisances, hunt.hypotheses, is_done)


def count_of(likelihood, excluded) -> int:
    """Return how many effects of joints are looked for."""
    return len({guess[:2] for guess in guesses_of(likelihood, excluded)})


class _Search:
    """The best set so far, and all that were tried."""

    def __init__(self, likelihood, excluded, begin, say):
        self._likelihood, self._say, self._known = likelihood, say, likelihood.known
        x = begin.before.model.x if begin else np.zeros(len(likelihood.nuisances))
        # where nuisance parameters stand for something else, nothing would be left to explain
        plausible, self.nuisances = fitting.retuned(likelihood, likelihood.robot, x, PLAUSIBLE)
        self.hypotheses = begin.hypotheses if begin else count_of(likelihood, excluded)
        say('every effect along the motion')
        self.dictionary, self.tried = Dictionary(likelihood, plausible, excluded), {}
        self.before = State(plausible, self.nuisances, self.nuisances[:0], -np.inf, PLAUSIBLE)
        self.best = self._tried(*fitting.retuned(
            likelihood, likelihood.robot, np.where(np.abs(x) > np.abs(plausible.x), x,
                                                   plausible.x), jacobian=self.nuisances))
        self.first = begin.first if begin else tuple(
            self.dictionary.ranked(plausible, self.nuisances, PLAUSIBLE))
        self.scan = begin.scan if begin else self.dictionary.largest(plausible, self.nuisances)

    def _tried(self, model, jacobian):
        """Return a model as a State, the best of those tried with the same effects."""
        state = state_of(self._likelihood, model, jacobian, self.hypotheses)
        shared = np.array_equal(state.nuisances, self.nuisances)
        state = state._replace(nuisances=self.nuisances if shared else state.nuisances.copy(),
                               own=state.own.copy())
        if self._is_at_limit(model) or is_of_other_size(
                self._likelihood, model, jacobian, self.hypotheses):
            state = state._replace(evidence=-np.inf)  # where the search ends is no value
        key = state.key(self._known)
        if key not in self.tried or state.evidence > self.tried[key].evidence:
            self.tried[key] = state
        return self.tried[key]

    def _is_at_limit(self, model):
        return any(fitting.is_at_limit(spec, model.robot)
                   for spec in model.robot.effects[self._known:])

    def _take(self, model):
        """Go on with a model, its effects fitted together."""
        self.best = self._tried(*fitting.refitted(
            self._likelihood, model.robot, model.x, self.nuisances))

    def take_up(self, begin) -> None:
        """Go on with the likeliest of the sets that another search found likeliest."""
        self._take(begin.best.model)
        rest = sorted((state for state in begin.tried
                       if state.key(self._known) != begin.best.key(self._known)),
                      key=lambda state: -state.evidence)[:_BEAM]
        for state in rest:
            best = self.best
            self._take(state.model)
            self.best = max(best, self.best, key=lambda one: one.evidence)

    def grow(self, most, begun) -> None:
        """
        Add effects to the best sets while the evidence grows.

        Those wait that gain much less than was gained since a State ``begun``.
        """
        beam = [self.best]
        while (added := len(self.best.model.robot.effects) - self._known) < most:
            width = _BEAM if added < _FEW else 1
            worth = EVIDENCE if begun is None else max(
                EVIDENCE, _WAITS * (self.best.evidence - begun.evidence))
            found = {one.key(self._known): one for state in beam for one in self._neighbours(
                state, width + 1 if width > 1 else 1, worth)}
            states = sorted(found.values(), key=lambda one: -one.evidence)[:width]
            if not states or states[0].evidence < self.best.evidence + worth:
                break
            self.best, beam = states[0], states
            last = self.best.model.robot.effects[-1]
            self._say(f'{last.name} of {last.joint}')
        if added > 1:
            self._take(self.best.model)

    def _neighbours(self, state, shortlist, worth):
        """Return the States with one effect more, the likeliest few that gain evidence."""
        least, found = worth + 2.0 * np.log(self.hypotheses), {}
        for model, jacobian, limit in self._bases(state):
            ranked, better = self.dictionary.ranked(model, jacobian, limit), 0
            for one in ranked:
                if one.decrease < max(_CLOSE * ranked[0].decrease, least) or better == shortlist:
                    break
                if one.key in found:
                    continue
                other = self._with(one.spec, model, jacobian)
                if other is not None:
                    found[one.key] = other
                    better += other.evidence > state.evidence + EVIDENCE
            if better == shortlist:
                break
        found = sorted(found.values(), key=lambda one: -one.evidence)
        return [self._anew(one, state.model.x) for one in found[:1]] + found[1:]

    def _bases(self, state):
        """
        Yield a model, its Jacobian, and how far nuisance parameters may go from there.

        As it is, and with nuisance parameters that are plausible: where they are not, they stand
        for something that is missing.
        """
        model = state.model
        yield model, state.jacobian, np.inf
        if not fitting.is_within(self._likelihood, model, PLAUSIBLE):
            jacobian = np.concatenate([self.nuisances, state.own])
            yield (fitting.fit(self._likelihood, model.robot, model.x, jacobian,
                               plausible=PLAUSIBLE), jacobian, PLAUSIBLE)

    def _with(self, spec, model, jacobian):
        """Return the State of a model with one effect more, None if it ends at a limit."""
        model = fitting.fit(self._likelihood, with_effects(model.robot, spec), model.x, jacobian)
        return None if self._is_at_limit(model) else self._tried(model, fitting.extended(
            self._likelihood, model, jacobian, len(model.robot.effects) - 1))

    def _anew(self, state, x):
        """
        Return a State by derivatives of its own if nuisance parameters have moved far from ``x``.

        A clock that is wrong changes what a spring does.
        """
        likelihood, model = self._likelihood, state.model
        for _ in range(_ANEW):
            if np.max(np.abs(model.x - x) / likelihood.sd) < _FAR:
                break
            x = model.x
            nuisances = likelihood.jacobian(model)
            state = max(state, self._tried(*fitting.refitted(
                likelihood, model.robot, x, nuisances)), key=lambda one: one.evidence)
            model = state.model
        return state

    def improve(self) -> None:
        """Drop, exchange and merge effects where that has more evidence."""
        for spec in self.best.model.robot.effects[self._known:]:
            there = [one.key for one in self.best.model.robot.effects]
            if spec.key in there:
                self._instead_of(there.index(spec.key))
        added = range(self._known, len(self.best.model.robot.effects))
        if len(added) <= _FEW:
            for pair in combinations(added, 2):
                if max(pair) < len(self.best.model.robot.effects):
                    self._instead_of(*pair)

    def _instead_of(self, *dropped):
        """Try a model without some effects, and with another in their place."""
        likelihood, model = self._likelihood, self.best.model
        robot = fitting.without(model.robot, *dropped)
        others = fitting.jacobian_without(likelihood, model, self.best.jacobian, *dropped)
        anything, less, limit = fitting.fit_without(likelihood, model, robot, others)
        states = [self._tried(anything, others)]
        loss, keys = less.cost - model.cost, {model.robot.effects[i].key for i in dropped}
        for one in self.dictionary.ranked(less, others, limit)[:_SHORTLIST]:
            other = one.decrease >= _NEARLY * loss and one.key not in keys and self._with(
                one.spec, less, others)
            if other:
                states.append(other)
        best = max(states, key=lambda one: one.evidence)
        if best.evidence > self.best.evidence:
            self._say(f'{len(dropped)} effects fewer or others')
            self._take(best.model)

    def settle(self) -> None:
        """Fit all once more by derivatives of the model found: those of the first are stale."""
        model = self.best.model
        if len(model.robot.effects) > self._known:
            self.nuisances = self._likelihood.jacobian(model)
            self._take(model)
