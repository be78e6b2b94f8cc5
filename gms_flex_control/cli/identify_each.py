# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex identify --each`: every bag by itself, as a batch, and all of them side by side."""

import os
from typing import NamedTuple

from gms_flex_control.cli import each


class BagItem(NamedTuple):
    """A bag to be identified, perhaps in another process."""

    place: each.Place
    robot: object     # RobotParams; None: rigid axes named as in the bag
    joints: tuple     # to take from the bag; empty: all
    holdouts: tuple   # of str, absolute paths
    options: object   # identification.identify.Options


def run_each(args):
    """Identify each bag, write, print; return 1 if one could not be identified, else 0."""
    from gms_flex_control.reports.over_bags import identification_text

    items, asked = items_of(args)
    found = each.run_each(args, identify_bag, items, asked)
    each.write_summary(args, found, identification_text)
    return int(any(values['reason'] is not None for values in found.values()))


def items_of(args):
    """Return the items of a batch by key, and what their results depend on beside the bag."""
    from gms_flex_control.batches.sources import content_of, digest_of, fingerprint
    from gms_flex_control.cli.identify import options_of, robot_of
    from gms_flex_control.schema.build import robot_values

    options = options_of(args)
    robot = None if args.robot is None else robot_of(args)
    holdouts = tuple(os.path.abspath(path) for path in args.holdout)
    joints = tuple(args.joints or ())
    asked = f'{fingerprint()} ' + digest_of((
        robot and robot_values(robot), joints, options,
        [(path, content_of(path)) for path in holdouts]))
    return {key: BagItem(place, robot, joints, holdouts, options)
            for key, place in each.places_of(args.bags, args.out, asked).items()}, asked


def identify_bag(item):
    """
    Identify one bag and write its results.

    Parameters
    ----------
    item : BagItem
        Which, and where to.

    Returns
    -------
    dict
        `identification.over_bags.bag_values`, and why there are none as ``reason``.

    """
    from gms_flex_control.cli.identify import identified, robot_in, write_results
    from gms_flex_control.identification.over_bags import bag_values

    place, described = item.place, item.robot is not None
    robot = item.robot if described else robot_in(place.bag, item.joints)
    found = identified([place.bag], item.holdouts, robot, item.options, described)
    with each.whole(place) as folder:
        write_results(found, folder)
    return {'reason': None, **bag_values(found)}
