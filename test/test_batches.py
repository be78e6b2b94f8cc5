# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Batches give what a plain loop gives; what goes wrong in a worker ends them in a sentence."""

import io

import batch_items
from gms_flex_control.batches import Progress, run_batch
from gms_flex_control.errors import BatchError, SimulationError
import pytest

ITEMS = {f'walk {seed}': seed for seed in range(6)}


def test_processes_return_what_a_plain_loop_returns():
    kept = {}
    found = run_batch(batch_items.walk, ITEMS, keep=kept.__setitem__)
    assert found == kept == {key: batch_items.walk(seed) for key, seed in ITEMS.items()}
    assert list(found) == list(ITEMS)


@pytest.mark.parametrize(('work', 'items', 'options', 'error', 'sentence'), [
    (batch_items.always_deadly, {'a': 1}, {}, BatchError, 'enough memory'),
    (batch_items.fail, {'a': 0, 'b': 1}, {}, SimulationError, 'diverged'),
    (batch_items.walk, ITEMS, {'workers': 0}, BatchError, '--workers 0')])
def test_what_goes_wrong_ends_in_a_sentence(work, items, options, error, sentence):
    with pytest.raises(error, match=sentence):
        run_batch(work, items, **options)


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True


def test_the_bar_is_drawn_on_a_terminal_only():
    for stream, drawn in ((Terminal(), True), (io.StringIO(), False)):
        with Progress(2, label='runs', stream=stream) as bar:
            bar.step()
            bar.step()
        assert ('runs [##############################] 2/2' in stream.getvalue()) == drawn
        assert bool(stream.getvalue()) == drawn
