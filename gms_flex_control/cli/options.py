# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Options that verbs share, and how a verb of the table becomes a parser."""

from argparse import RawDescriptionHelpFormatter
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
import gc
from importlib import import_module
import sys
import textwrap
from typing import NamedTuple

from gms_flex_control.errors import ConfigError

_WIDTH = 79


class Option(NamedTuple):
    """One argument of a verb; see `option`."""

    names: tuple
    settings: dict      # of ArgumentParser.add_argument
    least: float | None
    most: float | None
    completer: object


class OneOf(NamedTuple):
    """Options of which exactly one is given."""

    options: tuple


class Verb(NamedTuple):
    """A verb of the tool."""

    name: str
    run: str | Callable  # takes the arguments; or 'module.function' below gms_flex_control.cli
    summary: str
    description: str
    options: tuple       # of Option or OneOf
    examples: tuple      # of str, without the name of the tool


def option(*names: str, least: float | None = None, most: float | None = None,
           completer=None, **settings) -> Option:
    """
    Return an argument of a verb, ``names`` and ``settings`` as of ``ArgumentParser.add_argument``.

    ``least`` and ``most`` are the closed range of a number, or of each of several; ``completer``
    returns what argcomplete offers, which offers files otherwise.
    """
    return Option(names, settings, least, most, completer)


def number(name: str, metavar: str, default: float, what: str, least: float | None = None,
           most: float | None = None) -> Option:
    """Return an option with a number; its help says ``what`` and the default."""
    return option(name, least=least, most=most, type=float, default=default, metavar=metavar,
                  help=f'{what} (default: %(default)g)')


ROBOT = option('--robot', nargs='+', metavar='FILE',
               help='robot files, later ones winning, such as robot.yaml friction.yaml; default: '
                    'the arm of the paper')
CONTROLLER = option('--controller', nargs='+', metavar='FILE',
                    help='controller files, such as of gms_flex tune; default: the gains of the '
                         'paper')
BAG = option('bag', help='bag folder or file (mcap or sqlite3, plain or zstd)')
LINKS = option('--joints', nargs='+', metavar='NAME', help='link names in the bags')
MOTORS = option('--motors', nargs='+', metavar='NAME', help='motor names in the bags')
OUT_FILE = option('--out', metavar='FILE', help='default: print it')
FORCE = option('--force', action='store_true', help='go on in spite of faults in the data')
WIDEN = option('--widen', type=float, default=1.0, metavar='TIMES', least=1e-6, most=100.0,
               help='standard deviations of known parameters, as a multiple of the usual ones: '
                    '1.5 %% of inertia and stiffness, 2 %% of friction (default: 1)')
JSON = option('--json', action='store_true', help='print the result as JSON instead of text')
WORKERS = option('--workers', type=int, default=2, metavar='N', least=1,
                 help='processes of this machine (default: 2)')
SEED = option('--seed', type=int, default=0, metavar='N', least=0,
              help='of the random numbers (default: 0)')


def out_folder(what: str, default: str | None = None) -> Option:
    """Return the option --out of a folder that holds ``what``, required without a default."""
    if default is None:
        return option('--out', required=True, metavar='DIR', help=what)
    return option('--out', default=default, metavar='DIR', help=f'{what} (default: {default})')


def add_options(parser, options) -> None:
    """Add Options and OneOfs to a parser or group."""
    for one in options:
        if isinstance(one, OneOf):
            add_options(parser.add_mutually_exclusive_group(required=True), one.options)
            continue
        action = parser.add_argument(*one.names, **one.settings)
        if one.completer is not None:
            action.completer = one.completer
        if one.least is not None or one.most is not None or one.settings.get('type') is float:
            parser.set_defaults(ranges=(*(parser.get_default('ranges') or ()), (action, one)))


def add_verb(verb: Verb, subparsers) -> None:
    """Add the parser of a verb, which imports the verb's module when it runs."""
    parser = subparsers.add_parser(verb.name, help=verb.summary, description=verb.description)
    add_options(parser, verb.options)
    parser.set_defaults(run=partial(_run, verb.run))


def _run(place, args):
    for action, one in getattr(args, 'ranges', ()):
        _require_range(action.option_strings[0], getattr(args, action.dest), one.least, one.most)
    verb = place
    if isinstance(place, str):
        module, _, function = place.partition('.')
        verb = getattr(_imported(f'gms_flex_control.cli.{module}'), function)
    with _compiling_announced():
        return verb(args)


def _imported(name):
    """Return a module; of what libraries make on import nothing goes, so garbage is not sought."""
    if name not in sys.modules and gc.isenabled():
        gc.disable()
        try:
            import_module(name)
            gc.freeze()
        finally:
            gc.enable()
    return import_module(name)


@contextmanager
def _compiling_announced():
    """Say once, on a terminal, that inner loops are compiled meanwhile, where they are."""
    if 'numba' not in sys.modules or not sys.stderr.isatty():
        yield
        return
    from numba.core import event

    class Listener(event.Listener):
        said = False

        def on_start(self, _):
            if not self.said:
                print('compiling the inner loops for this machine (once after an installation, up '
                      'to two minutes)', file=sys.stderr, flush=True)
            self.said = True

        def on_end(self, _):
            pass

    with event.install_listener('numba:compile', Listener()):
        yield


def _require_range(name, value, least, most):
    """Raise ConfigError unless a number, or each of several, is in its range and finite."""
    for number in value if isinstance(value, (list, tuple)) else [value]:
        if number is None:
            continue
        if (not float('-inf') < number < float('inf') or least is not None and number < least
                or most is not None and number > most):
            allowed = ' and '.join([*([f'at least {least:g}'] if least is not None else []),
                                    f'at most {most:g}' if most is not None else 'finite'])
            raise ConfigError(f'{name} {number:g}: must be {allowed}')


def add_examples(parsers: dict, examples: dict) -> None:
    """Put examples, commands by verb, at the end of the help of verbs; parsers by verb."""
    for name, parser in parsers.items():
        lines = [line for example in examples.get(name, ()) for line in _broken(example)]
        if lines:
            parser.description = textwrap.fill(parser.description, _WIDTH)
            parser.epilog = '\n'.join(['examples:', *(f'  {line}' for line in lines)])
            parser.formatter_class = RawDescriptionHelpFormatter


def _broken(example):
    """Return a command in lines that a shell takes as they are."""
    lines = textwrap.wrap(example, _WIDTH - 4, subsequent_indent='    ', break_on_hyphens=False,
                          break_long_words=False)
    return [f'{line} \\' for line in lines[:-1]] + lines[-1:]
