# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Many bags, each by itself: a folder of its own for each, whole or not there, and a journal."""

from collections import Counter
from contextlib import contextmanager
import os
from pathlib import Path
import shutil
from typing import NamedTuple
from uuid import uuid4

MARK = '.gms_flex_each'  # in a folder of results: what they are the results of
_UNFINISHED = 'unfinished'


class Place(NamedTuple):
    """Where the results of one bag go."""

    bag: str   # path, absolute: a worker may run anywhere
    out: str   # folder of all results, likewise
    name: str  # of the bag's folder in it
    mark: str  # tells results of this bag, these sources and these options from others

    @property
    def folder(self):
        """Return the folder of the bag's results."""
        return Path(self.out) / self.name

    @property
    def is_done(self):
        """Return whether the folder holds these results, all of them."""
        return _mark_in(self.folder) == self.mark


def _mark_in(folder):
    mark = folder / MARK
    return mark.read_text('utf-8') if mark.is_file() else None


def names_of(bags):
    """
    Return a name for each bag that no other bag has.

    Parameters
    ----------
    bags : sequence of str
        Paths.

    Returns
    -------
    dict of str to str
        Absolute paths by name: that of the folder, or of the file without suffix; where two have
        it in common, with the folders above in front, such as ``monday_run`` and ``friday_run``.

    Raises
    ------
    ConfigError
        If a bag was given twice, or no folder above tells two apart.

    """
    from gms_flex_control.errors import ConfigError
    paths = [os.path.abspath(bag) for bag in bags]
    if again := _twice(paths):
        raise ConfigError(f'{paths[again[-1]]} was given twice; name each bag once')
    names, deepest = [_name(path, 1) for path in paths], max(len(Path(p).parts) for p in paths)
    for depth in range(2, deepest):
        for place in _twice(names):
            names[place] = _name(paths[place], depth)
    if again := _twice(names):
        raise ConfigError(f'{" and ".join(paths[place] for place in again[:2])} would both have '
                          f'their results in {names[again[0]]}; identify them apart')
    return dict(zip(names, paths, strict=True))


def _name(path, depth):
    path = Path(path)
    last = path.stem if path.is_file() else path.name
    above = path.parent.parts[1:]
    return '_'.join([*above[max(len(above) - depth + 1, 0):], last])


def _twice(values):
    """Return the places of values that stand elsewhere as well."""
    count = Counter(values)
    return [place for place, value in enumerate(values) if count[value] > 1]


def places_of(bags, out, asked):
    """
    Return where the results of each bag go, by a key that changes when the bag does.

    Parameters
    ----------
    bags : sequence of str
        Paths.
    out : str
        Folder of all results.
    asked : str
        What results depend on beside the bag.

    Returns
    -------
    dict of str to Place

    Raises
    ------
    ConfigError
        If two bags cannot be told apart, or a folder of that name is somebody else's.

    """
    from gms_flex_control.batches.sources import content_of, digest_of
    places = {}
    for name, bag in names_of(bags).items():
        key = f'{name} {digest_of((bag, content_of(bag)))}'
        places[key] = Place(bag, os.path.abspath(out), name, f'{key} {asked}')
    for place in places.values():
        _refuse_foreign(place.folder)
    return places


def _refuse_foreign(folder):
    from gms_flex_control.errors import ConfigError
    if folder.exists() and not (folder.is_dir() and (
            _mark_in(folder) is not None or not any(folder.iterdir()))):
        raise ConfigError(f'{folder} exists and holds no results of --each: name another --out')


@contextmanager
def whole(place):
    """
    Yield a folder to write results into, which then becomes that of the Place.

    Where there was none it appears at once, complete. Results of another run in it are replaced
    file by file, the mark saying so meanwhile; what else lies there stays.
    """
    made = Path(place.out) / f'.{place.name}.{uuid4().hex}.part'
    try:
        made.mkdir()
        yield made
        (made / MARK).write_text(place.mark, 'utf-8')
        try:
            made.rename(place.folder)
        except OSError:  # not empty
            _replace_files(made, place.folder)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _replace_files(made, folder):
    (folder / MARK).write_text(_UNFINISHED, 'utf-8')
    for file in sorted(made.iterdir(), key=lambda file: file.name == MARK):
        os.replace(file, folder / file.name)


def remove_parts(out):
    """Remove what workers that were killed had begun to write."""
    for part in Path(out).glob(f'.*.{"[0-9a-f]" * 32}.part'):
        shutil.rmtree(part, ignore_errors=True)


def run_each(args, function, items, asked):
    """
    Return what a function says of each bag; a bag whose results are there is not done again.

    Parameters
    ----------
    args : Namespace
        Of the verb: out, workers, scheduler.
    function : callable
        Of a module; takes an item, returns a dict with the key 'reason', None where all went well.
    items : dict of str to object
        By the keys of `places_of`, each with its Place as ``place``.
    asked : str
        As `places_of`.

    Returns
    -------
    dict of str to dict
        By the names of the bags, in their order.

    """
    from gms_flex_control.batches.batch import run_batch
    from gms_flex_control.batches.executor import open_executor
    from gms_flex_control.batches.journal import Journal
    workers = 2 if args.workers is None else args.workers
    with open_executor(workers, args.scheduler) as executor:
        journal = Journal(args.out, asked)
        for key, item in items.items():
            # a bag that was refused is looked at again: it may have been the disk
            if key in journal.outcomes and not (
                    item.place.is_done and journal.outcomes[key]['value']['reason'] is None):
                del journal.outcomes[key]
        try:
            found = run_batch(function, items, executor=executor, journal=journal, label='bags')
        finally:
            remove_parts(args.out)
    return {items[key].place.name: values for key, values in found.items()}
