# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""From recordings and a model to what the model lacks: check, measure noise, search, validate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
import time

from gms_flex_control.compiled import in_one_thread
from gms_flex_control.data.recording import Recording
from gms_flex_control.discrepancy import describe, thresholds, worth
from gms_flex_control.discrepancy import result as outcome
from gms_flex_control.discrepancy.evidence import credible, doubted, posterior
from gms_flex_control.discrepancy.fast_ripple import fast_ripples, with_ripples
from gms_flex_control.discrepancy.findings import (
    as_before,
    as_given,
    finding_of,
    findings_of,
    joints_left,
    judged,
    predicting_subset,
    predictive,
    subsets,
)
from gms_flex_control.discrepancy.fitting import is_within, plausible_limit, with_white_noise
from gms_flex_control.discrepancy.friction_anew import with_friction_anew
from gms_flex_control.discrepancy.gap import HeldOut, torque_rms
from gms_flex_control.discrepancy.likelihood import Likelihood, Residuals
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.nuisance import OfRecording, with_nuisances
from gms_flex_control.discrepancy.null_simulation import is_followed
from gms_flex_control.discrepancy.remainder import FreeFunctions, LEAST, signature_of
from gms_flex_control.discrepancy.samples import faults_of
from gms_flex_control.discrepancy.search import search
from gms_flex_control.discrepancy.torque_noise import noise_of, white_noise
from gms_flex_control.effects.registry import find
from gms_flex_control.params.robot import RobotParams, widened
import numpy as np

_SIMULATED = 3        # times at most that noise is simulated anew
_SIZES = 4            # of sets that may predict better than the one found, or be part of it


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """How the workflow goes about it."""

    most: int = 20       # effects that may be found
    without: tuple = ()  # of str, effects that are not considered
    force: bool = False  # go on where the data are bad
    seed: int = 0        # of the null simulations
    widened: float = 1.0  # prior standard deviations of known parameters, times the usual ones


def find_discrepancy(
        recordings: Sequence[Recording], robot: RobotParams,
        options: SearchOptions | None = None, *, holdout: Sequence[Recording] = (),
        say: Callable[[str], object] = lambda text: None) -> outcome.Discrepancy:
    """
    Find what a robot as believed lacks to explain its recordings, as a Discrepancy.

    Recordings may have its joints in any order, and others beside them. The gap is measured on
    ``holdout``, default blocks of time left out in turn; ``say`` hears what is being done.
    BagError if a recording lacks what the equations need, and is not refused as bad data.
    """
    begun, options = time.monotonic(), options or SearchOptions()
    sources = tuple(recording.source for recording in recordings)
    say('checking the data')
    faults = faults_of(recordings, robot, holdout)
    words = tuple(fault.text for fault in faults)
    fatal = [fault.text for fault in faults if fault.severity == 'refuse']
    if fatal and not options.force:
        result = outcome.Discrepancy(verdict=outcome.BAD_DATA, words=(
            f'The data are at fault, not the model: {describe.first_of(fatal, 4)}'))
    else:
        def searched(robot):
            with in_one_thread(), np.errstate(all='ignore'):
                found = _compared([motion_of(recording, robot) for recording in recordings],
                                  [motion_of(recording, robot) for recording in holdout],
                                  widened(robot, options.widened), options, say)
            return replace(found, robot=replace(found.robot, uncertainty=robot.uncertainty))
        result = with_friction_anew(searched, recordings, robot, options.widened, say)
        if words:
            result = result.saying(f'About the data: {describe.first_of(words, 2)}')
    return replace(
        result, data=result.data._replace(faults=words, sources=sources, currents=any(
            recording.has_currents for recording in recordings)),
        searched=result.searched._replace(seconds=time.monotonic() - begun))


