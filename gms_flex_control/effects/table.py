# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Effects as compiled kernels run them: a table of function addresses sorted by stage.

Why addresses, and what the alternatives cost: docs/decisions.md.
"""

from dataclasses import replace

from gms_flex_control import records
from gms_flex_control.compiled import call_effect, compiled
from gms_flex_control.effects.base import Change, Effect, Stage, WIDTH
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import ParameterError
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.records import FLOAT
import numpy as np

_FLOAT_BYTES = 8
# fixed, so that every combination of effects is the same type to the kernels
MAX_TERMS, MAX_PARAMS, MEMORY_SIZE = 64, 256, 2048

LAYOUT = records.layout(
    ('address', np.intp, (MAX_TERMS,)),       # of the compiled functions, sorted by stage
    ('joint', np.intp, (MAX_TERMS,)),         # row of the signals
    ('first_param', np.intp, (MAX_TERMS,)),   # offset into params
    ('first_memory', np.intp, (MAX_TERMS,)),  # offset into the memory of the run
    ('stage_start', np.intp, (len(Stage) + 1,)),  # stage k: stage_start[k]:stage_start[k + 1]
    ('params', FLOAT, (MAX_PARAMS,)))


def with_changes(robot) -> RobotParams:
    """Return the robot with every `Change` put into its parameters, of joints before the arm's."""
    changes = [spec for spec in robot.effects if issubclass(find(spec.name), Change)]
    changes.sort(key=lambda spec: find(spec.name).whole_arm)  # stable
    robot = replace(robot, effects=tuple(s for s in robot.effects if s not in changes))
    for spec in changes:
        kind = find(spec.name)
        joint = 0 if kind.whole_arm else robot.joints.index(spec.joint)
        robot = kind.change(robot, joint, spec.values)
    return robot


def of_stages(robot, *stages) -> list:
    """Return the effects (EffectSpec) of a robot `with_changes` that act in some stages."""
    return [spec for spec in robot.effects if find(spec.name).stage in stages]


def is_friction(kind) -> bool:
    """Return whether parameters of the friction model express an effect as well."""
    return kind.in_friction is not Effect.in_friction


def changes_friction(spec, robot) -> bool:
    """Return whether parameters of the friction model of a robot express an EffectSpec."""
    kind = find(spec.name)
    if not issubclass(kind, Change):
        return is_friction(kind)
    joint = 0 if kind.whole_arm else robot.joints.index(spec.joint)
    return kind.change(robot, joint, spec.values).friction is not robot.friction


def with_friction(robot) -> RobotParams:
    """Return a robot with all effects in its friction parameters that these can express."""
    friction, left = robot.friction, []
    for spec in robot.effects:
        kind = find(spec.name)
        if not is_friction(kind):
            left.append(spec)
            continue
        at = np.arange(robot.n_joints) == robot.joints.index(spec.joint)
        values = [at * value for value in spec.values]
        friction = replace(friction, **{
            side: kind.in_friction(getattr(friction, side), direction, values)
            for side, direction in (('forward', 1.0), ('backward', -1.0))})
    return replace(robot, friction=friction, effects=tuple(left))


def build(effects, joints, arm=None) -> np.record:
    """Return EffectSpecs of terms as a record of `LAYOUT`, or raise ParameterError."""
    terms = [(find(spec.name), spec) for spec in effects]
    terms.sort(key=lambda term: term[0].stage)  # stable: the file's order within a stage
    rows = [0 if kind.whole_arm else joints.index(spec.joint) for kind, spec in terms]
    params = [value for (kind, spec), row in zip(terms, rows, strict=True)
              for value in (spec.values if arm is None else kind.on_arm(spec.values, arm, row))]
    sizes = [kind.memory_size for kind, _ in terms]
    for count, most, what in ((len(terms), MAX_TERMS, 'effects'),
                              (len(params), MAX_PARAMS, 'parameters of effects'),
                              (sum(sizes), MEMORY_SIZE, 'remembered numbers of effects')):
        if count > most:
            raise ParameterError(f'{count} {what} are more than the {most} that the model '
                                 'holds; remove the smallest effects')
    table = records.build(LAYOUT)
    table.address[:len(terms)] = [kind.compiled().address for kind, _ in terms]
    table.joint[:len(terms)] = rows
    table.first_param[:len(terms)] = np.cumsum([0, *(len(s.values) for _, s in terms)])[:-1]
    table.first_memory[:len(terms)] = np.cumsum([0, *sizes])[:-1]
    table.stage_start[:] = np.searchsorted([kind.stage for kind, _ in terms],
                                           range(len(Stage) + 1))
    table.params[:len(params)] = params
    return table


@compiled
def run_stage(stage, signals, memory, dt, table) -> None:
    """Apply the terms of one stage in place to ``signals`` (n, WIDTH) and ``memory``."""
    for k in range(table.stage_start[stage], table.stage_start[stage + 1]):
        call_effect(table.address[k],
                    signals.ctypes.data + _FLOAT_BYTES * WIDTH * table.joint[k],
                    table.params.ctypes.data + _FLOAT_BYTES * table.first_param[k],
                    memory.ctypes.data + _FLOAT_BYTES * table.first_memory[k], dt)
