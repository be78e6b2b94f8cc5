# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which effects may stand beside each other in one model."""

_SCALED = {'stiffness_error', 'motor_inertia_error'}
_SCALED_RIGID = {'link_inertia_error'}
_LATE = {'actuator_lag', 'input_delay'}


def may_join(spec, robot):
    """
    Return whether an effect may be added to a robot: not twice, and none that undoes another.

    The torque constant together with stiffness and inertia, of a rigid joint with that of its
    link, would scale a whole joint, which no motion tells from other torque, and rows are
    smallest where all is nothing. Lag and delay of one actuator are told from each other hardly,
    from their sum not at all.
    """
    there = {one.name for one in robot.effects if one.joint == spec.joint}
    if spec.name in there:
        return False
    rigid = spec.joint in robot.joints and robot.arm.rigid[robot.joints.index(spec.joint)]
    scaled = _SCALED_RIGID if rigid else _SCALED
    excluded = set()
    if spec.name == 'torque_gain':
        excluded = scaled
    elif spec.name in scaled:
        excluded = {'torque_gain'}
    elif spec.name in _LATE:
        excluded = _LATE
    return not there & excluded
