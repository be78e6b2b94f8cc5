# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Friction identification and compensation for robots with flexible joints.

The names in ``__all__`` are the interface for Python, docs/python.md. Each is imported when it is
first used.
"""

from importlib import import_module
import sys

__version__ = '0.1.0'

if sys.version_info < (3, 11):  # noqa: UP036  colcon does not ask
    sys.exit(f'gms_flex_control needs Python 3.11 or later, this is {sys.version.split()[0]}')

_HOME = {
    'load_robot': 'schema.files', 'save_robot': 'schema.files', 'load_controller': 'schema.files',
    'read_plan': 'experiment.plan', 'simulate': 'experiment.simulated',
    'Recording': 'data.recording', 'read_recording': 'data.reader',
    'write_recording': 'data.writer', 'identify': 'identification.identify',
    'find_discrepancy': 'discrepancy.workflow'}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> object:
    """Return a public name, PEP 562."""
    if name not in _HOME:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{_HOME[name]}'), name)


def __dir__() -> list[str]:
    """Return the names of this module and the public ones."""
    return sorted({*globals(), *_HOME})
