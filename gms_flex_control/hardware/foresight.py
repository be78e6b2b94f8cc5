# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Efforts that leave before anything else is done about the joint state they answer.

Bridge and controller of one process pass a state through some hundred calls of Python, which take
long where other programs have just had the caches. One compiled call comes to the same effort
where all is as it was. Both then do their work as ever, and have the last word.
"""

from array import array

from gms_flex_control.compiled import compiled
from gms_flex_control.control import cascade
from gms_flex_control.control.frozen_encoders import acting, look
from gms_flex_control.hardware.bridge import LONGEST_RAMP, RobotSide
from gms_flex_control.hardware.limits import is_within, limit
from gms_flex_control.hardware.mapping import first_bad, merge, NANOSECONDS, sort
from gms_flex_control.hardware.supervision import STOOD_STILL
from gms_flex_control.trajectory.polynomials import extrapolate
import numpy as np


@compiled
def answer(merging, mapping, within, allowed, before, torque, given, watching, law, following,
           effort) -> bool:
    """
    Write the ``effort`` (n_joints,) that bridge and controller would send, with nothing changed.

    Return False where they would report something: a broken limit, a frozen encoder, a missing
    reference. The arguments are their states: those of `merge`, as
    `StateMerger.expected` returns them; `JointMap.arrays`; `Limits.within` and `allowed`;
    the state ``before`` (4, n_joints), the ``torque`` given then, when it came and for how long
    it may rise [ns]; and what `Follower.outlook` returns.
    """
    q, dq, efforts, index, channel, slope, offset, others, time, cutoff, skew = merging[:11]
    latest, times, fresh, state, measured_effort = merging[11:]
    if first_bad(q, dq, index, slope, offset) >= 0:
        return False
    state, measured_effort = state.copy(), measured_effort.copy()
    newest = merge(q, dq, efforts, index, channel, slope, offset, others, time, cutoff, skew,
                   latest.copy(), times.copy(), fresh.copy(), state, measured_effort)[1]
    motor, actuator, scale, order = mapping
    sides, applied = np.empty_like(before), np.empty_like(torque)
    sort(state, measured_effort, torque, motor, actuator, scale, sides, applied)
    last, since, longest = given
    elapsed = (time - last) / NANOSECONDS
    if newest != time or not is_within(sides, before, elapsed, *within):
        return False
    sent, nothing, memory, motors, turn, threshold, patience = watching
    acts = np.empty_like(torque)
    acting(sent, applied, nothing, acts)
    if look(memory.copy(), sides[0], sides[1], sides[2], sides[3], acts, elapsed, motors, turn,
            threshold, patience):
        return False
    stamps, references, timeout = following
    nearest = np.abs(stamps - time).argmin()
    ahead = time - stamps[nearest]
    if abs(ahead) > timeout:
        return False
    reference = references[nearest]
    if ahead:
        reference = extrapolate(reference, ahead / NANOSECONDS)
    one, measured, constants, work, feeding, fed = law
    one, measured = one.copy(), measured.copy()
    for j in range(sides.shape[1]):
        measured[0].q_link[j], measured[0].dq_link[j] = sides[0, j], sides[1, j]
        measured[0].q_motor[j], measured[0].dq_motor[j] = sides[2, j], sides[3, j]
    cascade.tick_boxed(one, measured, reference, elapsed, constants, work, feeding, fed.copy())
    command = one[0].command
    if not np.isfinite(command).all():
        return False
    limited = np.empty_like(torque)
    limit(command, torque, min(since / NANOSECONDS, longest), sides[0], sides[1], *allowed,
          limited, np.empty(len(torque), np.bool_))
    for k in range(len(order)):
        effort[k] = limited[order[k]] / scale[order[k]] + 0.0
    return True


class Foresight:
    """
    What a ``bridge`` sends to its robot once a ``controller`` of this process has answered.

    ``controller`` is a ControllerNode, ``healths`` those of both nodes.
    """

    def __init__(self, bridge, healths, controller):
        self._bridge, self._healths = bridge, healths
        self._controller, self._follower = controller, controller.follower
        self._outlook, self._changes, self._torque = (), None, None
        self._efforts = np.zeros(len(bridge.torque))
        self._warm_up()

    def _warm_up(self):
        """Compile before the first state comes."""
        params, n = self._bridge.params, len(self._efforts)
        names, merger = list(params.joint_map.names), RobotSide(params).merger
        nothing = [array('d', bytes(8 * len(names)))] * 3
        merger.take(0, names, *nothing, 1, 1)
        self._answer(merger.expected(names, nothing, 2, 2), np.zeros(n), 1, (
            *self._follower.law(self._controller.sent),
            (np.zeros(1, dtype=int), np.zeros((1, 5, n)), 1)))

    def plan(self) -> None:
        """Note what the next answer depends on, after each state."""
        bridge = self._bridge
        stamp = bridge.robot.stamp
        self._outlook = ()
        if bridge.controller.answered == stamp == self._follower.last:  # in the order of things
            self._outlook = self._follower.outlook(self._controller.sent)
            self._changes, self._torque = self._follower.changes, bridge.torque

    def efforts(self, names, fields, stamp, now) -> list | None:
        """Return what answers a message, a list of efforts, or None where it is not known."""
        bridge = self._bridge
        if not (self._outlook and bridge.supervisor.active
                and self._changes == self._follower.changes and self._torque is bridge.torque
                and bridge.looked(now) < STOOD_STILL * NANOSECONDS
                and not bridge.controller.silent(now, bridge.params.silence_timeout)
                and not any(health.fault for health in self._healths)):
            return None
        merging = bridge.robot.merger.expected(names, fields, stamp, now)
        if not merging or not self._answer(merging, self._torque, now, self._outlook):
            return None
        return self._efforts.tolist()

    def _answer(self, merging, torque, now, outlook):
        bridge = self._bridge
        limits = bridge.params.limits
        return answer(merging, bridge.params.joint_map.arrays, limits.within, limits.allowed,
                      bridge.robot.rows, torque, (
                          bridge.robot.stamp, now - bridge.controller.given, LONGEST_RAMP),
                      *outlook, self._efforts)
