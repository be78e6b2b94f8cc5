# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""From recordings and a model to what the model lacks: check, where, what, add, show."""

from dataclasses import dataclass, field, replace
import time
from typing import NamedTuple

from gms_flex_control import blas
from gms_flex_control.discrepancy import judge, naming
from gms_flex_control.discrepancy.data_faults import faults_of
from gms_flex_control.discrepancy.gap import gap_of, torque_rms
from gms_flex_control.discrepancy.guesses import is_at_limit
from gms_flex_control.discrepancy.late_torque import samples_late
from gms_flex_control.discrepancy.onset import steady
from gms_flex_control.discrepancy.path import path_of
from gms_flex_control.discrepancy.problem import Problem
from gms_flex_control.discrepancy.result import (
    BAD_DATA,
    Behind,
    COMPLETE,
    Discrepancy,
    Finding,
    FOUND,
    Tried,
    UNEXPLAINED,
)
from gms_flex_control.discrepancy.retuned import with_knobs
from gms_flex_control.discrepancy.search import LEAST_GAIN, refitted, search
from gms_flex_control.discrepancy.seldom import where_it_acts
from gms_flex_control.discrepancy.signature import signature_of
from gms_flex_control.discrepancy.words import (
    evidence_of,
    first_of,
    IN_MOTION,
    of_known,
    of_late,
    of_nearest,
    of_unseen,
    paragraph,
    tells_apart,
)
from gms_flex_control.errors import SimulationError

_AT_REST = 0.25       # of what is left: so much of it while links stand may be friction
_UNSURE = 2.0         # times what matters, for an effect that may be another
_UNEXPECTED = 4.0     # times the loss that was foreseen: an effect is taken back
_DOUBTFUL = 0.1       # of what is still unexplained: an effect worth less is not believed
_BESIDE = 0.5         # of the torque missed most: an effect so large matters, however small
_NOISE_DOUBT = 0.15   # by which the level of a clean run may be wrong
_UNSETTLED = 0.15     # missing: so much may be left because noise is not what it was taken for
_VANISHED = 0.01      # of what was missing: noise in which no more of it shows hides all
_AGAIN = 2            # times it is searched again, at most
_MANY = 6             # effects: too many to look for all of them anew
_FLOOR = 1.0 / 6.0    # of the practical torque: what rows are measured by


@dataclass(frozen=True, kw_only=True)
class Options:
    """
    How the workflow goes about it.

    Parameters
    ----------
    practical : float
        Torque that matters in practice, as a share of Coulomb friction; smaller effects are
        listed apart.
    most : int
        How many effects may be found.
    without : tuple of str
        Effects that are not considered.
    force : bool
        Go on where the data are bad.
    seed : int
        Of the runs in which nothing is missing.
    doubt : float
        How many times as far as usual (known.DOUBT) known parameters may be off.

    """

    practical: float = 0.03
    most: int = 20
    without: tuple = field(default=())
    force: bool = False
    seed: int = 0
    doubt: float = 1.0


def discrepancy(recordings, robot, options=None, *, holdout=(), say=lambda text: None):
    """
    Find what a model lacks.

    Parameters
    ----------
    recordings : sequence of Recording
        Of one robot.
    robot : RobotParams
        As believed; recordings may have its joints in any order, and others beside them.
    options : Options, optional
        How to go about it.
    holdout : sequence of Recording
        Further recordings on which the gap is measured; default the blocks of time held out.
    say : callable, optional
        Told what is being done.

    Returns
    -------
    Discrepancy

    Raises
    ------
    BagError
        If a recording lacks what the equations need, and is not refused as bad data.

    """
    with blas.in_one_thread():
        return _discrepancy(recordings, robot, options or Options(), holdout, say)


def _discrepancy(recordings, robot, options, holdout, say):
    begun = time.monotonic()
    sources = tuple(recording.source for recording in recordings)
    say('checking the data')
    findings = faults_of((*recordings, *holdout), robot)
    faults = tuple(finding.text for finding in findings)
    fatal = [finding.text for finding in findings if finding.severity == 'refuse']
    if fatal and not options.force:
        return _at_fault(fatal, faults, sources, begun)
    paths = [path_of(recording, robot) for recording in recordings]
    result = _searched(paths, robot, options, holdout, True, say)
    problem, found = result.behind.problem, result.behind.found
    if result.verdict != COMPLETE:
        late = samples_late(problem, found)
        if late:
            fatal = [of_late(late, [path.fine_period for path in paths])]
            faults += tuple(fatal)
            if not options.force:
                return _at_fault(fatal, faults, sources, begun)
    if result.verdict == UNEXPLAINED and problem.share_at_rest(
            found.model.robot, found.model.x) > _AT_REST:
        say('once more, in motion alone')
        moving = _searched(paths, robot, options, holdout, False, say)
        if moving.verdict == FOUND:
            result = replace(moving, words=f'{moving.words} {IN_MOTION}')
        elif moving.nearest:
            nearest = f'In motion alone: {moving.nearest}'
            result = replace(result, nearest=f'{result.nearest} {nearest}'.lstrip(),
                             words=f'{result.words} {nearest}')
    if problem.unseen:
        result = replace(result, words=f'{result.words} {of_unseen(sorted(problem.unseen))}')
    if faults:
        result = replace(result, words=f'{result.words} About the data: {first_of(faults, 2)}')
    return replace(result, faults=faults, sources=sources, seconds=time.monotonic() - begun)