def _compared(motions, holdout, robot, options, say):
    """Return the Discrepancy of motions with a robot as believed."""
    say('null simulations: what recordings look like in which nothing is missing')
    likelihood, found = _searched(
        with_white_noise(Likelihood(motions, robot, options.seed))[0], options, say)
    say('held-out prediction')
    searched = found
    functions = FreeFunctions(likelihood)
    found, worths, free, whole = judged(likelihood, found, functions)
    held_out = HeldOut(likelihood, Residuals(holdout, robot, options.seed) if holdout else None)
    of_judged = found.best
    found, worths = predictive(likelihood, found, worths, held_out)
    if found.best is not of_judged:  # without others an effect may only resemble
        found, worths, free, _ = judged(likelihood, found, functions)
    findings = findings_of(likelihood, found, worths, held_out)
    all_found = found.best
    gap = held_out.gap(found.before, all_found)
    left = _left_over(likelihood, all_found.model, free, gap, held_out.other)
    if left is not None:
        findings, left = _named(likelihood, findings, gap, free, left)
        left = _of_open_joints(left, all_found.model, held_out.other or likelihood)
        found = _named_alone(likelihood, found, {one.key for one in findings})
    more = left is not None or gap.is_above_floor(thresholds.BETTER)
    whole = whole if left else found
    after, alone = _Choice(
        likelihood, found, held_out, {one.key: one for one in findings}).written(
        whole, [searched.best, predicting_subset(likelihood, whole, held_out)] if more else [])
    retuned_alone = replace(gap, after=gap.retuned, free_after=gap.free_before)
    if after is not all_found:
        gap = held_out.gap(alone, after)
        if left is not None and thresholds.CLEARLY * gap.energy_ratio > 1.0:
            findings = []  # beside what may not be written they explain something, alone nothing
    say('ripples at the full rate')
    ripples = fast_ripples(likelihood, after.model, options.without)[
        :max(options.most - len(after.key(likelihood.known)), 0)]
    findings += [finding_of(ripple, robot) for ripple in ripples]
    after, gap = with_ripples(likelihood, held_out, ripples, (alone, after), gap)
    result = _result(likelihood, found, searched, after, findings, left, gap, retuned_alone)
    words, details = describe.paragraph(result, sorted(likelihood.unseen),
                                        _known_off(found, robot))
    return replace(result, words=words, details=details)


def _result(likelihood, found, searched, after, findings, left, gap, retuned_alone):
    """Return the Discrepancy, without words, of a search; ``after`` is written."""
    known, joints = likelihood.known, likelihood.robot.joints
    changes = list(zip(likelihood.nuisances, after.model.x.tolist(), strict=True))
    added, named = after.key(known), {one.key for one in findings}
    main = sorted((one for one in findings if one.main), key=lambda one: one.key not in added)
    minor = tuple(one for one in findings if not one.main)
    shares = posterior(doubted(found.tried, searched.tried, known), known,
                       {one.key for one in minor})
    models = tuple(outcome.Credible(tuple(sorted(names)), mass)
                   for names, mass in credible(shares))
    return outcome.Discrepancy(
        verdict=(outcome.FOUND if any(one.key in added for one in main)
                 else outcome.UNEXPLAINED if left or main else outcome.COMPLETE),
        findings=tuple(main), minor=minor,
        searched=outcome.Searched(models, _tried(found)),
        stand_ins=tuple(
            spec for spec in after.model.robot.effects[known:] if spec.key not in named),
        unexplained=left, gap=gap,
        retuned=tuple((one.name, joints[one.joint] if one.joint >= 0 else 'arm', value)
                      for one, value in changes if not isinstance(one, OfRecording)),
        data=outcome.Recorded(
            differences=tuple(one.words(joints, value) for one, value in changes
                              if isinstance(one, OfRecording) and one.is_reported(value)),
            noise=() if left else noise_of(likelihood, found.best.model)),
        behind=outcome.Behind(likelihood, found.before.model, found.best.model, after.model,
                              retuned_alone),
        robot=with_nuisances(after.model.robot, likelihood.nuisances, after.model.x))


