# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Friction identification and compensation for robots with flexible joints.

The names in ``__all__`` are the interface for Python, docs/python.md. Each is imported when it is
first used.
"""

from importlib import import_module
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gms_flex_control.data.reader import read_recording
    from gms_flex_control.data.recording import Recording
    from gms_flex_control.data.writer import write_recording
    from gms_flex_control.experiment.simulated import read_plan, simulate
    from gms_flex_control.results import analyse, compare, find_discrepancy, identify, tune
    from gms_flex_control.schema.files import load_controller, load_robot, save_robot

__version__ = '0.1.0'

if sys.version_info < (3, 11):  # noqa: UP036  colcon does not ask
    sys.exit(f'gms_flex_control needs Python 3.11 or later, this is {sys.version.split()[0]}')

__all__ = ['Recording', 'analyse', 'compare', 'find_discrepancy', 'identify', 'load_controller',
           'load_robot', 'read_plan', 'read_recording', 'save_robot', 'simulate', 'tune',
           'write_recording']
_HOME = {
    'load_robot': 'schema.files', 'save_robot': 'schema.files', 'load_controller': 'schema.files',
    'read_plan': 'experiment.simulated', 'simulate': 'experiment.simulated',
    'Recording': 'data.recording', 'read_recording': 'data.reader',
    'write_recording': 'data.writer'}


def __getattr__(name: str) -> object:
    """Return a public name, PEP 562."""
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{_HOME.get(name, "results")}'), name)


def __dir__() -> list[str]:
    """Return the names of this module and the public ones."""
    return sorted({*globals(), *__all__})
