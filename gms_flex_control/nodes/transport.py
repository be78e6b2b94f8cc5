# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Sockets instead of shared memory, so that a frozen process holds up no other."""

import os
from pathlib import Path

import rclpy

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_BUILT_IN = 'FASTDDS_BUILTIN_TRANSPORTS'
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_LOCAL = Path(__file__).with_name('local_sockets.xml')


def avoid_shared_memory():
    """
    Let the nodes of this process reach others by UDP only; call it before rclpy.init.

    With shared memory Fast DDS stops every writer of a host for one second and more, again and
    again, while any one process of the domain is frozen: too long for a torque to go on. On one
    host UDP is as fast for messages of this size.

    For the range LOCALHOST rmw_fastrtps adds shared memory whatever Fast DDS is told; there the
    same discovery is described in a profile instead. Other middleware, and an environment that
    names transports or profiles, stay as they are.
    """
    environment = os.environ
    if (not rclpy.get_rmw_implementation_identifier().startswith('rmw_fastrtps')
            or any(name in environment for name in (_BUILT_IN, *_PROFILES))):
        return
    environment[_BUILT_IN] = 'UDPv4'
    only_local = environment.get('ROS_LOCALHOST_ONLY') == '1'
    if (environment.get(RANGE) == 'LOCALHOST' or only_local) and not environment.get(
            'ROS_STATIC_PEERS'):
        environment.pop('ROS_LOCALHOST_ONLY', None)
        environment[RANGE] = 'SYSTEM_DEFAULT'
        environment[_PROFILES[0]] = str(_LOCAL)
