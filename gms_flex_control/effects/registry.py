# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
All effects: the classes of the catalogue by their names, and those of other packages.

A package offers its class in the group ``gms_flex_control.effects``, for example in setup.py::

    entry_points={'gms_flex_control.effects': ['my_effect = my_package.my_effect:MyEffect']}
"""

from functools import cache
from importlib import import_module, metadata
import inspect
import pkgutil

from gms_flex_control.effects import catalogue, learned
from gms_flex_control.effects.base import Change, Effect, Term
from gms_flex_control.errors import did_you_mean, ParameterError

GROUP = 'gms_flex_control.effects'


@cache
def _in_catalogue():
    """Return the effects of the catalogue's modules, dict of str to class."""
    modules = [import_module(f'{catalogue.__name__}.{module.name}')
               for module in pkgutil.iter_modules(catalogue.__path__)]
    return {kind.name: kind for module in modules for kind in vars(module).values()
            if isinstance(kind, type) and issubclass(kind, Effect)
            and kind.__module__ == module.__name__}


@cache
def _offered():
    """Return the effects that other packages offer, dict of str to EntryPoint."""
    return {entry.name: entry for entry in metadata.entry_points(group=GROUP)}


@cache
def names() -> tuple[str, ...]:
    """Return the names of all effects, sorted."""
    return tuple(sorted({*_in_catalogue(), *_offered()}))


def in_words(name: str) -> str:
    """Return what an effect is, such as 'Play in the transmission'."""
    kind = find(name)
    return (kind.words or inspect.getdoc(kind).splitlines()[0]).rstrip('.')


@cache
def find(name: str) -> type[Effect]:
    """Return the class of an effect, such as 'backlash', or raise ParameterError."""
    if name in learned.LEARNED:
        return learned.LEARNED[name]
    if name not in names():
        raise ParameterError(
            f'effect {name!r} is not in the catalogue{did_you_mean(name, names())}')
    if name in _offered():
        return _loaded(_offered()[name])
    return _in_catalogue()[name]


def _loaded(entry):
    """Return the class that an EntryPoint offers."""
    where = f'effect {entry.name!r}, offered as {entry.value!r} in the entry points {GROUP},'
    if entry.name in _in_catalogue():
        raise ParameterError(f'{where} has the name of one of the catalogue; rename it')
    try:
        kind = entry.load()
    except Exception as error:  # whatever the module of somebody else raises
        raise ParameterError(f'{where} cannot be loaded ({type(error).__name__}: {error}); '
                             'mend or uninstall that package') from error
    if not (isinstance(kind, type) and issubclass(kind, (Term, Change))):
        raise ParameterError(f'{where} is not a subclass of {Term.__module__}.Term or Change')
    if kind.name != entry.name:
        raise ParameterError(f'{where} calls itself {kind.name!r}; both names must agree')
    return kind


def bounds_of(spec, robot) -> tuple:
    """Return the least and the largest values that are looked for of an effect's parameters."""
    at = robot.joints.index(spec.joint) if spec.joint in robot.joints else 0
    return find(spec.name).search_bounds(at, robot)
