# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
# PYTHON_ARGCOMPLETE_OK
"""The tool `gms_flex`: its verbs, one sentence per error, exit codes 0, 1, 2, 70 and 130."""

import argparse
from contextlib import contextmanager
import errno
from itertools import chain
import os
import signal
import sys
from textwrap import fill
from threading import current_thread, main_thread, Timer
import traceback
import warnings

from gms_flex_control import __version__
from gms_flex_control.cli.options import add_examples, add_verb
from gms_flex_control.cli.verbs import GROUPS
from gms_flex_control.errors import did_you_mean, GmsFlexError, nearest

OK, FINDING_SAYS_NO, BAD_INPUT = 0, 1, 2
_LATER = 0.02  # that a signal comes again [s]
INTERRUPTED = 130  # as a shell reports SIGINT
OWN_ERROR = 70  # EX_SOFTWARE of sysexits.h: never taken for a finding
VERBS = tuple(verb.name for verb in chain.from_iterable(GROUPS.values()))


class _Verbs:
    """Take the parsers of verbs, and keep their help for the groups."""

    def __init__(self, subparsers):
        self._subparsers, self.help = subparsers, {}

    def add_parser(self, name, **options) -> argparse.ArgumentParser:
        self.help[name] = options.pop('help')
        return self._subparsers.add_parser(name, **options)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with all verbs."""
    parser = parser_of(
        'gms_flex', 'Simulate, record, analyse and compensate friction in robots with flexible '
        'joints.',
        {title: {verb.name: lambda verbs, verb=verb: add_verb(verb, verbs) for verb in group}
         for title, group in GROUPS.items()},
        {verb.name: [one if one.startswith('eval') else f'gms_flex {one}' for one in verb.examples]
         for verb in chain.from_iterable(GROUPS.values())})
    parser.usage = 'gms_flex [-h] [--version] VERB ...'
    parser.add_argument('--version', action='version', version=__version__)
    return parser


def parser_of(prog: str, description: str, groups: dict,
              examples: dict) -> argparse.ArgumentParser:
    """
    Return the parser of a tool, with ``verbs``, a dict of str to the ArgumentParser of each.

    ``groups`` has by title and verb what adds its parser to an object with ``add_parser``,
    ``examples`` commands by verb.
    """
    parser = argparse.ArgumentParser(
        prog=prog, usage=f'{prog} [-h] VERB ...', description=fill(description, 79),
        formatter_class=argparse.RawDescriptionHelpFormatter)
    subparsers = parser.add_subparsers(dest='verb', required=True, prog=prog,
                                       help=argparse.SUPPRESS)
    verbs = _Verbs(subparsers)
    for add in chain.from_iterable(group.values() for group in groups.values()):
        add(verbs)
    parser.verbs = subparsers.choices
    add_examples(parser.verbs, examples)
    parser.epilog = _listing(prog, groups, verbs.help)
    return parser


def _listing(prog, groups, helps):
    width = max(map(len, helps)) + 2
    lines = []
    for title, verbs in groups.items():
        lines += [f'verbs {title}:', *(f'  {name:<{width}}{helps[name]}' for name in verbs), '']
    return '\n'.join([*lines, f'{prog} VERB --help has options and examples.',
                      'Exit codes: 0 done, 1 a finding says no, 2 bad input, 70 a program error, '
                      '130 interrupted by Ctrl-C.'])


def _parsed(parser, argv):
    """Return the arguments; None after the help, which the bare command prints."""
    if not argv:
        parser.print_help()
        return None
    if not argv[0].startswith('-') and argv[0] not in parser.verbs:
        parser.error(f'there is no verb {argv[0]!r}{did_you_mean(argv[0], parser.verbs)}')
    args, unknown = _known(parser, argv)
    if unknown:
        parser.verbs[args.verb].error(f'unrecognized arguments: {" ".join(unknown)}')
    args.command = f'{parser.prog} {args.verb}'
    return args


def _known(parser, argv):
    """Return the arguments, and words that are not; end at an option that the verb lacks."""
    verb = parser.verbs.get(argv[0])
    options = () if verb is None else tuple(verb._option_string_actions)
    for word in argv[1:argv.index('--') if '--' in argv else None]:
        name = word.partition('=')[0]
        if options and name.startswith('--') and not any(
                known.startswith(name) for known in options):
            verb.error(f'there is no option {name}{nearest(name, options)}')
    return parser.parse_known_args(argv)


def main(argv: list | None = None, prog: str = 'gms_flex', build=build_parser) -> int:
    """Run a verb of ``build()`` with arguments, default those given; return the exit code."""
    with _noted_interrupts() as seen:
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])  # see launch_parts
            parser = build()
            _complete(parser)
            args = _parsed(parser, sys.argv[1:] if argv is None else argv)
        except (KeyboardInterrupt, Exception):
            if seen:
                return _interrupted(prog)
            raise
        if args is None:
            return OK
        with _plain_warnings(args.command):
            return _run_verb(args, seen)


@contextmanager
def _plain_warnings(command):
    """Print this package's warnings as sentences, none of numpy and scipy; ``-W`` shows all."""
    if sys.warnoptions:
        yield
        return
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)
        warnings.showwarning = lambda message, *_: print(
            f'{command}: warning: {message}', file=sys.stderr)
        os.environ['PYTHONWARNINGS'] = 'ignore::RuntimeWarning'
        try:
            yield
        finally:
            os.environ.pop('PYTHONWARNINGS', None)


