# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The effort that answers a joint state, from readings to the robot's units, in one call."""

from gms_flex_control.compiled import compiled
from gms_flex_control.control import controller
from gms_flex_control.control.frozen_encoders import acting, look
from gms_flex_control.hardware.limits import is_within, limit
from gms_flex_control.hardware.mapping import first_bad, merge, NANOSECONDS, sort
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
    measured[0].q_link[:], measured[0].dq_link[:] = sides[0], sides[1]
    measured[0].q_motor[:], measured[0].dq_motor[:] = sides[2], sides[3]
    controller.tick(one, measured, reference, elapsed, constants, work, feeding, fed.copy())
    command = one[0].command
    if not np.isfinite(command).all():
        return False
    limited = np.empty_like(torque)
    limit(command, torque, min(since / NANOSECONDS, longest), sides[0], sides[1], *allowed,
          limited, np.empty(len(torque), np.bool_))
    for k in range(len(order)):
        effort[k] = limited[order[k]] / scale[order[k]] + 0.0
    return True
