# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A batch from beginning to end: what the journal lacks is worked on, and kept at once."""

import json

from gms_flex_control.batches.progress import Progress
from gms_flex_control.errors import LostItemError


def run_batch(function, items, *, executor, journal=None, label='', lost=None):
    """
    Call a function for many items.

    Parameters
    ----------
    function : callable
        Of a module; takes one item and returns plain values without NaN (dict, list, str,
        float, bool, None).
    items : dict of str to object
        By a key of their own.
    executor : Executor
        From `executor.open_executor`.
    journal : Journal, optional
        Of finished items; these are not done again.
    label : str
        Of the progress bar, which appears on a terminal only.
    lost : callable, optional
        LostItemError -> what stands for an item that kills its workers; such a value is not
        kept, so that the item is tried again another time. Default: the error ends the batch.

    Returns
    -------
    dict of str to object
        What the function returned, in the order of the items. All of it went through JSON,
        so that it is the same whether it was kept or just found.

    Raises
    ------
    BatchError
        See Executor. Whatever the function raises comes through, and what is finished stays
        in the journal.

    """
    kept = {} if journal is None else journal.outcomes
    found = {key: kept[key]['value'] for key in items if key in kept}
    missing = [key for key in items if key not in found]
    with Progress(len(items), len(found), label) as progress:
        for index, result in executor.finished(function, [items[key] for key in missing]):
            key = missing[index]
            try:
                found[key] = json.loads(json.dumps(result(), allow_nan=False))
            except LostItemError as error:
                if lost is None:
                    raise
                found[key] = lost(error)
            else:
                if journal is not None:
                    journal.add({'key': key, 'value': found[key]})
            progress.step()
    return {key: found[key] for key in items}
