# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""First guesses of the whole catalogue for the joints of a robot."""

from gms_flex_control.discrepancy.unseen_links import is_lost
from gms_flex_control.effects.guess import Scales
from gms_flex_control.effects.registry import find, names
from gms_flex_control.params.robot import WHOLE_ARM
import numpy as np


def scales_of(paths, robot, fine_orders):
    """Return the Scales of each joint over all paths, ``fine_orders`` a tuple per joint."""
    arm, found = robot.arm, []
    for j in range(robot.n_joints):
        link, rate, motor = (np.concatenate([path.motion[:, row, j] for path in paths])
                             for row in (0, 1, 3))
        torque = np.concatenate([path.command[:, j] for path in paths])
        twist = 0.0 if arm.rigid[j] else float(np.std(motor - link))  # an offset is no usual size
        spring = float(arm.stiffness[j] * twist) if twist > 0.0 else float(np.std(torque))
        found.append(Scales(
            friction=float(robot.friction.forward.static[j]), torque=float(np.abs(torque).max()),
            spring=spring, twist=twist, speed=max(float(np.sqrt(np.mean(rate ** 2))), 1e-6),
            inertia=float(arm.motor_inertia[j]),
            link_inertia=float(arm.inertia[j] + arm.mass[j] * arm.com[j] ** 2),
            lowest=float(link.min()), highest=float(link.max()), turned=float(np.ptp(motor)),
            duration=float(max(path.time[-1] - path.time[0] for path in paths)),
            supply=min(float(path.supply.mean()) for path in paths),
            fine_orders=fine_orders[j]))
    return found


_RATIOS, _LEAST_RATIO = ('ratio', 'gain_error'), -0.55  # nothing real is all but absent
_TO_AND_FRO = ('position_friction', 'friction_asymmetry')  # as much off one way as the other
_AT_LIMIT = 0.01      # relative
# what is measured as torque has passed these already
_OF_COMMANDS = ('actuator_deadzone', 'actuator_saturation')


def all_guesses(problem, without=(), fine_orders=None):
    """
    Return what is looked for.

    Parameters
    ----------
    problem : Problem
        The recordings and the robot.
    without : collection of str
        Effects that are left out.
    fine_orders : sequence of tuple of float, optional
        Orders of waves finer than those guessed that are looked for as well, per joint.

    Returns
    -------
    list of (str, str, Guess)
        Effect, joint and Guess; effects of the whole arm for planar arms only.

    """
    joints, unseen, found = problem.robot.joints, problem.unseen, []
    if not all(path.commanded for path in problem.paths):
        without = {*without, *_OF_COMMANDS}
    scales = scales_of(problem.paths, problem.robot, fine_orders or [()] * len(joints))
    for name in names():
        kind = find(name)
        if name in without or (kind.whole_arm and problem.robot.arm.kind != 'planar'):
            continue
        places = [WHOLE_ARM] if kind.whole_arm else joints
        for joint, scale in zip(places, scales, strict=False):
            if joint in unseen and is_lost(name):
                continue
            bounds = bounds_of(kind, joint, problem.robot)
            found += [(name, joint, allowed(guess, *bounds)) for guess in kind.guesses(scale)]
    return found


def bounds_of(kind, joint, robot):
    """Return the least and the largest values that are looked for of an effect's parameters."""
    lower = [kind.slowest if one.name == 'order' else one.lower for one in kind.parameters]
    upper = [one.upper for one in kind.parameters]
    for i, parameter in enumerate(kind.parameters):
        if parameter.unit == '1' and parameter.name in _RATIOS:
            lower[i] = max(lower[i], _LEAST_RATIO)
            if kind.name in _TO_AND_FRO:
                upper[i] = min(upper[i], -_LEAST_RATIO)
    if kind.name == 'viscous_error':  # all of it may be gone either way
        j, friction = robot.joints.index(joint), robot.friction
        lower[0] = -max(friction.forward.viscous[j], friction.backward.viscous[j])
    return lower, upper


def is_at_limit(spec, robot):
    """
    Return whether an effect has a parameter where the search for it ends, which is no value.

    What the catalogue allows is such an end, too, unless physics ends there: at zero, or a share.
    """
    kind = find(spec.name)

    def is_end(limit, allowed, unit):
        """Return whether a limit of the search, beside what the catalogue allows, is no value."""
        return limit != allowed or (np.isfinite(limit) and limit != 0.0 and unit != '1')
    return any(
        is_end(lower, one.lower, one.unit) and value < lower + _AT_LIMIT * abs(lower)
        or is_end(upper, one.upper, one.unit) and value > upper - _AT_LIMIT * abs(upper)
        for one, value, lower, upper in zip(
            kind.parameters, spec.values, *bounds_of(kind, spec.joint, robot), strict=True))


def allowed(guess, lower, upper):
    """Return a Guess whose values keep within the bounds of an effect's parameters."""
    size = guess.probes[0][0]
    if guess.is_linear and size > 0.0:  # its coefficient has bounds, too
        guess = guess._replace(lowest=max(guess.lowest, lower[0] / size),
                               highest=min(guess.highest, upper[0] / size))

    def within(c):
        asked = guess.values(c)[0]
        return min(upper[0] / asked, 1.0) if asked > 0.0 else 1.0
    return guess._replace(values=lambda c: tuple(np.clip(guess.values(c), lower, upper).tolist()),
                          within=within)
