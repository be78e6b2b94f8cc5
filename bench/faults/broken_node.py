# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Run a node one of whose functions raises an exception, once, after a number of calls.

``python -m bench.faults.broken_node NODE MODULE:NAME CALLS --ros-args ...``
"""

from functools import wraps
from importlib import import_module
import sys

from gms_flex_control.nodes import start

SENTENCE = 'broken for the fault table'


def command(node, place, calls):
    """Return the command of a broken node; ``place`` is such as ``pkg.module:Class.method``."""
    return [sys.executable, '-m', 'bench.faults.broken_node', node, place,
            str(calls)]


def break_function(place, calls):
    """Let the function at ``place`` raise RuntimeError at the call after ``calls`` good ones."""
    module, _, path = place.partition(':')
    owner = import_module(module)
    *parents, name = path.split('.')
    for parent in parents:
        owner = getattr(owner, parent)
    sound, done = getattr(owner, name), 0

    @wraps(sound)
    def broken(*arguments, **named):
        nonlocal done
        done += 1
        if done == calls + 1:
            raise RuntimeError(SENTENCE)
        return sound(*arguments, **named)
    setattr(owner, name, broken)


def main():
    """Break what the command line says and run the node."""
    node, place, calls = sys.argv[1:4]
    del sys.argv[1:4]
    break_function(place, int(calls))
    return start.run(node)


if __name__ == '__main__':
    sys.exit(main())
