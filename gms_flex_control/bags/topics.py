# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Where in a bag a recording is found, also one made in a namespace."""

from typing import NamedTuple


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
