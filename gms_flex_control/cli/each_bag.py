# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Many bags, each by itself: a folder of its own for each, and all of them side by side."""

from argparse import Namespace
from collections import Counter
from functools import partial
import os
from pathlib import Path
import traceback

from gms_flex_control.batches import run_batch
from gms_flex_control.cli.terminal import conclude
from gms_flex_control.errors import ConfigError, GmsFlexError, own_warnings
from gms_flex_control.file_io import as_json, write_json
from gms_flex_control.identification.output import over_bags
from gms_flex_control.reports.bags_summary import over_bags_answer, summary


def names_of(bags) -> dict:
    """
    Return bags by a name that no other bag has: its path below the folder all have in common.

    Parts are joined, such as ``monday_run`` and ``friday_run``, without the suffix of a file.
    ConfigError is raised if two bags have one name.
    """
    paths = [Path(os.path.abspath(bag)) for bag in bags]
    above = os.path.commonpath([path.parent for path in paths])
    names = ['_'.join((path.with_suffix('') if path.is_file() else path).relative_to(above).parts)
             for path in paths]
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise ConfigError(f'two bags would both write their results to {name}; name each bag '
                          'once, and rename those of one name')
    return dict(zip(names, bags, strict=True))


def run_each(args, function, text) -> dict:
    """
    Return what a function says of each bag, by name, and write all side by side into --out.

    ``args`` are those of a verb. ``function`` of a module takes them as if this bag and its
    folder in --out had been named alone, and returns a dict; 'reason' is added, None where all
    went well, else what was raised. ``text(found, rows)`` is printed.
    """
    asked, out = {key: value for key, value in vars(args).items()
                  if key not in ('run', 'ranges')}, Path(args.out)
    items = {name: Namespace(**asked | {'bags': [bag], 'out': out / name, 'json': True})
             for name, bag in names_of(args.bags).items()}
    for item in items.values():
        if item.out.resolve() == Path(item.bags[0]).resolve():
            raise ConfigError(f'--out {out}: the results of a bag would be written into the bag; '
                              'name another folder')
    found = run_batch(partial(reason_or, function), items, args.workers, 'bags')
    rows = over_bags({name: values for name, values in found.items()
                      if values['reason'] is None})
    values = summary(found, rows)
    write_json(out / 'summary.json', values)
    print(as_json(values) if args.json else text(found, rows))
    if not args.json:
        conclude(over_bags_answer(found, rows, args.bags), {
            'each bag': out / 'BAG' / 'report.html', 'all bags': out / 'summary.json'})
    return found


def reason_or(function, args) -> dict:
    """
    Return what a function says of a bag, or why it says nothing, as ``reason``.

    ``warnings`` of reading come before those of the function.
    """
    try:
        with own_warnings() as caught:
            values = function(args)
        warned = [*(str(one.message) for one in caught), *values.get('warnings', ())]
        return {'reason': None} | values | {'warnings': list(dict.fromkeys(warned))}
    except (GmsFlexError, OSError) as error:
        return {'reason': str(error)}
    except MemoryError:
        return {'reason': f'{args.bags[0]}: not enough memory for so many samples'}
    except Exception as error:  # noqa: B902  one bag of thousands ends no batch
        traceback.print_exc()
        return {'reason': f'an error of the program, please report it: {error!r}'}
