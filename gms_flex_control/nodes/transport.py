# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
What our processes ask of Fast DDS.

Sockets instead of shared memory, so that a frozen process holds up no other; and nothing of what
a process publishes itself, which reaches its own nodes directly, unless the process asks for it.
"""

import os
from pathlib import Path

from gms_flex_control.errors import ConfigError
import rclpy

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_BUILT_IN = 'FASTDDS_BUILTIN_TRANSPORTS'
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_LOCAL = Path(__file__).with_name('local_sockets.xml')
_LOCAL_HEARD = Path(__file__).with_name('local_sockets_heard.xml')
_ANYWHERE = Path(__file__).with_name('sockets.xml')
_IGNORE_OWN = 'fastdds.ignore_local_endpoints'


def avoid_shared_memory(hears_itself=False):
    """
    Let the nodes of this process reach others by UDP only; call it before rclpy.init.

    With shared memory Fast DDS stops every writer of a host for one second and more, again and
    again, while any one process of the domain is frozen: too long for a torque to go on. On one
    host UDP is as fast for messages of this size.

    For the range LOCALHOST rmw_fastrtps adds shared memory whatever Fast DDS is told; there the
    same discovery is described in a profile instead. Other middleware, an environment that names
    profiles, and transports that it names, stay as they are.

    Parameters
    ----------
    hears_itself : bool
        Whether this process subscribes to what it publishes itself, through DDS.

    """
    environment = os.environ
    if not _is_fast_dds() or any(name in environment for name in _PROFILES):
        return
    if not hears_itself:
        environment[_PROFILES[0]] = str(_ANYWHERE)
    if _BUILT_IN in environment:
        return
    environment[_BUILT_IN] = 'UDPv4'
    only_local = environment.get('ROS_LOCALHOST_ONLY') == '1'
    if (environment.get(RANGE) == 'LOCALHOST' or only_local) and not environment.get(
            'ROS_STATIC_PEERS'):
        environment.pop('ROS_LOCALHOST_ONLY', None)
        environment[RANGE] = 'SYSTEM_DEFAULT'
        environment[_PROFILES[0]] = str(_LOCAL_HEARD if hears_itself else _LOCAL)


def refuse_own_messages():
    """
    Make sure that the nodes of this process do not hear each other through DDS as well.

    Raises
    ------
    ConfigError
        Where the middleware, or a profile of the user's, lets them.

    """
    if not _is_fast_dds():
        raise ConfigError('loop_node needs RMW_IMPLEMENTATION=rmw_fastrtps_cpp, got '
                          f'{rclpy.get_rmw_implementation_identifier()}; start plant_node, '
                          'controller_node and trajectory_node instead')
    profiles = next(os.environ[name] for name in _PROFILES if name in os.environ)
    if _IGNORE_OWN not in Path(profiles).read_text(encoding='utf-8'):
        raise ConfigError(f'loop_node needs the property {_IGNORE_OWN} (true) of the participant '
                          f'in {profiles}; add it, or start plant_node, controller_node and '
                          'trajectory_node instead')


def _is_fast_dds():
    return rclpy.get_rmw_implementation_identifier().startswith('rmw_fastrtps')
