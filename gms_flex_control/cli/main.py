# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
# PYTHON_ARGCOMPLETE_OK
"""The tool `gms_flex`: one verb per module, one sentence per error, exit codes 0, 1 and 2."""

import argparse
from importlib import import_module
import os
import sys
import traceback

from gms_flex_control import __version__
from gms_flex_control.cli.completion import complete
from gms_flex_control.cli.examples import add_examples
from gms_flex_control.errors import GmsFlexError

OK, FINDING_SAYS_NO, BAD_INPUT = 0, 1, 2
OWN_ERROR = 70  # EX_SOFTWARE of sysexits.h: never taken for a finding
VERBS = ('demo', 'demo_identify', 'demo_discrepancy', 'simulate', 'record', 'info', 'repair',
         'analyse', 'import_csv', 'check_gains', 'tune', 'compare', 'bench', 'torsion', 'identify',
         'discrepancy', 'recover', 'hide', 'score', 'faults', 'view', 'urdf', 'completion')


def build_parser():
    """Return the parser with all verbs."""
    parser = argparse.ArgumentParser(
        prog='gms_flex', description='Simulate, record, analyse and compensate friction in '
                                     'robots with flexible joints.',
        epilog='Exit codes: 0 done, 1 a finding says no, 2 bad input. '
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
    parser = build_parser()
    complete(parser)
    args = parser.parse_args(argv)
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
        return 128 + 2  # as a shell reports SIGINT
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except OSError as error:
        where = f'{error.filename}: ' if error.filename else ''
        print(f'gms_flex {args.verb}: {where}{error.strerror or error}', file=sys.stderr)
        return BAD_INPUT
    except Exception:  # noqa: B902  its exit code 1 would say what a finding says
        traceback.print_exc()
        print(f'gms_flex {args.verb}: this is an error of the program; please report it with the '
              'lines above', file=sys.stderr)
        return OWN_ERROR


if __name__ == '__main__':
    sys.exit(main())
