# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Torques that were recorded after the motion they caused: a fault of the data, no physics."""

from gms_flex_control.discrepancy.fit import fit

_MOST = 2             # samples
_LEFT = 0.1           # of what is missing: less remains where that is the fault


def samples_late(problem, found):
    """
    Return by how many samples torques stand late in the recordings of a Problem.

    Parameters
    ----------
    problem : Problem
        In which something is missing.
    found : Found
        The search's end: the robot as believed, re-tuned, and with what was found.

    Returns
    -------
    int
        0 where no such shift explains nearly all, and more than what was found does.

    """
    if problem.unseen:
        return 0  # where links are is computed from these torques
    before, knobs = found.before, found.columns[:len(problem.knobs)]
    late = 0
    least = min(_LEFT * problem.missing(before), problem.missing(found.model))
    for count in range(1, _MOST + 1):
        earlier = problem.along([path.with_torque_earlier(count) for path in problem.paths])
        model = fit(earlier, before.robot, before.x, knobs, first=len(before.robot.effects))
        missing = earlier.missing(model)
        if missing < least:
            late, least = count, missing
    return late
