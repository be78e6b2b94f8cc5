# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Gains from what is wanted of the loop: the stiffest that margins, noise and conditions allow.

With an exact model the link's error has the poles Lambda_1 and K_D1 / M (22), the motor's
Lambda_2 and K_D2 / J (30). A bandwidth ``w = sqrt(product)`` and a damping ``(sum) / 2w``, at
least 1, give both of a pair. Each joint is searched alone, with the largest and the smallest
inertia it can have in the arm; the whole arm is then judged in many poses.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.compiled import in_one_thread
from gms_flex_control.control import gain_conditions
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.key import of_joints
from gms_flex_control.tuning.linear_loop import Timing
from gms_flex_control.tuning.margins import demands_missed, judged, Judgement, UNSTABLE
import numpy as np

_LINK_STEPS, _MOTOR_STEPS = 24, 12
_SLOWEST = 0.3                   # link bandwidth tried [rad/s]
_FASTEST_LINK, _FASTEST_MOTOR = 0.1, 0.4   # of half the sample rate
_FASTER = 1.2                    # motor over link bandwidth, at least
_MORE_DAMPING = (1.0, 1.5, 2.25, 3.4)      # times what is required, where conditions want it
_DIGITS = 4                      # of a gain
_ROUNDS, _SLOWER = 10, 0.85      # of the whole arm; bandwidth of a joint that was too fast


class Demands(NamedTuple):
    """What is required of the loop."""

    timing: Timing
    torque_limit: np.ndarray   # (n,) [N m]
    damping: float = 1.0       # of the link's pair of poles, at least 1
    bandwidth: np.ndarray | None = None  # (n,) of the link [rad/s]; None: as much as possible
    gain: float = 2.0          # factor on the torque, up and down
    phase: float = np.pi / 6   # [rad]
    delay: float = 0.0         # further one to be tolerated [s]
    noise: float = 0.1         # rms torque encoders may cause, of the torque limit


class Proposal(NamedTuple):
    """Gains, how the arm was judged with them, and what is not met (sentences)."""

    gains: ControllerParams
    judgement: Judgement
    unmet: tuple


def propose(robot, base, demands) -> Proposal:
    """Propose gains, the nearest where ``unmet`` says why none fit; all else is as in ``base``."""
    with in_one_thread():  # threads would wait for each other at such small matrices
        return _proposed(robot, replace(base, torque_limit=demands.torque_limit), demands)


def _proposed(robot, base, demands):
    caps, found = np.full(robot.n_joints, np.inf), {}
    for _ in range(_ROUNDS):
        gains, missed = base, []
        for j in range(robot.n_joints):
            if (j, caps[j]) not in found:
                found[j, caps[j]] = _joint_gains(robot, base, demands, j, caps[j])
            values, why = found[j, caps[j]]
            gains = _with_joint(gains, j, values)
            missed += why
        judgement = judged(robot, robot, gains, demands.timing)
        unmet, too_fast = demands_missed(judgement, demands, robot)
        if missed or not too_fast or demands.bandwidth is not None:
            break
        for j in too_fast:
            caps[j] = _SLOWER * link_bandwidth(gains, robot)[j]
    return Proposal(gains, judgement, tuple(dict.fromkeys([*missed, *unmet])))


def _inertia_range(robot, joint):
    """Return least and largest inertia of a joint over all poses, others free or held [kg m^2]."""
    mass = gain_conditions.mass_matrices(robot.arm)
    free = 1.0 / np.linalg.inv(mass)[:, joint, joint]
    return float(free.min()), float(mass[:, joint, joint].max())


def link_bandwidth(gains, robot) -> np.ndarray:
    """Return sqrt(Lambda_1 K_D1 / M) of each joint at its largest inertia (n,) [rad/s]."""
    largest = [_inertia_range(robot, j)[1] for j in range(robot.n_joints)]
    return np.sqrt(gains.lambda_link * gains.kd_link / largest)


