# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which effects may stand beside each other in one model."""

_SCALED = {'stiffness_error'}
_SCALED_RIGID = {'link_inertia_error', 'motor_inertia_error'}
LATE = {'actuator_lag', 'input_delay'}


def may_join(spec, robot, known):
    """
    Return whether an effect may be added to a robot: not twice, and none that undoes another.

    The torque constant together with the stiffness, of a rigid joint with its inertia, would scale
    a whole joint, which no motion tells from other torque, and rows are smallest where all is
    nothing. Lag and delay of one actuator are told from each other hardly, from
    their sum not at all. The first effects, ``known`` many, have a size that nothing moves, so
    they undo none; one of the same name would have no place beside them in a file.
    """
    if any((one.name, one.joint) == (spec.name, spec.joint) for one in robot.effects):
        return False
    there = {one.name for one in robot.effects[known:] if one.joint == spec.joint}
    rigid = spec.joint in robot.joints and robot.arm.rigid[robot.joints.index(spec.joint)]
    scaled = _SCALED_RIGID if rigid else _SCALED
    excluded = set()
    if spec.name == 'torque_gain':
        excluded = scaled
    elif spec.name in scaled:
        excluded = {'torque_gain'}
    elif spec.name in LATE:
        excluded = LATE
    return not there & excluded
