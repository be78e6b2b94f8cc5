# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The figures of the bench: counts and medians over outcomes, beside what is required."""

from typing import NamedTuple

from gms_flex_control.benchmarks.hidden_effects import judgement
from gms_flex_control.benchmarks.hidden_effects.judgement import (
    hidden_names,
    judged,
    names_given,
    RIGHT,
    WRONG,
)
from gms_flex_control.benchmarks.hidden_effects.outcome import WORKFLOW
import numpy as np

MADE_WORSE = 1.01  # free-run error after / before that counts as worse


class Figure(NamedTuple):
    """
    One line of the table.

    Parameters
    ----------
    name : str
        What it is.
    value : float or None
        Share, median or number; None where no outcome tells.
    required : float or None
        What it must reach; None if it is only told.
    at_least : bool
        Whether more is better.
    count : int
        Outcomes it is taken over.
    percent : bool
        How it is shown.

    """

    name: str
    value: float | None
    required: float | None
    at_least: bool
    count: int
    percent: bool = True

    @property
    def met(self):
        """Return whether it is reached; None where no outcome tells or nothing is required."""
        if self.value is None or self.required is None:
            return None
        return self.value >= self.required if self.at_least else self.value <= self.required


def chosen(outcomes, kind, motion='rich', plant=None):
    """Return the outcomes of a kind and motion, of one plant or of all."""
    return [one for one in outcomes
            if one['truth']['kind'] == kind and one['truth']['motion'] == motion
            and plant in (None, one['truth']['plant'])]


def share(flags):
    """Return the share of true ones, None of nothing."""
    flags = list(flags)
    return float(np.mean(flags)) if flags else None


def median(values):
    """Return the median of what is known, None of nothing."""
    values = [value for value in values if value is not None]
    return float(np.median(values)) if values else None


def figures_of(outcomes):
    """
    Return the figures of the workflow.

    Parameters
    ----------
    outcomes : sequence of dict
        Of `outcome.try_job`.

    Returns
    -------
    list of Figure

    """
    return [*_single(outcomes), *_other(outcomes), *_clutter(outcomes), *_use(outcomes)]


def _single(outcomes):
    rich = chosen(outcomes, 'single')
    paper = chosen(outcomes, 'single', 'sinusoid') + chosen(outcomes, 'single', 'polynomial')
    stiff = chosen(outcomes, 'single', plant='stiff')
    errors = [judgement.parameter_error(one) for one in rich if judged(one) == RIGHT]
    return [
        Figure('right name, first place', share(judged(one) == RIGHT for one in rich), 0.96,
               True, len(rich)),
        Figure('wrong name', share(judged(one) == WRONG for one in rich), 0.005, False,
               len(rich)),
        Figure("the paper's motions: right name", share(judged(one) == RIGHT for one in paper),
               0.93, True, len(paper)),
        Figure('stiff plant: right name', share(judged(one) == RIGHT for one in stiff), 0.95,
               True, len(stiff)),
        Figure('median parameter error', median(errors), 0.015, False, len(errors))]


def _other(outcomes):
    clean, outside = chosen(outcomes, 'clean'), chosen(outcomes, 'outside')
    double, deleted = chosen(outcomes, 'double'), chosen(outcomes, 'deleted')
    found = [len(set(hidden_names(one)) & set(names_given(one))) for one in double]
    return [
        Figure('clean called clean', share(called_clean(one) for one in clean), 1.0, True,
               len(clean)),
        Figure('outside called unexplained', share(called_unexplained(one) for one in outside),
               0.97, True, len(outside)),
        Figure('double: both found', share(n == 2 for n in found), 0.85, True, len(double)),
        Figure('double: at least one', share(n >= 1 for n in found), 0.99, True, len(double)),
        Figure('deleted: an unrelated name first', share(misled(one) for one in deleted), 0.03,
               False, len(deleted))]


def called_clean(one):
    """Return whether an outcome names nothing and says that nothing is missing."""
    return one['verdict'] == 'complete' and not one['findings']


def called_unexplained(one):
    """Return whether an outcome says that something is left and names no large effect."""
    return one['verdict'] == 'unexplained' and not any(f['main'] for f in one['findings'])


def misled(one):
    """Return whether the first name of an outcome is unrelated to what is hidden."""
    given = names_given(one)
    return bool(given) and judgement.unrelated(given[0][0], hidden_names(one)[0][0])


def _clutter(outcomes):
    clutter = chosen(outcomes, 'clutter')
    given = [name in hidden_names(one) + hidden_names(one, 'clutter')
             for one in clutter for name in names_given(one)]
    places = [names_given(one).index(hidden_names(one)[0])
              if hidden_names(one)[0] in names_given(one) else np.inf for one in clutter]
    return [
        Figure('clutter: main effect first', share(place < 1 for place in places), 0.90, True,
               len(clutter)),
        Figure('clutter: main effect in the first three', share(place < 3 for place in places),
               0.95, True, len(clutter)),
        Figure('clutter: names that are not there', None if not given else 1.0 - share(given),
               0.02, False, len(given))]