def pair(bandwidth, damping, inertia) -> tuple:
    """
    Return damping gain and rate of two real poles, ``bandwidth`` the root of their product.

    ``kd = inertia * rate * spread`` [N m s/rad], ``rate`` the slower pole [1/s]; damping >= 1.
    """
    spread = damping + np.sqrt(max(damping ** 2 - 1.0, 0.0))
    return _rounded(inertia * bandwidth * spread), _rounded(bandwidth / spread)


def _rounded(value):
    """Return a value with as many digits as a person would write into a file."""
    return float(f'{value:.{_DIGITS}g}')


def _one_axis(robot, joint, inertia):
    """Return a joint of a robot as an axis of its own with the given inertia."""
    arm, only = robot.arm, [joint]
    if arm.rigid[joint]:
        inertia = inertia - arm.motor_inertia[joint]
    alone = ArmParams(kind='decoupled', mass=[0.0], length=[0.0], com=[0.0], inertia=[inertia],
                      motor_inertia=arm.motor_inertia[only], stiffness=arm.stiffness[only],
                      damping=arm.damping[only])
    return replace(robot, joints=(robot.joints[joint],), motors=(robot.motors[joint],), arm=alone,
                   friction=robot.friction.of_joints(only), effects=())


def _joint_gains(robot, base, demands, joint, cap):
    """Return the gains of a joint (dict) and why they miss what is required (list of str)."""
    inertia = _inertia_range(robot, joint)
    axes = [_one_axis(robot, joint, value) for value in dict.fromkeys(inertia)]
    own = demands._replace(torque_limit=demands.torque_limit[[joint]], bandwidth=None)
    own_base = of_joints(base, [joint])
    nearest = None
    for wanted in ('all', 'exact'):
        for values in _candidates(robot, demands, joint, inertia[1], cap):
            gains = _with_joint(own_base, 0, values)
            if not all(one.met for one in gain_conditions.check(gains, axes[0]).conditions
                       if wanted == 'all' or one.kind == gain_conditions.EXACT):
                continue
            missed = _missed(axes, gains, own)
            if not missed:
                return values, []
            if nearest is None or _badness(missed) < _badness(nearest[1]):
                nearest = values, missed
    if nearest is None:
        values = next(_candidates(robot, demands, joint, inertia[1], cap))
        return values, [f'{robot.joints[joint]}: no gains within the bandwidths tried hold the '
                        'exact condition (39); a softer spring or a faster loop is needed']
    return nearest


def _badness(missed):
    """Return what orders sentences of demands missed: an unstable loop is the worst of all."""
    return any(one.endswith(UNSTABLE) for one in missed), len(missed)


def _missed(axes, gains, demands):
    found = []
    for axis in axes:
        judgement = judged(axis, axis, gains, demands.timing, with_delay=False)
        found += demands_missed(judgement, demands, axis)[0]
        if found:
            break
    return found


def _candidates(robot, demands, joint, inertia, cap):
    """Yield gains of a joint (dict), the stiffest link first, then the fastest motor."""
    highest = np.pi / demands.timing.period
    links = np.geomspace(_FASTEST_LINK * highest, _SLOWEST, _LINK_STEPS)
    if demands.bandwidth is not None:
        links = [float(demands.bandwidth[joint])]
    rigid = robot.arm.rigid[joint]
    for link in [link for link in links if link <= cap] or [links[-1]]:
        for more in _MORE_DAMPING:
            kd_link, lambda_link = pair(link, more * demands.damping, inertia)
            values = {'kd_link': kd_link, 'lambda_link': lambda_link}
            if rigid:
                yield values
                continue
            for motor in np.geomspace(_FASTEST_MOTOR * highest, _FASTER * link, _MOTOR_STEPS):
                kd_motor, lambda_motor = pair(motor, 1.0, robot.arm.motor_inertia[joint])
                yield values | {'kd_motor': kd_motor, 'lambda_motor': lambda_motor}


def _with_joint(gains, joint, values):
    changed = {}
    for name, value in values.items():
        changed[name] = getattr(gains, name).copy()
        changed[name][joint] = value
    return replace(gains, **changed)
