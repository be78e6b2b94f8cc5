# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Many bags, each by itself: a folder of its own for each, whole or not there, and a journal."""
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from functools import partial
import os
from pathlib import Path
import shutil
import traceback
from typing import NamedTuple
from uuid import uuid4

from gms_flex_control.batches import (
    content_of,
    digest_of,
    fingerprint,
    Journal,
    open_executor,
    run_batch,
)
from gms_flex_control.cli.terminal import conclude
from gms_flex_control.compiled import alone_in_one_thread
from gms_flex_control.errors import BatchError, ConfigError, GmsFlexError, own_warnings
from gms_flex_control.file_io import as_json, write_json, write_text
from gms_flex_control.identification.output import over_bags
from gms_flex_control.reports.bags_summary import bags_csv, over_bags_answer, spread_csv, summary

MARK = '.gms_flex_each'  # in a folder of results: what they are the results of

ONLY_WITH_EACH = ('--workers and --scheduler divide many bags; add --each, or leave them out: '
                  'bags analysed together are one problem')


class Place(NamedTuple):
    """Where the results of one bag go."""

    bag: str   # path, absolute: a worker may run anywhere
    out: str   # folder of all results, likewise
    name: str  # of the bag's folder in it
    mark: str  # of results of this bag, these sources and these options

    @property
    def folder(self) -> Path:
        """Return the folder of the bag's results."""
        return Path(self.out) / self.name

    @property
    def is_done(self) -> bool:
        """Return whether the folder holds these results, all of them."""
        return _marked(self.folder)[:1] == [self.mark]


def _marked(folder):
    """Return the lines of a folder's mark, whose results it holds and in which files."""
    mark = folder / MARK
    return mark.read_text('utf-8').splitlines() if mark.is_file() else []


def _set_mark(folder, mark, files):
    write_text(folder / MARK, '\n'.join([mark, *sorted(files)]) + '\n')


def names_of(bags) -> dict:
    """
    Return absolute paths of bags by a name that no other bag has.

    It is that of the folder, or of the file without suffix; where two have it in common, with
    the folders above in front, such as ``monday_run`` and ``friday_run``. ConfigError is raised
    if a bag was given twice, or no folder above distinguishes two.
    """
    paths = [os.path.abspath(bag) for bag in bags]
    if again := _twice(paths):
        raise ConfigError(f'{paths[again[-1]]} was given twice; name each bag once')
    names, deepest = [_name(path, 1) for path in paths], max(len(Path(p).parts) for p in paths)
    for depth in range(2, deepest):
        for place in _twice(names):
            names[place] = _name(paths[place], depth)
    if again := _twice(names):
        raise ConfigError(f'{" and ".join(paths[place] for place in again[:2])} would both write '
                          f'their results to {names[again[0]]}; run them separately')
    return dict(zip(names, paths, strict=True))


def _name(path, depth):
    path = Path(path)
    last = path.stem if path.is_file() else path.name
    above = path.parent.parts[1:]
    return '_'.join([*above[max(len(above) - depth + 1, 0):], last])


def _twice(values):
    """Return the indices of values that occur more than once."""
    count = Counter(values)
    return [place for place, value in enumerate(values) if count[value] > 1]


def places_of(bags, out: str, asked: str) -> dict:
    """
    Return the Place of each bag, by a key that changes when the bag does.

    ``out`` is the folder of all results, ``asked`` what they depend on beside the bag.
    ConfigError is raised if two bags have one name, or a folder of that name is somebody else's.
    """
    places = {}
    for name, bag in names_of(bags).items():
        key = f'{name} {digest_of((bag, content_of(bag)))}'
        places[key] = Place(bag, os.path.abspath(out), name, f'{key} {asked}')
    for place in places.values():
        folder = place.folder
        if folder.exists() and not (folder.is_dir() and (
                _marked(folder) or not any(folder.iterdir()))):
            raise ConfigError(f'{folder} exists and holds no results of --each: name another '
                              '--out')
    return places