def _use(outcomes):
    rich = chosen(outcomes, 'single')
    energy = [judgement.energy_ratio(one) for one in rich if one['findings']]
    free = [value for value in (judgement.free_ratio(one) for one in outcomes
                                if one['findings']) if value is not None]
    single = [value for value in (judgement.free_ratio(one) for one in rich
                                  if one['findings']) if value is not None]
    seconds = [one['seconds'] for one in outcomes]
    return [
        Figure('held-out energy above the floor, after / before', median(energy), 0.1, False,
               len(energy), percent=False),
        Figure('free-run error, after / before', median(single), 0.25, False, len(single),
               percent=False),
        Figure('free run made worse', share(value > MADE_WORSE for value in free), 0.0, False,
               len(free)),
        Figure('named, but withheld from the model', share(
            bool(one.get('withheld')) for one in outcomes if one['findings']), None, False,
               sum(bool(one['findings']) for one in outcomes)),
        Figure('median time of a case [s]', median(seconds), 10.0, False, len(seconds),
               percent=False),
        Figure('largest memory [MB]', max((one['megabytes'] for one in outcomes), default=None),
               1000.0, False, len(outcomes), percent=False)]


def peer_figures(outcomes, tool):
    """
    Return what a peer's names are worth, as far as names go.

    Parameters
    ----------
    outcomes : sequence of dict
        Of `outcome.try_job`.
    tool : str
        Key of ``answers``.

    Returns
    -------
    dict of str to float
        By the names of the workflow's figures; what nobody answered is missing.

    """
    asked = [one for one in outcomes if tool in one['answers']]
    figures, rich = {}, chosen(asked, 'single')
    paper = chosen(asked, 'single', 'sinusoid') + chosen(asked, 'single', 'polynomial')
    stiff, clutter = chosen(asked, 'single', plant='stiff'), chosen(asked, 'clutter')
    double, given = chosen(asked, 'double'), []
    found = [len(set(hidden_names(one)) & set(names_given(one, tool))) for one in double]
    for one in clutter:
        there = hidden_names(one) + hidden_names(one, 'clutter')
        given += [name not in there for name in names_given(one, tool)]
    figures['right name, first place'] = share(judged(one, tool) == RIGHT for one in rich)
    figures['wrong name'] = share(judged(one, tool) == WRONG for one in rich)
    figures["the paper's motions: right name"] = share(
        judged(one, tool) == RIGHT for one in paper)
    figures['stiff plant: right name'] = share(judged(one, tool) == RIGHT for one in stiff)
    figures['clean called clean'] = share(
        not names_given(one, tool) for one in chosen(asked, 'clean'))
    figures['outside called unexplained'] = share(
        not names_given(one, tool) for one in chosen(asked, 'outside'))
    figures['double: both found'] = share(n == 2 for n in found)
    figures['double: at least one'] = share(n >= 1 for n in found)
    figures['clutter: main effect first'] = share(
        hidden_names(one)[0] in names_given(one, tool)[:1] for one in clutter)
    figures['clutter: main effect in the first three'] = share(
        hidden_names(one)[0] in names_given(one, tool)[:3] for one in clutter)
    figures['clutter: names that are not there'] = share(given)
    return {name: value for name, value in figures.items() if value is not None}


def confusion(outcomes):
    """
    Return how often each hidden effect was answered by each name first.

    Parameters
    ----------
    outcomes : sequence of dict
        Of `outcome.try_job`; singles of all motions count.

    Returns
    -------
    dict of str to dict of str to int
        Hidden effect -> answer -> number; an answer on another joint ends in '*', and without a
        name it is 'unexplained', 'nothing' or 'fault'.

    """
    table = {}
    for one in outcomes:
        if one['truth']['kind'] != 'single':
            continue
        name, joint = hidden_names(one)[0]
        given, answer = names_given(one, WORKFLOW), judged(one)
        if given and answer != judgement.FAULT:
            answer = given[0][0] + ('' if given[0][1] == joint else '*')
        row = table.setdefault(name, {})
        row[answer] = row.get(answer, 0) + 1
    return {name: dict(sorted(table[name].items(), key=lambda one: -one[1]))
            for name in sorted(table)}


def missed(outcomes):
    """
    Return (key, hidden names, answer, gain) of singles whose first name is not right.

    The gain is what the truth would have gained, None where that is not known.
    """
    return [(one['key'], hidden_names(one), names_given(one) or one['verdict'],
             one.get('truth_gains'))
            for one in outcomes
            if one['truth']['kind'] == 'single' and judged(one) != RIGHT]