def _at_fault(fatal, faults, sources, begun):
    """Return the Discrepancy of data that do not allow to look for what is missing."""
    return Discrepancy(verdict=BAD_DATA, faults=faults, sources=sources,
                       seconds=time.monotonic() - begun,
                       words=f'The data are at fault, not the model: {first_of(fatal, 4)}')


def _searched(paths, robot, options, holdout, at_rest, say):
    """Return the Discrepancy, links that stand considered or not."""
    say('what runs look like in which nothing is missing')
    problem = Problem(paths, robot, _FLOOR * options.practical, options.seed, options.doubt,
                      at_rest)
    known = len(robot.effects)
    problem, found = _settled(problem, options, say)
    say('judging what was found')
    found, entries = pruned(problem, found, known)
    if not holdout:
        problem, found, entries = where_it_acts(problem, found, entries, known, options.without)
    return _told(problem, found, entries, known, options, holdout, say)


def _settled(problem, options, say):
    """
    Return what a search ends with, and the Problem in which noise is that of a robot like it.

    Noise depends on the robot: where it sticks, say, encoder counts hide its friction. Measured
    on the robot as believed, noise that is larger in truth looks like further effects. If it is
    not by noise alone that something is left, or what is found then begins with an effect that
    such a robot does not have, or hardly anything shows in such noise, the search stands as it
    was.
    """
    found = search(problem, most=options.most, without=options.without, say=say)
    for _ in range(_AGAIN):
        before, after = (problem.missing(model) for model in (found.before, found.model))
        added = len(found.model.robot.effects) - len(problem.robot.effects)
        if not added or not _UNSETTLED < after < naming.TOO_MUCH * before:
            break
        say('once more, with the noise of such a robot')
        try:
            other = problem.measured_like(found.model)
        except SimulationError:
            break  # with these effects the robot runs away
        again = search(other, most=options.most, without=options.without,
                       begin=found.model if added > _MANY else None, say=say)
        if (other.missing(again.model) > naming.DETECTED * problem.caution
                or other.missing(again.before) < _VANISHED * before
                or not _begins_alike(again.model, found.model, len(problem.robot.effects))):
            break
        problem, found = other, again
    return problem, found


def _begins_alike(model, other, known):
    """Return whether the first effect that was added to a model is in another, too."""
    names = [[(spec.name, spec.joint) for spec in one.robot.effects[known:]]
             for one in (model, other)]
    return bool(names[0]) and names[0][0] in names[1]


def pruned(problem, found, known):
    """Return the search's end without effects that something else could be, and the Judged."""
    doubtful = max(_DOUBTFUL * problem.missing(found.model) * problem.unit_cost,
                   LEAST_GAIN * problem.caution)
    kept = set()
    while True:
        entries = judge.judged(problem, found, known)
        weak = [one for one in entries if _name(found, one) not in kept
                and (not judge.stands_alone(one) or one.loss < doubtful)]
        if not weak:
            return found, entries
        one = min(weak, key=lambda one: one.loss)
        model, columns = refitted(problem, one.less.robot, one.less.x,
                                  found.columns[:len(problem.knobs)], known)
        if model.cost - found.model.cost > max(_UNEXPECTED * one.loss, doubtful):
            kept.add(_name(found, one))  # others are no match for it after all
        else:
            found = found._replace(model=model, columns=columns)


def _name(found, one):
    spec = found.model.robot.effects[one.index]
    return spec.name, spec.joint


def _by_gain(found, entries):
    """Return the Judged by what their effects gained when nothing else was there."""
    by_name = {_name(found, one): one for one in entries}
    ranked = [(one.spec.name, one.spec.joint) for one in found.first]
    return [by_name[name] for name in ranked if name in by_name]


class _Named(NamedTuple):
    """What is left of a search's end once its effects have been asked to help."""

    found: object
    entries: list    # of its effects
    gap: object
    nearest: str     # a sentence on what all but helped, '' if nothing did


def _added(problem, found, known, choices, measured):
    """Return the search's end with the first choice that helps, as _Named."""
    near = []
    for entries, much in choices:
        if not entries:
            continue
        try:
            model, judged = found, entries
            if len(entries) < len(found.model.robot.effects) - known:
                model = _only(problem, found, known, entries)
                judged = judge.judged(problem, model, known)
                if not naming.explains_alone(entries, judged):
                    continue
            gap = gap_of(measured, model)
        except SimulationError:
            continue  # with these effects the robot runs away
        if naming.helps(gap, much, bool(problem.unseen)):
            return _Named(model, judged, gap, '')
        near.append((naming.strayed(gap), gap.energy_ratio, [_name(model, one) for one in judged]))
    found = _only(problem, found, known, [])
    return _Named(found, [], gap_of(measured, found), of_nearest(near))


