# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The catalogue of effects: one module per effect, found by its file name."""

from functools import cache
from importlib import import_module
import inspect
import pkgutil

from gms_flex_control.effects import catalogue
from gms_flex_control.effects.base import Effect
from gms_flex_control.errors import ParameterError
from gms_flex_control.suggest import did_you_mean


@cache
def names():
    """Return the names of all effects, sorted; nothing is imported for it."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(catalogue.__path__)))


def in_words(name: str) -> str:
    """Return what an effect of the catalogue is, such as 'Play in the transmission'."""
    return inspect.getdoc(inspect.getmodule(find(name))).splitlines()[0].rstrip('.')


@cache
def find(name):
    """
    Return the effect class of a catalogue name.

    Parameters
    ----------
    name : str
        Such as ``'backlash'``.

    Returns
    -------
    type
        A subclass of Term or Change.

    Raises
    ------
    ParameterError
        If the catalogue has no such effect; the sentence names the nearest.

    """
    if name not in names():
        raise ParameterError(
            f'effect {name!r} is not in the catalogue{did_you_mean(name, names())}')
    module = import_module(f'{catalogue.__name__}.{name}')
    return next(entry for entry in vars(module).values()
                if isinstance(entry, type) and issubclass(entry, Effect)
                and getattr(entry, 'name', None) == name)
