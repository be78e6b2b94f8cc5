# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The options of verbs that work on many items: where that is done, and if it goes on."""


def add_batch_options(parser, workers=2, what='processes of this machine (default: 2)'):
    """Add --workers, with its default and ``what`` they are, and --scheduler to a parser."""
    parser.add_argument('--workers', type=int, default=workers, metavar='N', help=what)
    parser.add_argument('--scheduler', metavar='ADDRESS',
                        help='work on a running Dask cluster instead, such as '
                             "tcp://host:8786 (pip install '.[dask]')")


def goes_on(args):
    """Return whether the journal of --out keeps what a verb has done so far (bool)."""
    return hasattr(args, 'scheduler') and getattr(args, 'verify', 1) != 0 and (
        getattr(args, 'each', True))
