# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The options of verbs that work on many items: where that is done, and if it goes on."""


def add_batch_options(parser):
    """Add --workers and --scheduler to a verb's parser."""
    parser.add_argument('--workers', type=int, default=2, metavar='N',
                        help='processes of this machine (default: %(default)s)')
    parser.add_argument('--scheduler', metavar='ADDRESS',
                        help='work on a running Dask cluster instead, such as '
                             "tcp://host:8786 (pip install 'gms_flex_control[dask]')")


def goes_on(args):
    """Return whether the journal of --out keeps what a verb has done so far (bool)."""
    return hasattr(args, 'scheduler') and getattr(args, 'verify', 1) != 0
