# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""From recordings and a model to what the model lacks: check, where, what, add, show."""

from dataclasses import dataclass, field, replace
import time

from gms_flex_control.discrepancy import judge
from gms_flex_control.discrepancy.gap import gap_of, torque_rms
from gms_flex_control.discrepancy.path import path_of, with_links
from gms_flex_control.discrepancy.problem import Problem
from gms_flex_control.discrepancy.result import (
    BAD_DATA,
    COMPLETE,
    Discrepancy,
    Finding,
    FOUND,
    Tried,
    UNEXPLAINED,
)
from gms_flex_control.discrepancy.retuned import with_knobs
from gms_flex_control.discrepancy.search import LEAST_GAIN, refitted, search
from gms_flex_control.discrepancy.signature import signature_of
from gms_flex_control.discrepancy.words import (
    evidence_of,
    IN_MOTION,
    of_unseen,
    paragraph,
    tells_apart,
)
from gms_flex_control.errors import SimulationError
from gms_flex_control.identification.checks import check
import numpy as np

_AT_REST = 0.25       # of what is left: so much of it while links stand may be friction
_UNSURE = 2.0         # times what matters, for an effect that may be another
_UNEXPECTED = 4.0     # times the loss that was foreseen: an effect is taken back
DETECTED = 0.3        # missing, see `missing`: below, nothing is
CERTAIN = 1.0         # likewise: so much is no trifle, small as its torque is
TRIFLE = 0.5          # of the practical torque
EXPLAINED = 0.05      # of what was missing: so little may be left of it
PARTLY = 0.2          # likewise, where effects that explain most of it are named
DOMINANT = 0.6        # share of an effect that explains most
TOO_MUCH = 0.5        # left of what was missing: no effect is named
PART = 0.05           # share of an effect that is worth naming where much is left
FEW = 3               # findings: so few are all named, small and like others though they be
BESIDE = 0.5          # of the torque missed most: an effect so large matters, however small
DOUBTFUL = 0.1        # of what is still unexplained: an effect worth less is not believed


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


_NOISE_DOUBT = 0.15   # by which the level of a clean run may be wrong
_NEARLY_ALL = 0.2     # of held-out torque: less is left of it
_GOOD_DEAL = ((0.95, 0.3), (0.35, 0.95), (_NEARLY_ALL, 1.1))  # of torque and stray squared
_CHANCE = 1.1         # of held-out torque, where an effect acts seldom
_FARTHEST = 1.02, 1.7, 4.0  # of squared free runs, by how many excuses they have; see `helps`
_SIGNIFICANT = 2.0    # standard errors of the mean of free runs
_FLOOR = 1.0 / 6.0    # of the practical torque: what rows are measured by


def discrepancy(recordings, robot, options=None, *, holdout=(), say=lambda text: None):
    """
    Find what a model lacks.

    Parameters
    ----------
    recordings : sequence of Recording
        Of one robot.
    robot : RobotParams
        As believed.
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
        If a recording lacks what the equations need.

    """
    options, begun = options or Options(), time.monotonic()
    sources = tuple(recording.source for recording in recordings)
    say('checking the data')
    findings = [finding for recording in (*recordings, *holdout)
                for finding in check(with_links(recording, robot), robot)]
    faults = tuple(finding.text for finding in findings)
    if any(finding.severity == 'refuse' for finding in findings) and not options.force:
        return Discrepancy(verdict=BAD_DATA, faults=faults, sources=sources,
                           seconds=time.monotonic() - begun,
                           words='The data are at fault, not the model: ' + ' '.join(
                               text.rstrip('.') + '.' for text in faults))
    paths = [path_of(recording, robot) for recording in recordings]
    result = _searched(paths, robot, options, holdout, True, say)
    problem, found = result.found
    if result.verdict == UNEXPLAINED and problem.share_at_rest(
            found.model.robot, found.model.x) > _AT_REST:
        say('once more, in motion alone')
        moving = _searched(paths, robot, options, holdout, False, say)
        if moving.verdict == FOUND:
            result = replace(moving, words=f'{moving.words} {IN_MOTION}')
    if problem.unseen:
        result = replace(result, words=f'{result.words} {of_unseen(sorted(problem.unseen))}')
    return replace(result, faults=faults, sources=sources, seconds=time.monotonic() - begun)


def _searched(paths, robot, options, holdout, at_rest, say):
    """Return the Discrepancy, links that stand considered or not."""
    say('what runs look like in which nothing is missing')
    problem = Problem(paths, robot, _FLOOR * options.practical, options.seed, options.doubt,
                      at_rest)
    known = len(robot.effects)
    found = search(problem, most=options.most, without=options.without, say=say)
    say('judging what was found')
    found, entries = pruned(problem, found, known)
    return _told(problem, found, entries, known, options, holdout, say)


