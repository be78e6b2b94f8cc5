# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The tool `gms_flex`: one verb per module, one sentence per error, exit codes 0, 1 and 2."""

import argparse
from importlib import import_module
import os
import sys

from gms_flex_control import __version__
from gms_flex_control.errors import GmsFlexError

OK, FINDING_SAYS_NO, BAD_INPUT = 0, 1, 2
VERBS = ('demo', 'demo_identify', 'simulate', 'record', 'info', 'repair', 'analyse', 'import_csv',
         'check_gains', 'tune', 'bench', 'torsion', 'identify', 'discrepancy', 'recover', 'hide',
         'score', 'faults', 'view', 'urdf')


def build_parser():
    """Return the parser with all verbs."""
    parser = argparse.ArgumentParser(
        prog='gms_flex', description='Simulate, record, analyse and compensate friction in '
                                     'robots with flexible joints.',
        epilog='Exit codes: 0 done, 1 a finding says no, 2 bad input.')
    parser.add_argument('--version', action='version', version=__version__)
    subparsers = parser.add_subparsers(dest='verb', required=True, metavar='VERB')
    for verb in VERBS:
        import_module(f'gms_flex_control.cli.{verb}').add_parser(subparsers)
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
    args = build_parser().parse_args(argv)
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


if __name__ == '__main__':
    sys.exit(main())
