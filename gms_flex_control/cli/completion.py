# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Complete verbs, options and files in the shell, as ros2 and colcon do."""

import os

SHELLS = ('bash', 'zsh', 'fish')


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'completion', help='complete verbs, options and files by TAB in bash, zsh and fish',
        description='Print what a shell reads to complete commands of gms_flex; put the line of '
                    'the example into ~/.bashrc or ~/.zshrc. Needs argcomplete, which comes with '
                    'ros2 and colcon.')
    parser.add_argument('shell', choices=SHELLS)
    parser.set_defaults(run=run)


def run(args):
    """Print the code for one shell; return 0."""
    from gms_flex_control.errors import ConfigError
    try:
        from argcomplete import shellcode
    except ModuleNotFoundError as error:
        raise ConfigError("argcomplete is not installed; 'pip install argcomplete' or "
                          "'apt install python3-argcomplete' adds it") from error
    print(shellcode(['gms_flex'], shell=args.shell))
    return 0


def complete(parser):
    """Answer a shell that asks for completions, and end; else do nothing."""
    if '_ARGCOMPLETE' not in os.environ:
        return
    try:
        from argcomplete import autocomplete
    except ModuleNotFoundError:
        return
    autocomplete(parser)