def pruned(problem, found, known):
    """Return the search's end without effects that something else could be, and the Judged."""
    doubtful = max(DOUBTFUL * missing(problem, found.model.cost) * problem.unit_cost,
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


def missing(problem, cost):
    """Return how far the cost of a model is above that of a clean run, in `Problem.unit_cost`."""
    return (cost - problem.clean_cost) / problem.unit_cost


def helps(gap, much, strictly=False):
    """
    Return whether effects help on data held out.

    Neither torque nor free runs may be worse; torque may be a little worse by chance where an
    effect acts seldom, as an end stop does, and free runs, whose starts are only nearly known,
    where torque is nearly explained or where but few of them stray farther, more so where both.
    Asked to help ``much`` they must do more: free runs stray far less, or torque is explained for
    the better part and they stray no farther, as with an error of an encoder, which moves
    nothing. ``strictly``, free runs must not stray farther at all: where links are not seen
    nothing else speaks for them.
    """
    before, after = (float(np.sum(errors ** 2)) for errors in (gap.free_before, gap.free_after))
    torque, stray = gap.energy_ratio, after / max(before, 1e-300)
    if strictly and stray >= 1.0:
        return False
    if much:
        return any(torque < most and stray < farthest for most, farthest in _GOOD_DEAL)
    excuses = sum((bool(torque < _NEARLY_ALL), bool(gap.free_farther < _SIGNIFICANT)))
    farthest = _FARTHEST[excuses]
    return min(torque, stray) < 1.0 and torque < _CHANCE and stray < farthest


def _choices(entries, left, whole):
    """
    Return which of the effects may be named, the best choice first, and how much they must help.

    Where much is ``left`` unexplained, effects may but resemble what is there: those that explain
    most of it are named if they help, others only if they help much.
    """
    if left <= EXPLAINED:
        return (entries, False), (entries[:1], False)
    if left > TOO_MUCH:
        return ()
    entries = [one for one in entries if one.loss > PART * whole]
    strong = [one for one in entries if one.loss > DOMINANT * whole and left < PARTLY]
    return (entries, True), (entries[:1], True), (strong, False)


def _added(problem, found, known, choices, measured):
    """Return the search's end with the first choice that helps, its effects and the Gap."""
    for entries, much in choices:
        if not entries:
            continue
        try:
            model = found
            if len(entries) < len(found.model.robot.effects) - known:
                model = _only(problem, found, known, entries)
            gap = gap_of(measured, model)
        except SimulationError:
            continue  # with these effects the robot runs away
        if helps(gap, much, bool(problem.unseen)):
            return model, judge.judged(problem, model, known), gap
    found = _only(problem, found, known, [])
    return found, [], gap_of(measured, found)


def _told(problem, found, entries, known, options, holdout, say):
    before, after = (missing(problem, model.cost) for model in (found.before, found.model))
    tried = tuple(Tried(one.spec.name, one.spec.joint, one.gain) for one in found.first)
    slack = DETECTED * problem.caution
    left = max(after - _NOISE_DOUBT, 0.0) / before if before > slack else 0.0
    whole = max(before * problem.unit_cost, 1e-12)
    say('the gap on data held out')
    measured = _measured_on(problem, holdout)
    found, entries, gap = _added(problem, found, known, _choices(entries, left, whole), measured)
    largest = max((one.alone for one in entries), default=0.0)
    findings = [_finding(problem, measured, found, known, one, whole, largest, options)
                for one in entries]
    main, minor, undecided = _grouped(findings, entries)
    left_over = None
    if left > EXPLAINED if findings else _matters(problem, gap, before, options.practical):
        left_over = signature_of(problem, found.model, min(max(missing(
            problem, found.model.cost), 0.0) / max(before, 1e-12), 1.0))
    verdict = FOUND if findings else UNEXPLAINED if left_over else COMPLETE
    retuned = tuple((knob.name, problem.robot.joints[knob.joint] if knob.joint >= 0 else 'arm',
                     float(value)) for knob, value in zip(problem.knobs, found.model.x,
                                                          strict=True))
    result = Discrepancy(
        verdict=verdict, findings=main, minor=minor, undecided=undecided,
        unexplained=left_over, gap=gap, tried=tried, retuned=retuned, found=(problem, found),
        robot=with_knobs(found.model.robot, problem.knobs, found.model.x))
    return replace(result, words=paragraph(result))


def _grouped(findings, entries):
    """
    Return findings that are named, small ones, and those whose names are one of several; tuples.

    Among many, an effect that these data tell from no other is named only if it is the largest.
    """
    groups, few = ([], [], []), len(findings) <= FEW
    for finding, one in zip(findings, entries, strict=True):
        named = few or not finding.confusable_with
        if finding.main:
            groups[0 if named or not groups[0] else 2].append(finding)
        else:
            groups[1 if few or named and judge.is_sure(one) else 2].append(finding)
    return tuple(tuple(group) for group in groups)


def _matters(problem, gap, before, practical):
    """
    Return whether something is left where no effect was found.

    Parameters
    ----------
    problem : Problem
        The rows.
    gap : Gap
        On data held out.
    before : float
        How far the cost is above that of a clean run, see `missing`.
    practical : float
        Torque that matters, as a share of Coulomb friction.

    Returns
    -------
    bool
        What is significant and no trifle of torque: where a motion tells block stiffnesses that
        are a little off, that is no effect.

    """
    level = practical * np.array([problem.level_of(joint) for joint in gap.joints])
    above = np.sqrt(np.maximum(gap.retuned ** 2 - gap.floor ** 2, 0.0))
    return bool(before > DETECTED * problem.caution
                and (before > CERTAIN * problem.caution or np.any(above > TRIFLE * level)))


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
        main=one.alone >= min(least, BESIDE * largest), torque=one.torque,
        share=min(one.loss / whole, 1.0), score=one.loss,
        runner_up=f'{others[0][0]} of {others[0][1]}' if others else None,
        runner_up_score=others[0][2] * one.loss if others else 0.0,
        confusable_with=alike, tells_apart=tells_apart(spec.name, alike),
        evidence=evidence_of(spec, one, others),
        rms_before=torque_rms(measured, one.less.robot, found.model.x),
        rms_after=torque_rms(measured, found.model.robot, found.model.x))