@contextmanager
def whole(place) -> Generator[Path]:
    """
    Yield a folder to write results into, which then becomes that of the Place.

    Where there was none it appears at once, complete. Results of another run in it are replaced
    file by file, the mark saying so meanwhile; what else lies there stays.
    """
    made = Path(place.out) / f'.{place.name}.{uuid4().hex}.part'
    try:
        made.mkdir()
        yield made
        files = {file.name for file in made.iterdir()}
        _set_mark(made, place.mark, files)
        try:
            made.rename(place.folder)
        except OSError:  # not empty
            _replace_files(made, place, files)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _replace_files(made, place, files):
    old = {Path(name).name for name in _marked(place.folder)[1:]}  # nothing outside the folder
    _set_mark(place.folder, 'unfinished', files | old)
    for name in old - files:
        (place.folder / name).unlink(missing_ok=True)
    for name in files:
        os.replace(made / name, place.folder / name)
    _set_mark(place.folder, place.mark, files)


class BagItem(NamedTuple):
    """A bag to be asked, perhaps in another process."""

    place: Place
    asked: dict  # what the verb was asked for, by name


def items_of(args, asked: dict, depends) -> tuple[dict, str]:
    """
    Return a BagItem for each bag by its key, and what results depend on beside the bag.

    ``depends`` are plain values that change with whatever else results depend on.
    """
    sources = f'{fingerprint()} {digest_of(depends)}'
    return {key: BagItem(place, asked) for key, place in
            places_of(args.bags, args.out, sources).items()}, sources


def run_each(args, function, items: dict, asked: str, text) -> dict:
    """
    Return what a function says of each bag, by name; a bag whose results are there is skipped.

    All bags are then written side by side into --out, and ``text(found, rows)`` is printed.

    ``args`` of the verb has out, workers and scheduler. ``function`` of a module takes an item and
    returns a dict with the key 'reason', None where all went well; what it raises becomes the
    reason, see `reason_or`. ``items`` are by the keys of `places_of`, each with its Place as
    ``place``; ``asked`` as there.
    """
    workers = 2 if args.workers is None else args.workers
    with open_executor(workers, args.scheduler) as executor:
        journal = Journal(args.out, asked)
        for key, item in items.items():
            # a bag that was refused is looked at again: it may have been the disk
            if key in journal.outcomes and not (
                    item.place.is_done and journal.outcomes[key]['value']['reason'] is None):
                del journal.outcomes[key]
        try:
            found = run_batch(partial(reason_or, function), items, executor=executor,
                              journal=journal, label='bags',
                              lost=lambda error: {'reason': str(error)})
        finally:
            for part in Path(args.out).glob(f'.*.{"[0-9a-f]" * 32}.part'):  # of killed workers
                shutil.rmtree(part, ignore_errors=True)
    by_name = {items[key].place.name: values for key, values in found.items()}
    _write_summary(args, by_name, text)
    return by_name


def reason_or(function, item) -> dict:
    """
    Return what a function says of the bag of an item, or why it says nothing, as ``reason``.

    ``warnings`` of reading come before those of the function. BatchError is raised if the folder
    of all results is not visible from here: no bag could be written.
    """
    if not Path(item.place.out).is_dir():
        raise BatchError(f'--out {item.place.out}: a worker of the cluster does not see this '
                         'folder; name one on a disk that all machines share')
    try:
        with alone_in_one_thread(), own_warnings() as caught:
            values = function(item)
        warned = [*(str(one.message) for one in caught), *values.get('warnings', ())]
        return values | {'warnings': list(dict.fromkeys(warned))}
    except (GmsFlexError, OSError) as error:
        return {'reason': str(error)}
    except MemoryError:
        return {'reason': f'{item.place.bag}: not enough memory for so many samples'}
    except Exception as error:  # noqa: B902  one bag of thousands ends no batch
        traceback.print_exc()
        return {'reason': f'an error of the program, please report it: {error!r}'}


def _write_summary(args, found, text):
    """Write all bags side by side into --out; print ``text(found, rows)``."""
    rows = over_bags({name: values for name, values in found.items()
                      if values['reason'] is None})
    values, out = summary(found, rows), Path(args.out)
    write_text(out / 'summary.csv', bags_csv(found))
    write_text(out / 'spread.csv', spread_csv(rows))
    write_json(out / 'summary.json', values)
    print(as_json(values) if args.json else text(found, rows))
    if not args.json:
        conclude(over_bags_answer(found, rows, args.bags), {
            'each bag': out / 'BAG' / 'report.html',
            'all bags': f'{out / "summary.json"}, summary.csv, spread.csv'})
