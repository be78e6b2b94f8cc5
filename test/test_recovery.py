# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Trials of a recovery: what is counted, and the journal that lets a long run go on."""

from gms_flex_control.cli.recover import missed_of, table
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.recovery import recovered, Trial
from gms_flex_control.identification.result import Estimate, Interval
from gms_flex_control.identification.trial_journal import TrialJournal
import pytest

SETTINGS = {'rate': 500.0, 'plan': 'abc'}


def trial(seed, value, *, curve=0.01, flags=()):
    """Return a Trial of one parameter whose truth is 1 and whose intervals are +-0.1."""
    around = Interval(value - 0.1, value + 0.1)
    estimate = Estimate('friction.joint1.forward.static', 'N m', value, around, around, flags, '')
    return Trial(seed, ((estimate, 1.0),), (6,), (curve,), 1.0)


def test_intervals_that_hold_the_truth_are_counted():
    """Of estimates 0.95, 1.02 and 1.3 two are within 0.1 of the truth, the worst 30 % off."""
    row, = recovered([trial(0, 0.95), trial(1, 1.02), trial(2, 1.3, flags=('not identifiable',))])
    assert (row.covered, row.bootstrap, row.flagged) == pytest.approx((2 / 3, 2 / 3, 1 / 3))
    assert (row.middle, row.worst) == pytest.approx((1.02, 0.3))
    assert '67 %' in table([row])


def test_what_is_asked_and_missed_is_said():
    """Static friction may be 3 % off and the presliding curve 2 %."""
    trials = [trial(0, 1.05, curve=0.03)]
    missed = missed_of(recovered(trials), trials)
    assert missed == ['friction.joint1.forward.static: 5.0 % off, asked 3 %',
                      'presliding curve: 3.0 % of F_s off, asked 2 %']
    assert missed_of(recovered([trial(0, 1.02)]), [trial(0, 1.02)]) == []


def test_a_journal_gives_back_its_trials_and_lacks_a_line_cut_off(tmp_path):
    """What was finished is there again, intervals and flags included."""
    path = tmp_path / 'a' / 'trials.jsonl'
    journal = TrialJournal(path, SETTINGS)
    trials = [trial(3, 0.9, flags=('at bound',)), trial(1, 1.1)]
    for one in trials:
        journal.add(one)
    path.write_text(path.read_text() + '{"seed": 4, "estim')
    again = TrialJournal(path, SETTINGS)
    assert again.trials == {3: trials[0], 1: trials[1]}
    assert recovered(again.trials.values()) == recovered(trials)


@pytest.mark.parametrize('content, message', [
    ('{"rate": 100.0, "plan": "abc"}\n', 'other settings'),
    ('hello', 'is no journal'), ('{"rate": 500.0, "plan": "abc"}\n[]\n', 'is no journal')])
def test_a_file_that_is_no_journal_of_these_trials_is_refused(tmp_path, content, message):
    """The sentence names the file and the way out."""
    path = tmp_path / 'trials.jsonl'
    path.write_text(content)
    with pytest.raises(IdentificationError, match=f'trials.jsonl: .*{message}.*name another file'):
        TrialJournal(path, SETTINGS)
