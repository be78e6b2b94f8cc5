# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Message definitions and type hashes, which every bag carries."""

from functools import lru_cache
import os
from pathlib import Path
import re
import sys
from typing import NamedTuple

from gms_flex_control.errors import BagError
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.base import TypesysError

_FIELD = re.compile(
    r'^([A-Za-z]\w*(?:/\w+)*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*', re.MULTILINE)
_PRIMITIVES = frozenset(
    'bool byte char float32 float64 int8 uint8 int16 uint16 int32 uint32 int64 uint64 '
    'string wstring'.split())


class Definition(NamedTuple):
    """What a bag says about a message type."""

    text: str       # the ros2msg text with its dependencies
    type_hash: str  # RIHS01_...
    encoding: str = 'ros2msg'


@lru_cache(maxsize=1)
def _typestore():
    return get_typestore(Stores.ROS2_JAZZY)


@lru_cache(maxsize=256)
def definition(type_name):
    """
    Return the definition of a message type.

    Parameters
    ----------
    type_name : str
        As ROS prints it, for example ``sensor_msgs/msg/JointState``.

    Returns
    -------
    Definition
        From the standard types of Jazzy, else from the .msg files of installed packages.

    Raises
    ------
    BagError
        If the type or one it is made of is found in neither.

    """
    store = _typestore()
    if type_name not in store.types:
        _register_installed(store, type_name)
    try:
        text, _ = store.generate_msgdef(type_name, ros_version=2)
        return Definition(text, store.hash_rihs01(type_name))
    except (TypesysError, KeyError) as error:
        raise BagError(f'message type {type_name!r} cannot be described ({error}); '
                       'leave its topic out') from error


def _register_installed(store, type_name):
    """Add a type and those it is made of to ``store``, from the .msg files installed."""
    found, waiting = {}, [type_name]
    while waiting:
        name = waiting.pop()
        if name in store.types or name in found:
            continue
        text = _installed_text(name)
        found[name] = text
        package = name.split('/', 1)[0]
        for match in _FIELD.finditer(text):
            if match[1] not in _PRIMITIVES:
                waiting.append(_full_name(match[1], package))
    types = {}
    for name, text in found.items():
        try:
            types.update(get_types_from_msg(text, name))
        except TypesysError as error:
            raise BagError(f'message type {name!r}: its .msg file cannot be read '
                           f'({error}); leave its topic out') from error
    store.register(types)


def _full_name(name, package):
    parts = name.split('/')
    if len(parts) == 1:
        return 'std_msgs/msg/Header' if name == 'Header' else f'{package}/msg/{name}'
    return f'{parts[0]}/msg/{parts[-1]}'


def _installed_text(type_name):
    parts = type_name.split('/')
    prefixes = [p for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    if len(parts) == 3 and parts[1] == 'msg':
        for prefix in (*prefixes, sys.prefix):
            path = Path(prefix, 'share', parts[0], 'msg', f'{parts[2]}.msg')
            if path.is_file():
                return path.read_text(encoding='utf-8')
    raise BagError(f'message type {type_name!r} is neither a standard one nor installed as '
                   f'share/{parts[0]}/msg/{parts[-1]}.msg under AMENT_PREFIX_PATH; source the '
                   'workspace that defines it, or leave its topic out')
