# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""As much of ``launch`` and ``launch_ros`` as our launch files use: they are on no registry."""

import logging
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Substitution:
    """A text that is known once the arguments are."""

    def __init__(self, make):
        self.perform = make


def text(value, known):
    """Return a value as text, with the arguments ``known`` (dict)."""
    if isinstance(value, Substitution):
        return value.perform(known)
    return ''.join(text(item, known) for item in value) if isinstance(value, list) else str(value)


class Action:
    """Anything in a launch description: its kind and what it was given."""

    def __init__(self, *given, condition=None, **options):
        self.given, self.condition, self.options = given, condition, options


def _kinds(*names):
    return {name: type(name, (Action,), {}) for name in names}


def _compared(wanted):
    return lambda left, right: Substitution(
        lambda known: str((text(left, known) == text(right, known)) is wanted).lower())


def _condition(wanted):
    return lambda value: (lambda known: text(value, known) == wanted)


MODULES = {
    'launch': _kinds('LaunchDescription'),
    'launch.actions': _kinds('DeclareLaunchArgument', 'ExecuteProcess', 'GroupAction',
                             'OpaqueFunction', 'Shutdown'),
    'launch.conditions': {'IfCondition': _condition('true')},
    'launch.logging': {'get_logger': logging.getLogger},
    'launch.substitutions': {
        'AndSubstitution': lambda left, right: Substitution(
            lambda known: str(text(left, known) == text(right, known) == 'true').lower()),
        'Command': lambda parts: Substitution(lambda known: f'output of {text(parts, known)}'),
        'EqualsSubstitution': _compared(True),
        'NotEqualsSubstitution': _compared(False),
        'LaunchConfiguration': lambda name, default=None: Substitution(
            lambda known: known.get(name, default)),
        'PathJoinSubstitution': lambda parts: Substitution(
            lambda known: '/'.join(text(part, known) for part in parts))},
    'launch_ros': {},
    'launch_ros.actions': _kinds('Node', 'PushRosNamespace', 'SetParameter'),
    'launch_ros.parameter_descriptions': {'ParameterValue': lambda value, value_type: value},
    'launch_ros.substitutions': {
        'ExecutableInPackage': lambda name, package: Substitution(lambda known: name),
        'FindPackageShare': lambda package: Substitution(lambda known: str(ROOT))}}


def modules():
    """Return the modules that stand in, by name."""
    made = {}
    for name, members in MODULES.items():
        made[name] = ModuleType(name)
        vars(made[name]).update(members)
    return made


class Started(NamedTuple):
    """A process: executable, words, parameters (files, then single ones), names of its own."""

    executable: str
    words: list
    files: list
    parameters: dict[str, Any]
    namespace: str = ''
    remappings: tuple = ()
    on_exit: Any = None     # takes the event of its end and the context
    prefix: str = ''        # words before the executable


def started(description, given, pushed=''):
    """
    Return what a launch description starts with arguments ``given`` (list of Started).

    ``pushed`` is a namespace that a file around it has pushed.
    """
    declared = [entity for entity in description.given[0] if _kind(entity).startswith('Declare')]
    known = {}
    for argument in declared:
        name = argument.given[0]
        known[name] = given.get(name, text(argument.options['default_value'], known))
        assert known[name] in argument.options.get('choices', [known[name]])
    assert set(given) <= set(known)
    group, = (entity for entity in description.given[0] if _kind(entity) == 'GroupAction')
    found, common, namespace = [], {}, ''
    known['ros_namespace'] = pushed
    for action in group.given[0]:
        if _kind(action) == 'PushRosNamespace':
            namespace = text(action.given[0], known)
            known['ros_namespace'] = f'/{pushed}/{namespace}'.rstrip('/').replace('//', '/')
        elif _kind(action) == 'SetParameter':
            common[action.given[0]] = text(action.given[1], known)
        elif action.condition is not None and not action.condition(known):
            continue
        elif _kind(action) == 'OpaqueFunction':
            action.options['function'](None)
        else:
            found.append(_process(action, known, common, namespace))
    return found


def _kind(action):
    return type(action).__name__


def _process(action, known, common, namespace):
    options = action.options
    if _kind(action) == 'ExecuteProcess':
        words = [text(word, known) for word in options['cmd']]
        return Started(words[0], words[1:], [], {}, prefix=text(options['prefix'], known))
    files, own = [], dict(common)
    for item in options.get('parameters', ()):
        if isinstance(item, dict):
            own |= {name: text(value, known) for name, value in item.items()}
        else:
            files.append(text(item, known))
    words = [text(word, known) for word in options.get('arguments', ())]
    return Started(options['executable'], words, files, own, namespace,
                   tuple(options.get('remappings', ())),
                   options.get('on_exit'),
                   text(options.get('prefix', ''), known))
