# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Many bags, each by itself: a folder of its own for each, and all of them side by side."""

from argparse import Namespace
from collections import Counter
from functools import partial
import math
import os
from pathlib import Path
from textwrap import fill
import traceback

from gms_flex_control import __version__
from gms_flex_control.answer import align, Answer, command, measured
from gms_flex_control.batches import run_batch
from gms_flex_control.cli.terminal import conclude
from gms_flex_control.errors import ConfigError, GmsFlexError, own_warnings
from gms_flex_control.file_io import as_json, write_json
from gms_flex_control.identification.outcome import number, percent
from gms_flex_control.identification.output import is_identified, over_bags


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


_WIDTH = 96
_COLUMNS = 4  # bags beside each other in text, at most
_CLEAR = 2.0  # times the scatter that intervals predict: they differ from bag to bag
_LINES = 20   # bags below each other, at most: the others are in summary.json


def summary(found, rows) -> dict:
    """
    Return all bags and their parameters as plain data.

    ``found`` holds `identification.output.bag_values` and ``reason`` (None, or all there is) by
    the name of the bag, ``rows`` the OverBags of those without a reason.
    """
    return {'format': 1, 'version': __version__,
            'bags': [{'bag': name, **values} for name, values in found.items()],
            'parameters': [{name: None if value != value else value
                            for name, value in row._asdict().items()} for row in rows]}


def identification_text(found, rows) -> str:
    """Return tables of parameters and bags, and in words which differ."""
    good = _good(found)
    parts = [f'{len(good)} of {len(found)} bags identified']
    if rows:
        parts += [_parameters(rows, good), _not_estimated(rows, good), _differing(rows)]
    parts += [_errors(good), _reasons(found, 'NOT IDENTIFIED')]
    return '\n\n'.join(filter(None, parts))


def discrepancy_text(found, rows) -> str:
    """Return a table of effects and their parameters, and the answer of each bag."""
    good = _good(found)
    verdicts = Counter(values['verdict'] for values in good.values())
    parts = [', '.join([f'{len(good)} of {len(found)} bags answered', *(
        f'{verdict} {count}' for verdict, count in verdicts.items())])]
    if rows:
        parts += [_parameters(rows, good), _differing(rows)]
    parts += [_findings(good), _reasons(found, 'BAD DATA')]
    return '\n\n'.join(filter(None, parts))


def over_bags_answer(found, rows, bags) -> Answer:
    """Return what differs most from bag to bag, and which to look at first (Answer)."""
    good = _good(found)
    known = sorted((row for row in rows if row.mean and row.standard_deviation > 0.0),
                   key=lambda row: -row.standard_deviation / abs(row.mean))[:3]
    sentence = f'{len(good)} of {len(found)} bags have an answer'
    if known:
        first = known[0]
        sentence += (f'; {first.name.removeprefix("friction.")} differs most from bag to bag, by '
                     f'{_share(first)} % of its mean (one standard deviation), where the floor is '
                     'what the intervals of single bags predict')
    odd = next((name for name in found if name not in good), None)
    return Answer(f'{sentence}.', ('mean', 'std over bags', 'floor'), tuple(
        measured(f'{row.name.removeprefix("friction.")} [{row.unit}]', row.mean,
                 row.standard_deviation, row.foreseen, scale=1.0) for row in known), command(
        'info', next((bag for bag in bags if Path(bag).name == odd), bags[0])))


def _good(found):
    return {name: values for name, values in found.items() if values['reason'] is None}


def _findings(good):
    """Return what each bag names, of many bags the first; '' without bags."""
    if not good:
        return ''
    lines = [[bag, values['verdict'], ', '.join(
        [*values['effects'], *(f'{one} (minor)' for one in values['minor'])]) or '-']
        for bag, values in list(good.items())[:_LINES]]
    more = f'\nand {len(good) - _LINES} more, see summary.json' if len(good) > _LINES else ''
    return align(['bag', 'verdict', 'effects'], lines) + more


def _parameters(rows, good):
    beside = list(good)[:_COLUMNS] if 1 < len(good) <= _COLUMNS else []
    known = {bag: {one['name']: one['value'] for one in good[bag]['estimates']
                   if is_identified(one)}
             for bag in beside}
    lines = [[row.name.removeprefix('friction.'), row.unit, str(row.bags), number(row.mean),
              number(row.standard_deviation, 2), _share(row), number(row.foreseen, 2),
              *(number(known[bag].get(row.name, math.nan)) for bag in beside)] for row in rows]
    return (align(['parameter', 'unit', 'bags', 'mean', 'std', 'std [%]', 'foreseen', *beside],
                  lines) + '\nbags: those that estimate it; std over the bags; foreseen: std by '
            'their intervals')


def _share(row):
    return number(100.0 * row.standard_deviation / abs(row.mean), 2) if row.mean else '-'


def _not_estimated(rows, good):
    """Return which parameters no bag estimates, '' if there are none."""
    names = dict.fromkeys(one['name'] for values in good.values() for one in values['estimates'])
    left = [name.removeprefix('friction.') for name in names
            if name not in {row.name for row in rows}]
    return fill(f'Estimated by no bag: {", ".join(left)}', _WIDTH) if left else ''


def _differing(rows):
    """Return which parameters differ from bag to bag by far more than intervals foresee."""
    names = [row.name.removeprefix('friction.') for row in rows
             if row.standard_deviation > _CLEAR * row.foreseen]
    return fill(f'Differ from bag to bag by more than {_CLEAR:g} times what the intervals '
                f'predict: {", ".join(names)}', _WIDTH) if names else ''


def _first(lines, file):
    """Return lines, of many the first and where the others are."""
    more = [f'and {len(lines) - _LINES} more, see {file}'] if len(lines) > _LINES else []
    return '\n'.join(lines[:_LINES] + more)


def _errors(good):
    """Return the held-out errors of bags, of many those of the first."""
    shown = list(good)[:_LINES]
    if not shown:
        return ''
    lines = [[bag, joint, _percent(error), _percent(good[bag]['coulomb_viscous'][joint])]
             for bag in shown for joint, error in good[bag]['held_out'].items()]
    table = align(['bag', 'joint', 'torque', 'C+v'], lines)
    return f'Torque error on held-out data; C+v: of Coulomb + viscous friction alone\n{table}'


def _percent(share):
    return '-' if share is None else percent(share)


def _reasons(found, heading):
    """Return a sentence for each bag that says nothing, '' if none."""
    return _first([fill(f'{heading} {name}: {values["reason"]}', _WIDTH, subsequent_indent='    ',
                        break_long_words=False, break_on_hyphens=False)
                   for name, values in found.items() if values['reason'] is not None],
                  'summary.json')
