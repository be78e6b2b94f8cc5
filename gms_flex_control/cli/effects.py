# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex effects`: the catalogue of effects with their parameters."""

import json


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'effects', help='the effects a robot file can have, with their parameters',
        description='List the effects of the catalogue: what each is, how to write it in a robot '
                    'file, and its parameters with their units. With names, only those effects.')
    parser.add_argument('names', nargs='*', metavar='EFFECT', help='default: all of them')
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.set_defaults(run=run)


def run(args):
    """Print the effects; return 0."""
    from gms_flex_control.effects import registry

    found = [_entry(registry.find(name)) for name in args.names or registry.names()]
    if args.json:
        print(json.dumps(found, indent=2))
        return 0
    for entry in found:
        print(f'{entry["name"]}: {entry["what"]}')
        for one in entry['parameters']:
            print(f'    {one["key"]}  [{one["unit"]}]  {one["meaning"]}')
    return 0


def _entry(kind):
    """Return what is printed of an effect class, dict."""
    from gms_flex_control.effects import registry

    place = 'arm' if kind.whole_arm else '<joint>'
    return {'name': kind.name, 'what': registry.in_words(kind.name),
            'parameters': [{'key': f'effects.{place}.{kind.name}.{one.name}', 'unit': one.unit,
                            'meaning': one.description, 'lower': _number(one.lower),
                            'upper': _number(one.upper)} for one in kind.parameters]}


def _number(bound):
    """Return a bound for JSON, which has no infinity."""
    return bound if abs(bound) < float('inf') else None