def _searched(likelihood, options, say):
    """Return a search, with the noise of a robot like the one found if that is another."""
    def searched(begin=None, wait=True, without=options.without):
        return search(likelihood, options.most, without, begin, wait, say)
    found = None
    for k in range(_SIMULATED + 1):
        found = worth.timed(likelihood, searched(found, k < _SIMULATED))
        sound = _sound(likelihood, found)
        if sound is None:
            break  # noise stays that of the robot believed, which keeps to the motion
        found, model, noise = sound, sound.best.model, likelihood.noise
        if found.is_done if k else (len(model.robot.effects) == likelihood.known
                                    and is_within(likelihood, model, thresholds.PLAUSIBLE)):
            break
        say('once more, with the noise of such a robot')
        found = sound = found._replace(dictionary=None)  # two of them would fill the memory
        likelihood = likelihood.simulated_as(model)
        # beside more effects there is less that may be taken for noise
        likelihood = likelihood.with_noise(np.minimum(noise, white_noise(
            likelihood, likelihood.fitted(model.robot, model.x))))
    hardly = _hardly_acting(likelihood, found.best)
    if hardly:
        kept = tuple(one for one in found.tried if not _hardly_acting(likelihood, one))
        found = found._replace(dictionary=None, tried=kept,
                               best=max(kept, key=lambda state: state.evidence))
        found = searched(found, False, (*options.without, *hardly))
    return likelihood, found


def _hardly_acting(likelihood, state):
    """Return the names of effects of a State on which the motion hardly depends."""
    return {spec.name for spec in state.model.robot.effects[likelihood.known:]
            if find(spec.name).hardly_acts(spec.values, likelihood.scales_of(spec.joint))}


def _sound(likelihood, found):
    """Return a search with the likeliest model that does not run away, None if all do."""
    return next((found._replace(best=state) for state in (
        found.best, *sorted(found.tried, key=lambda state: -state.evidence))
        if is_followed(likelihood, state.model)), None)


def _left_over(likelihood, model, free, gap, measured):
    """
    Return the Signature of more than drive noise left, also in ``measured`` alone, or None.

    A ``free`` function is something only where the torque of the Gap exceeds its noise floor by as
    much, or free runs show it.
    """
    share, joints = min(gap.energy_ratio, 1.0), likelihood.robot.joints
    if free is not None:
        j = joints.index(free.joint)
        if (gap.after[j] < np.hypot(gap.floor[j], LEAST * likelihood.level_of(free.joint))
                and not gap.free_after[j] ** 2 > thresholds.BETTER * gap.free_floor[j] ** 2):
            free = None
    for data, function in ((likelihood, free), *([(measured, None)] if measured else [])):
        somewhere = joints_left(data, model, function)
        if somewhere:
            left = signature_of(data, model, share, function)
            return left._replace(joints=tuple(
                name for name in joints if name in (*somewhere, left.joint)))
    return None


def _named(likelihood, findings, gap, free, left):
    """
    Return the findings that are named though something is left, and the Signature of that.

    By joint: an effect is named where all effects together explain more than they leave of the
    Gap of the joint whose torque it lessens most. Else it only resembles some of what is there.
    Free runs, in which errors of all joints meet, decide what is written. The Signature keeps the
    joints that nothing explains.
    """
    noise = np.nan_to_num(gap.floor) ** 2
    before, after = (np.maximum(one ** 2 - noise, 0.0) for one in (gap.retuned, gap.after))
    explained = after < thresholds.MOST_LEFT * before
    named, resembling = [], set()
    for one in findings:
        torque = one.residual
        joint = int(np.argmax((torque.before ** 2 - torque.after ** 2) / likelihood.coulomb ** 2))
        if explained[joint] and (free is not None or not left.is_of(one)):
            named.append(one)
        else:
            resembling.add(gap.joints[joint])
    open_joints = tuple(name for name, is_explained in zip(gap.joints, explained, strict=True)
                        if name in left.joints and (name in resembling or not is_explained))
    return (named if any(one.main for one in named) else []), left._replace(joints=open_joints)