def _run_verb(args, seen):
    """Return the exit code of a verb; whatever it raises becomes a sentence."""
    try:
        code = args.run(args)
        sys.stdout.flush()  # here, where a closed pipe is understood
        return code
    except GmsFlexError as error:
        print(f'{args.command}: {error}', file=sys.stderr)
        return BAD_INPUT
    except MemoryError:
        print(f'{args.command}: not enough memory for so many samples; choose a shorter '
              'duration or a lower rate', file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        return _interrupted(args.command)
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except OSError as error:
        where = f'{error.filename}: ' if error.filename else _of_output(error)
        print(f'{args.command}: {where}{error.strerror or error}', file=sys.stderr)
        return BAD_INPUT
    except Exception:  # noqa: B902  its exit code 1 would say what a finding says
        if seen:
            return _interrupted(args.command)
        traceback.print_exc()
        print(f'{args.command}: this is an error of the program; please report it with the '
              'lines above', file=sys.stderr)
        return OWN_ERROR


def _of_output(error):
    """Return 'standard output: ', and close it, where an error without a name is of it."""
    if error.errno != errno.ENOSPC:  # all other files that are written have a name
        return ''
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 'standard output: '


@contextmanager
def _noted_interrupts():
    """Yield a list that Ctrl-C fills: libraries it cuts short raise other errors than its own."""
    seen = []
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler or current_thread() is not main_thread():
        yield seen  # someone else answers, or nobody may
        return

    def note(number, frame):
        seen.append(True)
        raise_interrupt(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield seen
    finally:
        if signal.getsignal(signal.SIGINT) is note:  # a verb may have chosen to ignore it
            signal.signal(signal.SIGINT, before)


def raise_interrupt(number, frame) -> None:
    """Raise KeyboardInterrupt; a little later if LLVM calls back, where it would be lost."""
    called = frame
    while called is not None:
        if 'llvmlite' in called.f_code.co_filename:
            Timer(_LATER, os.kill, (os.getpid(), number)).start()
            return
        called = called.f_back
    raise KeyboardInterrupt


def _interrupted(command):
    """Say that Ctrl-C ended a command; return the exit code."""
    print(f'{command}: interrupted', file=sys.stderr)
    return INTERRUPTED


def _complete(parser):
    """Answer a shell that requests completions, and end; else do nothing."""
    if '_ARGCOMPLETE' not in os.environ:
        return
    try:
        from argcomplete import autocomplete
    except ModuleNotFoundError:
        return
    autocomplete(parser)


if __name__ == '__main__':
    sys.exit(main())
