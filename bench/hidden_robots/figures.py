# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The figures of the bench: counts and medians over outcomes, beside what is required."""

from typing import NamedTuple

from bench.hidden_robots import judgement
from bench.hidden_robots.judgement import (
    BELIEF,
    hidden_names,
    is_belief_error,
    judged,
    names_given,
    not_believed,
    RIGHT,
    WORKFLOW,
    WRONG,
)
import numpy as np

REQUIRED = ('home', 'paper_sinusoid', 'paper_polynomial')  # populations the requirements are of
MADE_WORSE = 1.01  # free-run error after / before that counts as worse


class Figure(NamedTuple):
    """One line of the table."""

    name: str  # what it is
    value: float | None  # share, median or number; None without any outcome
    required: float | None  # what it must reach; None if it is only reported
    at_least: bool  # whether more is better
    count: int  # outcomes it is taken over
    percent: bool = True  # how it is shown

    @property
    def met(self):
        """Return whether it is reached; None where it is unknown or nothing is required."""
        if self.value is None or self.required is None:
            return None
        return self.value >= self.required if self.at_least else self.value <= self.required


def chosen(outcomes, kind, population='home', plant=None):
    """Return the outcomes of a kind in a population, of one plant or of all."""
    return [one for one in outcomes
            if one['truth']['kind'] == kind and one['truth']['population'] == population
            and plant in (None, one['truth']['plant'])]


def share(flags):
    """Return the share of true ones, or the mean; None of nothing."""
    flags = list(flags)
    return float(np.mean(flags)) if flags else None


def median(values):
    """Return the median of what is known, None of nothing."""
    values = [value for value in values if value is not None]
    return float(np.median(values)) if values else None


def figures_of(outcomes):
    """Return the Figures of the workflow, of ``outcomes`` (dicts of `outcome.try_job`)."""
    return [*_single(outcomes), *_other(outcomes), *_clutter(outcomes), *_credible(outcomes),
            *_use(outcomes)]


def _single(outcomes, tool=WORKFLOW):
    rich, stiff = chosen(outcomes, 'single'), chosen(outcomes, 'single', plant='stiff')
    paper = [one for name in ('paper_sinusoid', 'paper_polynomial')
             for one in chosen(outcomes, 'single', name)]
    errors = [judgement.parameter_error(one) for one in rich
              if tool == WORKFLOW and judged(one) == RIGHT]

    def answered(cases, answer):
        return share(judged(one, tool) == answer for one in cases)
    return [
        Figure('right name, first place', answered(rich, RIGHT), 0.96, True, len(rich)),
        Figure('wrong name', answered(rich, WRONG), 0.005, False, len(rich)),
        Figure("the paper's motions: right name", answered(paper, RIGHT), 0.93, True, len(paper)),
        Figure('stiff plant: right name', answered(stiff, RIGHT), 0.95, True, len(stiff)),
        Figure('median parameter error', median(errors), 0.015, False, len(errors))]


def _other(outcomes, tool=WORKFLOW):
    clean, outside = chosen(outcomes, 'clean'), chosen(outcomes, 'outside')
    deleted, found = chosen(outcomes, 'deleted'), _found(chosen(outcomes, 'double'), tool)

    def silent(cases, judge):
        """Return the share of which the workflow says so; of a peer, which it names nothing of."""
        return share(judge(one) if tool == WORKFLOW else not names_given(one, tool)
                     for one in cases)
    return [
        Figure('clean called clean', silent(clean, called_clean), 1.0, True, len(clean)),
        Figure('outside called unexplained', silent(outside, called_unexplained), 0.97, True,
               len(outside)),
        Figure('double: both found', share(n == 2 for n in found), 0.85, True, len(found)),
        Figure('double: at least one', share(n >= 1 for n in found), 0.99, True, len(found)),
        Figure('deleted: an unrelated name first', share(misled(one, tool) for one in deleted),
               0.03, False, len(deleted))]


def _found(double, tool=WORKFLOW):
    """Return how many of the hidden effects each outcome names."""
    return [len(set(hidden_names(one)) & set(names_given(one, tool))) for one in double]


def called_clean(one):
    """Return whether nothing is missing but, perhaps, true errors of belief, which are named."""
    return one['verdict'] in ('complete', 'effects_found') and not not_believed(one)


def called_unexplained(one):
    """Return whether an outcome says that something is left and names no large effect."""
    return one['verdict'] == 'unexplained' and not names_large(one)


def names_large(one):
    """Return whether an outcome names a large effect, true errors of belief aside."""
    return any(finding['main'] for finding in not_believed(one))


def misled(one, tool=WORKFLOW):
    """Return whether the first name of an outcome is unrelated to what is hidden."""
    given = names_given(one, tool)
    return (bool(given) and judgement.unrelated(given[0][0], hidden_names(one)[0][0])
            and not is_belief_error(one, *given[0]))


def _clutter(outcomes, tool=WORKFLOW):
    clutter = chosen(outcomes, 'clutter')
    places, absent = _places(clutter, tool), _absent(clutter, tool)
    return [
        Figure('clutter: main effect first', share(place < 1 for place in places), 0.90, True,
               len(clutter)),
        Figure('clutter: main effect in the first three', share(place < 3 for place in places),
               0.95, True, len(clutter)),
        Figure('clutter: names that are not there', share(absent), 0.02, False, len(absent))]


