# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which topics of a bag are a recording, and which names in its joint states are motors."""

from typing import NamedTuple

from gms_flex_control.bags.cdr import unpack_joint_state
from gms_flex_control.errors import BagError

MOTOR_SUFFIX = '_motor'


class Topics(NamedTuple):
    """Where a recording is found in a bag."""

    joint_states: str = '/joint_states'
    command: str = '/effort_controller/commands'
    reference: str = '/reference'
    controller_state: str = '/cascade_controller/state'
    supply: str = '/supply_voltage'

    def within(self, namespace):
        """Return these topics in a namespace (str), such as '/left'."""
        return Topics(*(namespace + topic for topic in self))


def namespace_of(bag):
    """
    Return the namespace of the one closed loop in a bag.

    Parameters
    ----------
    bag : Bag
        Whose metadata name its topics.

    Returns
    -------
    str
        Such as '/left'; '' where the topics have none, or where there is no telling.

    """
    plain = Topics()
    names = bag.metadata.topics if bag.metadata else ()
    if plain.joint_states in names:
        return ''
    found = [name.removesuffix(plain.joint_states) for name in names
             if name.endswith(plain.joint_states)]
    looped = [space for space in found if space + plain.command in names]
    one = looped if looped else found
    return one[0] if len(one) == 1 else ''


def link_names(names):
    """Return the names that are not the motor of another, in order."""
    return [name for name in names
            if not (name.endswith(MOTOR_SUFFIX) and name[:-len(MOTOR_SUFFIX)] in names)]


def names_of(bag, message, topics):
    """
    Return the names in a joint state.

    Parameters
    ----------
    bag : Bag
        Where it is from.
    message : bytes or None
        The joint state; None where the bag has none.
    topics : Topics
        Topic names.

    Returns
    -------
    list of str

    Raises
    ------
    BagError
        If there is no message, or a broken one.

    """
    if message is None:
        known = ', '.join(sorted(bag.topics)) or 'none'
        what = 'no message on' if topics.joint_states in bag.topics else 'no topic'
        raise BagError(f'{bag.path}: has {what} {topics.joint_states!r} (topics: {known}); '
                       'record it, or name the topic that has the joint states')
    try:
        return unpack_joint_state(message)[2]
    except BagError as error:
        raise BagError(f'{bag.path}: topic {topics.joint_states!r} message 0 {error}') from None


def resolved(path, topic, names, joints=None, motors=None):
    """
    Return the joint and motor names.

    Parameters
    ----------
    path : str
        The bag.
    topic : str
        Of its joint states.
    names : sequence of str
        In the first of these.
    joints, motors : sequence of str, optional
        As wanted, see `read_recording`.

    Returns
    -------
    joints, motors : tuple of str
        One each a joint, '' where there is no motor.

    Raises
    ------
    BagError
        If a name is not there, or there are not as many motors as joints.

    """
    if joints is None:
        joints = link_names(names) if motors is None else [
            name for name in names if name not in motors]
    if motors is None:
        motors = [name + MOTOR_SUFFIX if name + MOTOR_SUFFIX in names else ''
                  for name in joints]
    if len(motors) != len(joints):
        raise BagError(f'{path}: {len(motors)} motors for {len(joints)} joints '
                       f'({", ".join(joints)}); give one each, empty where there is none')
    lone = {joint for joint, motor in zip(joints, motors, strict=True) if motor in names}
    for name in (*joints, *motors):
        if name and name not in names and name not in lone:
            raise BagError(f'{path}: topic {topic!r} lacks joint {name!r} '
                           f'(has {", ".join(names)}); set the names that are there or record '
                           'that side as well')
    return tuple(joints), tuple(motors)
