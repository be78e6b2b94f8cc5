# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex discrepancy --each`: what each bag says the model lacks, and how many say it."""

from argparse import Namespace
import os
from pathlib import Path
from typing import NamedTuple

from gms_flex_control.cli import each

_FILES = ('robot', 'models', 'controller', 'holdout')  # options that name files


class BagItem(NamedTuple):
    """A bag to be asked, perhaps in another process."""

    place: each.Place
    asked: dict  # options of the verb by name, files as absolute paths


def run_each(args):
    """Ask each bag, write, print; return 1 if one finds something or is bad, else 0."""
    from gms_flex_control.discrepancy.result import COMPLETE
    from gms_flex_control.reports.over_bags import discrepancy_text

    items, asked = items_of(args)
    found = each.run_each(args, ask_bag, items, asked)
    each.write_summary(args, found, discrepancy_text)
    return int(any(values.get('verdict') != COMPLETE for values in found.values()))


def items_of(args):
    """Return the items of a batch by key, and what their results depend on beside the bag."""
    from gms_flex_control.batches.sources import content_of, digest_of, fingerprint
    from gms_flex_control.cli.discrepancy import models_of
    from gms_flex_control.schema.files import load_controller, load_robot

    robot = load_robot(args.robot)  # says now what is wrong with it
    models_of(args, robot)
    if args.controller:
        load_controller(args.controller, robot)
    options = {name: value for name, value in vars(args).items()
               if name not in ('bags', 'out', 'json', 'run', 'verb', 'workers', 'scheduler')}
    for name in _FILES:
        options[name] = [os.path.abspath(path) for path in options[name]]
    files = [(path, content_of(path)) for name in _FILES for path in options[name]]
    asked = f'{fingerprint()} {digest_of((sorted(options.items()), files))}'
    places = each.places_of(args.bags, args.out, asked)
    refuse_own(places.values(), options)
    return {key: BagItem(place, options) for key, place in places.items()}, asked


def refuse_own(places, options):
    """Raise ConfigError if a file that is asked with is one that the results replace."""
    from gms_flex_control.errors import ConfigError
    folders = {place.folder.resolve() for place in places}
    for name in _FILES:
        for file in options[name]:
            if folders & set(Path(file).resolve().parents):
                raise ConfigError(f'{file} lies in the folder of results of a bag, which may '
                                  'replace it; copy it elsewhere, or name another folder as --out')


def ask_bag(item):
    """
    Ask one bag what the model lacks, and write the results.

    Parameters
    ----------
    item : BagItem
        Which, and where to.

    Returns
    -------
    dict
        Verdict, words, effects and ``estimates`` of their parameters as those of
        `identification.over_bags.bag_values`, and ``reason``, None unless the data are bad.

    """
    from gms_flex_control.cli.discrepancy import answered, write_files
    from gms_flex_control.reports.discrepancy_values import over_bags_values

    args = Namespace(**item.asked, bags=[item.place.bag], json=True)
    result, compared, holdout = answered(args)
    with each.whole(item.place) as folder:
        args.out = folder
        write_files(result, compared, holdout, args)
    return over_bags_values(result)
