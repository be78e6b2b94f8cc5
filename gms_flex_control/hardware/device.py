# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Robots without ros2_control: one small class, named by its module or offered by an entry point.

``plant_node`` takes it with ``bridge.device: my_package.my_arm:MyArm``, or by the name of an entry
point in the group ``gms_flex_control.devices``. The bridge does the rest: units, signs and gears
(mapping.<joint>), limits, faults, services, diagnostics. examples/serial_arm.py is one.
"""

from abc import ABC, abstractmethod
from importlib import metadata
from typing import NamedTuple

from gms_flex_control.errors import ConfigError, did_you_mean, GmsFlexError

GROUP = 'gms_flex_control.devices'


class DeviceError(GmsFlexError):
    """The link to the robot is broken; it is opened again, with zero torque, soon after."""


class Sample(NamedTuple):
    """
    What a robot measured at one time; fields as those of sensor_msgs/JointState.

    Empty ``velocity`` or ``effort``: not measured. ``stamp`` 0: the device has no clock.
    """

    position: tuple
    velocity: tuple = ()
    effort: tuple = ()
    stamp: int = 0


class Device(ABC):
    """
    A robot that is read and commanded by a library of its own.

    All methods are called from threads of the bridge: `read` from one of its own, `write` from
    others while `read` waits. Any of them may raise DeviceError, which is a fault. A device must
    turn its torque off by itself when nothing is written for some 50 ms: the bridge may die.
    ``options`` are the entries ``name=value`` of ``bridge.device_options`` (dict of str to str),
    ``order`` names the actuators in the order of the efforts.
    """

    @abstractmethod
    def __init__(self, options, order):
        """Keep the options; refuse bad ones with ConfigError. Nothing is opened yet."""

    @property
    @abstractmethod
    def names(self) -> tuple:
        """Return the names of what is measured (tuple of str), as in ``mapping.<joint>``."""

    @abstractmethod
    def connect(self) -> None:
        """Connect; the torque is zero then."""

    @abstractmethod
    def read(self, timeout) -> Sample | None:
        """Return the next Sample, or None if none comes within ``timeout`` seconds."""

    @abstractmethod
    def write(self, efforts) -> None:
        """Send efforts (list of float) in the device's units; do not wait for an answer."""

    @abstractmethod
    def close(self) -> None:
        """Disconnect; it may be called at any time and more than once."""

    def figures(self) -> dict:
        """Return counters for /diagnostics (dict of str to number)."""
        return {}


def find(name, options, order) -> Device:
    """Return a device by ``module:Class`` or entry point; ConfigError if there is no such one."""
    wrong = [entry for entry in options if '=' not in entry]
    if wrong:
        raise ConfigError(f'bridge.device_options: {wrong[0]!r} must have the form name=value')
    entry = metadata.EntryPoint(name, name, GROUP)
    if ':' not in name:
        found = {entry.name: entry for entry in metadata.entry_points(group=GROUP)}
        if name not in found:
            raise ConfigError(f'bridge.device: no package offers {name!r} in the entry points '
                              f'{GROUP}{did_you_mean(name, found)}; or name module:Class')
        entry = found[name]
    try:
        kind = entry.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(f'bridge.device: {name!r} cannot be loaded ({error})') from error
    if not (isinstance(kind, type) and issubclass(kind, Device)):
        raise ConfigError(f'bridge.device: {name!r} is not a subclass of '
                          f'{Device.__module__}.Device')
    return kind(dict(entry.split('=', 1) for entry in options), order)