def _left(problem, found, before):
    """Return the share that is left of what was missing, noise allowed for."""
    if before <= naming.DETECTED * problem.caution:
        return 0.0
    return max(problem.missing(found.model) - _NOISE_DOUBT, 0.0) / before


def _told(problem, found, entries, known, options, holdout, say):
    """Return the Discrepancy: which effects of the search's end are named, the gap, the rest."""
    before = problem.missing(found.before)
    tried = _tried(found)
    whole = max(before * problem.unit_cost, 1e-12)
    say('the gap on data held out')
    measured = _measured_on(problem, holdout)
    entries, sudden = steady(problem, found, entries)
    robot = found.model.robot
    entries = [one for one in entries if not is_at_limit(robot.effects[one.index], robot)]
    choices = naming.choices(entries, _left(problem, found, before), whole,
                             _by_gain(found, entries))
    found, entries, gap, nearest = _added(problem, found, known, choices, measured)
    largest = judge.largest_alone(entries)
    findings = [_finding(problem, measured, found, known, one, whole, largest, options)
                for one in entries]
    main, minor, undecided = naming.grouped(findings, entries)
    is_left = sudden or (_left(problem, found, before) > naming.EXPLAINED if findings else
                         naming.matters(problem, gap, before, options.practical))
    left_over = _left_over(problem, found, before, sudden) if is_left else None
    written, withheld = found.model, None
    if findings and naming.makes_worse(gap):
        written, withheld = found.before, gap
        gap = gap_of(measured, found._replace(model=written))
    result = Discrepancy(
        verdict=FOUND if findings else UNEXPLAINED if is_left else COMPLETE,
        findings=main, minor=minor, undecided=undecided,
        unexplained=left_over, gap=gap, nearest=nearest if is_left else '', withheld=withheld,
        tried=tried, retuned=_retuned(problem, written),
        behind=Behind(problem, found, written),
        robot=with_knobs(written.robot, problem.knobs, written.x))
    known_off = of_known(found.first, problem.robot.effects, whole, LEAST_GAIN * problem.caution)
    return replace(result, words=f'{paragraph(result)} {known_off}'.rstrip())


def _tried(found):
    """Return all hypotheses of the first scan: the best of them, then those fitted roughly."""
    best = {(one.spec.name, one.spec.joint): one.gain for one in found.first}
    others = sorted((gain, key) for key, gain in found.scan.items() if key not in best)
    return (*(Tried(*key, gain, True) for key, gain in best.items()),
            *(Tried(*key, gain, False) for gain, key in reversed(others)))


def _left_over(problem, found, before, sudden):
    """Return the Signature of what is left, with a sentence on what sets in ``sudden``ly."""
    share = max(problem.missing(found.model), 0.0) / max(before, 1e-12)
    signature = signature_of(problem, found.model, min(share, 1.0))
    return signature._replace(sentence=f'{signature.sentence} {sudden}'.rstrip())


def _retuned(problem, model):
    """Return name, joint and relative change of each known parameter."""
    return tuple((knob.name, problem.robot.joints[knob.joint] if knob.joint >= 0 else 'arm',
                  float(value)) for knob, value in zip(problem.knobs, model.x, strict=True))


def _only(problem, found, known, entries):
    """Return the search's end with only some effects, all re-tuned."""
    effects = found.model.robot.effects
    kept = sorted(one.index for one in entries)
    robot = replace(found.model.robot, effects=effects[:known] + tuple(
        effects[i] for i in kept))
    knobs = found.columns[:len(problem.knobs)]
    if not kept:
        return found._replace(model=found.before, columns=knobs)
    model, columns = refitted(problem, robot, found.before.x, knobs, known)
    return found._replace(model=model, columns=columns)


def _measured_on(problem, holdout):
    """Return the Problem a gap is measured on."""
    if not holdout:
        return problem
    return problem.of_others([path_of(recording, problem.robot) for recording in holdout])


def _finding(problem, measured, found, known, one, whole, largest, options):
    spec = found.model.robot.effects[one.index]
    others = judge.rivals(problem, found, one)
    alike = judge.confusable(spec, others)
    least = options.practical * problem.level_of(spec.joint) * (_UNSURE if alike else 1.0)
    return Finding(
        effect=spec.name, joint=spec.joint,
        values=judge.values_of(problem, found, known, one.index),
        main=one.alone >= min(least, _BESIDE * largest), torque=one.torque,
        share=min(one.loss / whole, 1.0), score=one.loss,
        runner_up=f'{others[0][0]} of {others[0][1]}' if others else None,
        runner_up_score=others[0][2] * one.loss if others else 0.0,
        confusable_with=alike, tells_apart=tells_apart(spec.name, others),
        evidence=evidence_of(spec, one, others),
        rms_before=torque_rms(measured, one.less.robot, found.model.x),
        rms_after=torque_rms(measured, found.model.robot, found.model.x))