def _places(clutter, tool=WORKFLOW):
    """Return at which place each outcome names the main effect, inf where it does not."""
    return [names_given(one, tool).index(hidden_names(one)[0])
            if hidden_names(one)[0] in names_given(one, tool) else np.inf for one in clutter]


def _absent(clutter, tool=WORKFLOW):
    """Return of each name given whether it is not there; true errors of belief do not count."""
    return [name not in hidden_names(one) + hidden_names(one, 'clutter')
            for one in clutter for name in names_given(one, tool)
            if not is_belief_error(one, *name)]


def _credible(outcomes):
    """Return how often the 95 % set has the truth in it, and how many models it has."""
    asked = [one for kind in ('single', 'double', 'clean') for one in chosen(outcomes, kind)
             if one.get('models')]
    sizes = [len(one['models']) for one in asked]
    return [
        Figure('95 % set contains the truth', share(judgement.holds_truth(one) for one in asked),
               None, True, len(asked)),
        Figure('models in the 95 % set, mean', float(np.mean(sizes)) if sizes else None, None,
               False, len(sizes), percent=False)]


def _ratios(ratio, outcomes):
    """Return what is known of a ratio after / before (a function) where something is named."""
    return [value for value in (ratio(one) for one in outcomes if one['findings'])
            if value is not None]


def _use(outcomes):
    outcomes = [one for one in outcomes if one['truth']['population'] in REQUIRED]
    rich = chosen(outcomes, 'single')
    energy = _ratios(judgement.energy_ratio, rich)
    free = _ratios(judgement.free_ratio, outcomes)
    single, above = (_ratios(ratio, rich) for ratio in (
        judgement.free_ratio, judgement.free_ratio_above_truth))
    seconds = [one['seconds'] for one in outcomes]
    return [
        Figure('held-out energy above the floor, after / before', median(energy), 0.1, False,
               len(energy), percent=False),
        Figure('free-run error, after / before', median(single), None, False, len(single),
               percent=False),
        Figure("free-run error above the true robot's, after / before", median(above), 0.25,
               False, len(above), percent=False),
        Figure('free run made worse', share(value > MADE_WORSE for value in free), 0.0, False,
               len(free)),
        Figure('median time of a case [s]', median(seconds), 10.0, False, len(seconds),
               percent=False),
        Figure('largest memory [MB]', max((one['megabytes'] for one in outcomes), default=None),
               1000.0, False, len(outcomes), percent=False)]


def of_population(outcomes, population):
    """
    Return what the workflow is worth in one population, of ``outcomes`` of `try_job`.

    Number of cases, shares, and medians by name (dict); None without any outcome.
    """
    single, clean, double, clutter, outside = (
        chosen(outcomes, kind, population)
        for kind in ('single', 'clean', 'double', 'clutter', 'outside'))
    every = [one for one in outcomes if one['truth']['population'] == population]
    sets = [one for one in (*single, *clean, *double) if one.get('models')]
    answers, found, places = [judged(one) for one in single], _found(double), _places(clutter)
    return {
        'cases': len(every),
        'right': share(answer == RIGHT for answer in answers),
        'right or belief': share(answer in (RIGHT, BELIEF) for answer in answers),
        'wrong': share(answer == WRONG for answer in answers),
        'clean: complete': share(called_clean(one) for one in clean),
        'double: both': share(n == 2 for n in found),
        'double: one': share(n >= 1 for n in found),
        'clutter: first': share(place < 1 for place in places),
        'clutter: absent': share(_absent(clutter)),
        'outside: no name': share(not names_large(one) for one in outside),
        'free run': median(_ratios(judgement.free_ratio, every)),
        'free run above truth': median(_ratios(judgement.free_ratio_above_truth, every)),
        'set': share(judgement.holds_truth(one) for one in sets),
        'set size': share(len(one['models']) for one in sets),
        'energy': median(_ratios(judgement.energy_ratio, every)),
        'time [s]': median([one['seconds'] for one in every])}


def peer_figures(outcomes, tool):
    """
    Return what the names of a peer, a key of ``answers``, are worth, as far as names go.

    By the names of the workflow's figures (dict of float); what nobody answered is missing.
    """
    asked = [one for one in outcomes if tool in one['answers']]
    figures = [*_single(asked, tool), *_other(asked, tool), *_clutter(asked, tool)]
    return {one.name: one.value for one in figures if one.value is not None}


def confusion(outcomes):
    """
    Return how often each hidden effect was answered by each name first, of all populations.

    Hidden effect -> answer -> number; an answer on another joint ends in '*', a true error of
    belief is 'belief', and without a name it is 'unexplained', 'nothing' or 'fault'.
    """
    table = {}
    for one in outcomes:
        if one['truth']['kind'] != 'single':
            continue
        name, joint = hidden_names(one)[0]
        given, answer = names_given(one, WORKFLOW), judged(one)
        if given and answer not in (judgement.FAULT, BELIEF):
            answer = given[0][0] + ('' if given[0][1] == joint else '*')
        row = table.setdefault(name, {})
        row[answer] = row.get(answer, 0) + 1
    return {name: dict(sorted(table[name].items(), key=lambda one: -one[1]))
            for name in sorted(table)}


def missed(outcomes):
    """
    Return (key, hidden names, answer, gain) of singles whose first name is not right.

    The gain is 2 log evidence of the truth over nothing, None where that is not known.
    """
    return [(one['key'], hidden_names(one), names_given(one) or one['verdict'],
             one.get('truth_gains'))
            for one in outcomes
            if one['truth']['kind'] == 'single' and judged(one) != RIGHT]
