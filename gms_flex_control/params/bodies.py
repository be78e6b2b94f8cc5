# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Rigid bodies: moved to another frame, joined to one, carried at the end of an arm."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.params.arm import ArmParams, Frames
import numpy as np


class Body(NamedTuple):
    """Mass, centre of mass and inertia about it, in a frame named where it is used."""

    mass: float           # [kg]
    com: np.ndarray       # (3,) [m]
    inertia: np.ndarray   # (3, 3) [kg m^2]


def moved(body: Body, rotation: np.ndarray, position: np.ndarray) -> Body:
    """Return a body in the frame in which its own has ``rotation`` and ``position``."""
    return Body(body.mass, rotation @ body.com + position, rotation @ body.inertia @ rotation.T)


def joined(bodies: Sequence[Body]) -> Body:
    """Return several bodies in one frame as one."""
    mass = sum(body.mass for body in bodies)
    com = sum(body.mass * body.com for body in bodies) / mass
    inertia = np.zeros((3, 3))
    for body in bodies:
        away = body.com - com
        inertia += body.inertia + body.mass * (away @ away * np.eye(3) - np.outer(away, away))
    return Body(mass, com, inertia)


def at_last_link(load: Body, frames: Frames) -> Body:
    """Return a load given in the frame at the end of a chain in the frame of its last link."""
    return moved(load, frames.end_rotation, frames.end)


def carrying(arm: ArmParams, load: Body | None) -> ArmParams:
    """Return an arm of kind urdf with a load, given in the frame at its end, on its last link."""
    if load is None:
        return arm
    mass, com, inertia = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
    mass[-1], com[-1], inertia[-1] = joined(
        [Body(mass[-1], com[-1], inertia[-1]), at_last_link(load, arm.frames)])
    return replace(arm, mass=mass, com=com, inertia=inertia)
