# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""ROS parameter files: read with line numbers for messages, written whole or not at all."""

from pathlib import Path
from textwrap import wrap
import warnings

from gms_flex_control.errors import ConfigError, ParameterError
from gms_flex_control.file_io import as_yaml, checked_yaml, write_text
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.arm import in_units_of
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema import build
from gms_flex_control.schema.build import limits_from_values
from gms_flex_control.schema.keys import known_keys

_WRAPPER = 'ros__parameters'
_COMMENT_WIDTH = 90


def read_parameters(path) -> dict:
    """Read ``/**`` of a parameter file: flat name to (value, line); ConfigError if it is none."""
    path = Path(path)
    document = checked_yaml(path, ConfigError)
    if not isinstance(document, dict) or not any(
            isinstance(section, dict) and _WRAPPER in section for section in document.values()):
        raise ConfigError(f"{path}: is not a ROS parameter file; it begins with '/**:' and "
                          f"'{_WRAPPER}:'")
    flat = {}
    for name, section in document.items():
        if (name in ('/**', '**') and isinstance(section, dict)
                and isinstance(section.get(_WRAPPER), dict)):
            _flatten(section[_WRAPPER], '', flat)
    return flat


def _flatten(mapping, prefix, flat):
    for name, value in mapping.items():
        if isinstance(value, dict) and (value or not prefix):
            _flatten(value, f'{prefix}{name}.', flat)
        else:
            line = mapping.lc.key(name)[0] + 1 if hasattr(mapping, 'lc') else 0
            flat[f'{prefix}{name}'] = (value, line)


def read_values(paths) -> tuple[dict, dict]:
    """Return merged flat values of files, later ones winning, and ``file:line`` of each."""
    values, places, earlier = {}, {}, []
    for path in paths:
        given = read_parameters(path)
        for before, friction in earlier:
            if 'joints' in given and not _identified(given) and friction <= set(given):
                warnings.warn(f'the friction of {before} is not used, because {path} states all '
                              'of it again; give it last', stacklevel=2)
        friction = {name for name in given if name.startswith('friction.')}
        if friction and (_identified(given) or 'joints' not in given):
            earlier.append((path, friction))
        for name, (value, line) in given.items():
            if name == 'arm.urdf' and isinstance(value, str) and value:
                value = str(Path(path).absolute().parent / value)
            values[name], places[name] = value, f'{path}:{line}'
    return values, places


def _identified(given):
    """Return whether parameters, from `read_parameters`, say what they were identified from."""
    return bool(given.get('identified_from', ((), 0))[0])


def _built(paths, make):
    """Return ``make(values)`` of parameter files; its errors then begin with file and line."""
    paths = [paths] if isinstance(paths, (str, Path)) else list(paths)
    values, places = read_values(paths)
    try:
        return make(values)
    except (ConfigError, ParameterError) as error:
        told = type(error)(in_units_of(values.get('arm.axes'), str(error)))
        raise located(told, paths, places) from error


def located(error, paths, places) -> Exception:
    """Return the error with file and line of the key its sentence begins with; see read_values."""
    message = str(error)
    name = message.split(' ', 1)[0].rstrip(':')
    below = (key for key in places if key.startswith(f'{name}.'))
    place = places.get(name) or places.get(next(below, ''))
    return type(error)(f"{place or ', '.join(dict.fromkeys(map(str, paths)))}: {message}")


def load_robot(paths, *, to_identify: bool = False) -> RobotParams:
    """
    Read the robot from one or more parameter files, later ones winning.

    Its friction may be missing where that is ``to_identify``.
    """
    return _built(paths, build.robot_to_identify if to_identify else build.robot_from_values)


def load_limits(paths, joints) -> Limits | None:
    """Read the Limits of ``joints`` from files, later ones winning; None if nothing is limited."""
    def limits(values):
        return limits_from_values({name: value for name, value in values.items()
                                   if name.startswith('limits.')}, joints)
    return _built(paths, limits)


def load_controller(paths, robot: RobotParams) -> ControllerParams:
    """Read the gains for the joints of ``robot``; files and errors as of `load_robot`."""
    def make(values):
        known_keys(values, robot.joints)
        return build.controller_from_values(values, robot.joints)

    return _built(paths, make)


def save_robot(robot: RobotParams, path, *, comment: str = '') -> None:
    """Write a robot as a parameter file that reads back as it is, ``comment`` at its head."""
    save_values(build.robot_values(robot), path, comment=comment)


def wrapped(lines) -> str:
    """Return sentences (list of str) as the comment of a file, long ones in several lines."""
    return '\n'.join(part for line in lines for part in wrap(
        line, _COMMENT_WIDTH, subsequent_indent='    '))


def save_values(values: dict, path, *, comment: str = '') -> None:
    """Write flat parameters as a ROS parameter file for any node; see `save_robot`."""
    tree = {}
    for name, value in values.items():
        branch = tree
        *parents, leaf = name.split('.')
        for parent in parents:
            branch = branch.setdefault(parent, {})
        branch[leaf] = value
    header = ''.join(f'# {line}\n' for line in comment.splitlines())
    write_text(path, header + as_yaml({'/**': {_WRAPPER: tree}}, inline_lists=True))
