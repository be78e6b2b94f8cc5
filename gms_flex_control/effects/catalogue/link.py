# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Effects on the links: inertia, gravity and what acts on them from outside."""

from dataclasses import replace

from gms_flex_control.effects import base as sig
from gms_flex_control.effects.base import Change, Guess, linear, Parameter, Stage, Term, wave
from gms_flex_control.params.arm import Body, carrying, STANDARD_GRAVITY
from gms_flex_control.params.robot import RobotParams
import numpy as np


class LinkInertiaError(Change):
    """Mass and inertia of the link -> (1 + ratio) of them; its centre of mass stays."""

    name = 'link_inertia_error'
    words = 'Inertia of a link other than believed'
    evidence = 'link acceleration'
    similar = ('tip_payload',)
    discriminated_by = 'the joint alone with the others bent and stretched'
    replaces = 'inertia'
    parameters = (Parameter('ratio', '1', 'relative error', lower=-0.95, relative=True,
                            typical=0.3),)
    guesses = staticmethod(lambda s: linear(0.1))

    @staticmethod
    def excludes(rigid) -> tuple:
        """Return what scales the torque that drives the link, as less inertia does."""
        return ('torque_gain', 'load_friction') if rigid else ('load_friction',)

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        factor = np.ones(robot.n_joints)
        factor[joint] += values[0]
        return replace(robot, arm=robot.arm.scaled(factor))


class TipPayload(Change):
    """The last link carries a point mass at its end; in space at ``arm.tip``, or farthest."""

    name = 'tip_payload'
    words = 'Mass carried at the tip'
    whole_arm = True
    needs_chain = True
    evidence = 'link acceleration'
    similar = ('link_inertia_error',)
    discriminated_by = 'the same motion with the last link bent and stretched'
    parameters = (Parameter('mass', 'kg', 'mass of the payload', lower=0.0,
                            typical=lambda s: 0.1 * s.mass),)
    guesses = staticmethod(lambda s: linear(0.05, positive=True))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        if robot.arm.mass[-1] + values[0] == 0.0:
            return robot
        payload = Body(values[0], np.zeros(3), np.zeros((3, 3)))
        return replace(robot, arm=carrying(robot.arm, payload))


class GravityTilt(Change):
    """
    The plane of motion is tilted: gravity g sin(tilt) along a direction in the plane.

    In space gravity turns by the tilt from where the file has it towards the direction, which
    counts from the x axis of the base where that is level, towards its y axis.
    """

    name = 'gravity_tilt'
    words = 'Base that is not level'
    whole_arm = True
    needs_chain = True
    evidence = 'link angle'
    discriminated_by = 'rests in many poses all around'
    parameters = (
        Parameter('tilt', 'rad', 'angle between the plane, or the base, and the horizontal',
                  typical=0.015),
        Parameter('direction', 'rad', 'direction of steepest descent'))
    guesses = staticmethod(lambda s: wave(0.002))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        tilt, direction = values
        arm = robot.arm
        if arm.frames is None:
            pull = STANDARD_GRAVITY * np.sin(tilt)
            extra = pull * np.array([np.cos(direction), np.sin(direction)])
            return replace(robot, arm=replace(arm, gravity=arm.gravity + extra))
        pull = np.linalg.norm(arm.gravity)
        if pull == 0.0:
            return robot
        down = arm.gravity / pull
        x = np.eye(3)[np.argmin(np.abs(down) > 0.99)]  # the x axis unless that is vertical
        x = x - down * (down @ x)
        x /= np.linalg.norm(x)
        level = np.cos(direction) * x + np.sin(direction) * np.cross(x, down)
        return replace(robot, arm=replace(arm, gravity=pull * (
            np.cos(tilt) * down + np.sin(tilt) * level)))


class ConstantLinkTorque(Term):
    """x += bias."""

    name = 'constant_link_torque'
    words = 'Constant torque on the link, as from a cable'
    stage = Stage.LINK
    evidence = 'link rate'
    similar = ('spring_offset', 'friction_asymmetry', 'motor_torque_bias')
    declared_from = 0.3       # levels that differ by direction are nearly a constant torque
    discriminated_by = 'motion both ways over the whole range, with rests between'
    fed_forward = True
    estimated_with_arm = True
    parameters = (Parameter('bias', 'N m', 'torque', typical=lambda s: 0.3 * s.friction),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.LINK_TORQUE] += p[0]


class EndStop(Term):
    """x -= stiffness (q_link - angle) beyond the angle, on its side of zero."""

    name = 'end_stop'
    words = 'Stop met beyond an angle: a one-sided spring'
    stage = Stage.LINK
    evidence = 'link angle'
    discriminated_by = 'slow motion into the stop and out of it'
    parameters = (
        Parameter('angle', 'rad', 'where it begins'),
        Parameter('stiffness', 'N m/rad', 'stiffness of the stop', lower=0.0,
                  typical=lambda s: s.friction / 0.01))

    @staticmethod
    def guesses(scales) -> list:
        """Return stops a little inside the range that was travelled, either side of zero."""
        span, stiffness = scales.travel.span, scales.friction / 0.05
        inside = span * np.geomspace(0.02, 0.18, 5)  # a fit converges from within a third
        above, below = scales.travel.highest - inside, scales.travel.lowest + inside
        return [Guess(((angle, stiffness),), lambda c, angle=angle: (angle, c[0] * stiffness), 0.0)
                for angle in (*above[above > 0.0], *below[below < 0.0])]

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        depth = s[sig.Q_LINK] - p[0]
        if depth * p[0] > 0.0:
            s[sig.LINK_TORQUE] -= p[1] * depth
