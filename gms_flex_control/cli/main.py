# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
# PYTHON_ARGCOMPLETE_OK
"""The tool `gms_flex`: one verb per module, one sentence per error, exit codes 0, 1, 2 and 130."""

import argparse
from contextlib import contextmanager
from importlib import import_module
import os
import signal
import sys
from threading import current_thread, main_thread
import traceback

from gms_flex_control import __version__
from gms_flex_control.cli.batch_options import goes_on
from gms_flex_control.cli.completion import complete
from gms_flex_control.cli.examples import add_examples
from gms_flex_control.errors import GmsFlexError

OK, FINDING_SAYS_NO, BAD_INPUT = 0, 1, 2
INTERRUPTED = 130  # as a shell reports SIGINT
OWN_ERROR = 70  # EX_SOFTWARE of sysexits.h: never taken for a finding
VERBS = ('demo', 'demo_identify', 'demo_discrepancy', 'simulate', 'record', 'info', 'repair',
         'analyse', 'import_csv', 'check_gains', 'tune', 'compare', 'bench', 'torsion', 'identify',
         'discrepancy', 'recover', 'hide', 'score', 'faults', 'view', 'urdf', 'completion')


def build_parser():
    """Return the parser with all verbs."""
    parser = argparse.ArgumentParser(
        prog='gms_flex', description='Simulate, record, analyse and compensate friction in '
                                     'robots with flexible joints.',
        epilog='Exit codes: 0 done, 1 a finding says no, 2 bad input, 130 interrupted by Ctrl-C. '
               'gms_flex VERB --help has examples.')
    parser.add_argument('--version', action='version', version=__version__)
    subparsers = parser.add_subparsers(dest='verb', required=True, metavar='VERB')
    for verb in VERBS:
        import_module(f'gms_flex_control.cli.{verb}').add_parser(subparsers)
    add_examples(subparsers.choices)
    return parser


def main(argv=None):
    """
    Run one verb.

    Parameters
    ----------
    argv : list of str, optional
        Arguments; default those of the command line.

    Returns
    -------
    int
        Exit code.

    """
    with noted_interrupts() as seen:
        try:
            parser = build_parser()
            complete(parser)
            args = parser.parse_args(argv)
        except (KeyboardInterrupt, Exception):
            if seen:
                return interrupted()
            raise
        return run_verb(args, seen)


def run_verb(args, seen):
    """Return the exit code of a verb; whatever it raises becomes a sentence."""
    try:
        code = args.run(args)
        sys.stdout.flush()  # here, where a closed pipe is understood
        return code
    except GmsFlexError as error:
        print(f'gms_flex {args.verb}: {error}', file=sys.stderr)
        return BAD_INPUT
    except MemoryError:
        print(f'gms_flex {args.verb}: not enough memory for so many samples; ask for a shorter '
              'time or a lower rate', file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        return interrupted(args)
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except OSError as error:
        where = f'{error.filename}: ' if error.filename else ''
        print(f'gms_flex {args.verb}: {where}{error.strerror or error}', file=sys.stderr)
        return BAD_INPUT
    except Exception:  # noqa: B902  its exit code 1 would say what a finding says
        if seen:
            return interrupted(args)
        traceback.print_exc()
        print(f'gms_flex {args.verb}: this is an error of the program; please report it with the '
              'lines above', file=sys.stderr)
        return OWN_ERROR


@contextmanager
def noted_interrupts():
    """Yield a list that Ctrl-C fills: libraries it cuts short raise other errors than its own."""
    seen = []
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler or current_thread() is not main_thread():
        yield seen  # someone else answers, or nobody may
        return

    def note(_number, _frame):
        seen.append(True)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, note)
    try:
        yield seen
    finally:
        if signal.getsignal(signal.SIGINT) is note:  # a verb may have chosen to ignore it
            signal.signal(signal.SIGINT, before)


def interrupted(args=None):
    """Say that Ctrl-C ended the verb, and whether it goes on; return the exit code."""
    further = '; the same command goes on where it was' if args and goes_on(args) else ''
    print(f'gms_flex{f" {args.verb}" if args else ""}: interrupted{further}', file=sys.stderr)
    return INTERRUPTED


if __name__ == '__main__':
    sys.exit(main())