def _of_open_joints(left, model, data):
    """Return a Signature that is of one of its joints, which nothing explains."""
    if not left.joints or left.joint in left.joints:
        return left
    return signature_of(data, model, left.share, among=left.joints)._replace(joints=left.joints)


def _named_alone(likelihood, found, named):
    """Return the search's end with those effects alone that are ``named``, if any is."""
    withheld = [i for i, spec in enumerate(found.best.model.robot.effects)
                if i >= likelihood.known and spec.key not in named]
    if not named or not withheld:
        return found
    return found._replace(best=worth.with_fewer(likelihood, found, *withheld))


class _Choice:
    """
    Which State is written, of those a search has tried.

    ``named`` are the effects that are named, dict of key to Finding: where one acts otherwise, it
    only resembles something. States are compared on held-out data. None is written that predicts
    torque, the drive's torque or free runs worse than the model as given, which may have been
    fitted to the blocks left out; nor with effects worse than the same parameters re-tuned alone.
    Where one of them is main, worse means clearly, and by what matters.
    """

    def __init__(self, likelihood, found, held_out, named):
        self._likelihood, self._found, self._held_out = likelihood, found, held_out
        self._named, self._limit = named, plausible_limit(likelihood, found.best.model)
        self._given = as_given(likelihood, found.before, found.nuisances)

    def written(self, larger, further) -> tuple:
        """
        Return the State that predicts best, and one without effects, as far re-tuned.

        That with all effects found, unless another is clearly better: with fewer, with such as
        only resemble what is missing (``larger``, a Found), or ``further`` States.
        """
        known, energy = self._likelihood.known, self._held_out.energy
        others = [one for one in (self._found.before, larger.best, *self._best_of_each_size(),
                                  *further)
                  if (one.key(known) or self._is_plausible(one)) and self._may_be(one)]
        other = min((self._given, *others), key=energy)
        other = other, self._found.before if other.key(known) else other
        whole = min(self._with_effects(), key=lambda pair: energy(pair[0]), default=other)
        return whole if thresholds.CLEARLY * energy(other[0]) >= energy(whole[0]) else other

    def _with_effects(self):
        """
        Return the pairs of States, with the effects found and without, that may be written.

        Known parameters are re-tuned; if that may not be written, re-tuned without effects or as
        given: all, or all but those of joints with effects that are named. Else fewer effects.
        """
        found, joints = self._found, self._likelihood.robot.joints
        if self._may_be(found.best):
            return [(found.best, found.before)]
        if not found.best.key(self._likelihood.known):
            return []
        of_named = {joint for _, joint in self._named if joint in joints}
        pairs = [*self._as_before(), *(
            tuple(self._as_given(state, but) for state in (found.best, found.before))
            for but in ((), of_named))]
        pairs = [pair for pair in pairs if self._may_be(*pair)]
        if pairs:
            return pairs
        parts = islice(subsets(self._likelihood, found, self._held_out, self._as_given), _SIZES)
        return [(one, self._given) for one in parts if self._may_be(one, self._given)]

    def _as_before(self):
        """
        Return the pair of States with effects found beside parameters re-tuned without, or none.

        Blocks left out judge a State fitted anew without them, which no State is that is written
        as it is: effects that were found beside other parameters may leave more than is there.
        """
        before = self._found.before
        state = as_before(self._likelihood, self._found.best, before)
        left, alone = (np.sum((torque_rms(self._likelihood, one.model)
                               / self._likelihood.coulomb) ** 2) for one in (state, before))
        return [(state, before)] if left <= (1.0 + thresholds.NOT_CLEARLY) ** 2 * alone else []

    def _best_of_each_size(self):
        """Return the likeliest State of each number of effects, the smallest ones."""
        best = {}
        for state in sorted(self._found.tried, key=lambda state: -state.evidence):
            if np.isfinite(state.evidence) and self._is_plausible(state):
                best.setdefault(len(state.key(self._likelihood.known)), state)
        return [best[size] for size in sorted(best)[:_SIZES]]

    def _as_given(self, state, but=()):
        return as_given(self._likelihood, state, self._found.nuisances, but)

    def _is_plausible(self, state):
        """Return whether no known parameter, beyond its prior, takes the place of an effect."""
        return np.all(np.abs(state.model.x) / self._likelihood.sd <= self._limit)

    def _may_be(self, state, alone=None):
        """Return whether a State may be written, parameters alone being ``alone``."""
        if self._worsens(state, alone, state.key(self._likelihood.known) & self._named.keys()):
            return False
        kept = self._as_found(state)
        return not self._worsens(state, alone, kept) and (
            bool(self._held_out.other) or self._may_stand_in(state, kept))

    def _worsens(self, state, alone, kept):
        """Return whether a State predicts worse than its effects, ``kept`` as found, may cost."""
        held_out, alone = self._held_out, alone or self._found.before
        matters = any(self._named[key].main for key in kept)
        return held_out.worsens(state, self._given, matters * (
            thresholds.WORSE if held_out.other else thresholds.NOT_CLEARLY)) or bool(
            state.key(self._likelihood.known)
            and held_out.worsens(state, alone, matters * thresholds.NOT_CLEARLY))

    def _as_found(self, state):
        """Return the keys of effects of a State that are named, and act much as found."""
        effects = state.model.robot.effects
        return {effects[i].key for i in range(self._likelihood.known, len(effects))
                if effects[i].key in self._named and worth.acts_like(
                    self._likelihood, state.model, i, self._named[effects[i].key].values)}

    def _may_stand_in(self, state, kept):
        """
        Return whether a State may be written that may have effects beside those ``kept`` (keys).

        Others must explain more than they leave, of what named ones or parameters alone leave in
        the joints on which they act, and act in as many blocks as judge. Blocks of a recording are
        much like what was fitted: what only resembles the cause must show more there than on
        other recordings.
        """
        likelihood, effects = self._likelihood, state.model.robot.effects
        others = [i for i in range(likelihood.known, len(effects)) if effects[i].key not in kept]
        if not others:
            return True
        owners, joints = {effects[i].joint for i in others}, likelihood.robot.joints
        acted = [joint in owners or not owners.issubset(joints) for joint in joints]  # or all

        def left(state):
            torque = self._held_out.errors(state).torque / likelihood.coulomb
            return np.sum(torque[acted] ** 2)

        def explain_most(of):
            return left(state) < thresholds.MOST_LEFT * left(of)
        return (explain_most(self._found.before) and explain_most(self._given)
                and all(worth.acts_widely(likelihood, state.model, i) for i in others)
                and (not kept or explain_most(worth.with_fewer(
                    likelihood, self._found._replace(best=state), *others))))


def _tried(found):
    """Return all hypotheses of the first scan: the best of them, then those fitted roughly."""
    best = {one.key: one.decrease for one in found.first}
    others = sorted((gain, key) for key, gain in found.scan.items() if key not in best)
    return (*(outcome.Tried(*key, gain, True) for key, gain in best.items()),
            *(outcome.Tried(*key, gain, False) for gain, key in reversed(others)))


def _known_off(found, robot):
    """Return (effect, joint) of an effect the model has, if another value would explain most."""
    known = {spec.key for spec in robot.effects}
    ranked = sorted(found.scan, key=lambda key: -found.scan[key])
    return (ranked[0] if ranked and ranked[0] in known
            and found.scan[ranked[0]] > thresholds.KNOWN_OFF else None)
