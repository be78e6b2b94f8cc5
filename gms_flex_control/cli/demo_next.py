# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The verb `demo-next`: a first recording leaves two names, designed motions over ROS 2 one."""

from dataclasses import replace
from functools import partial
import os
from pathlib import Path

from gms_flex_control import blas
from gms_flex_control.cli.demos import compile_effects, RATE
from gms_flex_control.cli.designs import report_separation, sets_of, Task, write_files
from gms_flex_control.cli.terminal import import_ros, prepare, refuse_foreign, say
from gms_flex_control.data.reader import read_recording
from gms_flex_control.design.plan import clipped
from gms_flex_control.design.sequential import separate
from gms_flex_control.experiment.believed import random_error
from gms_flex_control.experiment.driven import (
    drive_recorded,
    DrivenPlan,
    private_environment,
    stepped_loop,
)
from gms_flex_control.experiment.simulated import read_plan
from gms_flex_control.resources import controller_file, robot_file, share_path
from gms_flex_control.schema.files import load_controller, load_limits, load_robot, save_robot
import numpy as np

_TORQUE = 3.0      # times the limits of config/bridge.yaml: those are of a first start
_PATIENCE = 120.0  # for nodes to start, compiling included [s]


def demo_next(args) -> int:
    """Drive, design, drive until one name is left; return 0 if it is that of what is hidden."""
    out = Path(args.out)
    refuse_foreign(out, 'demo-next')
    runner = import_ros('gms_flex_control.nodes.motion_runner')
    os.environ.update(private_environment())  # of the nodes and of this process
    prepare(out, 'demo-next')
    believed, plant = (out / f'{name}_robot.yaml' for name in ('believed', 'hidden'))
    motion = share_path() / 'config' / 'demo_next.yaml'
    hidden, task = _written(args, believed, plant, motion, out / 'first')
    files = believed, controller_file(), motion
    compile_effects((files, plant))
    duration = read_plan([*files, plant]).duration
    say(f'first recording over DDS, {duration:g} s')
    drive_recorded(DrivenPlan(files=files, model=believed, compensation='gms', rate=RATE,
                              plant=plant, duration=duration), out / 'first', log=out / 'log')
    with blas.in_one_thread(), np.errstate(all='ignore'):
        found = separate(task.recordings(), task.robot, task.sets, task.gains, task.limits,
                         partial(_driven, runner, files[:2], plant, out), period=task.period,
                         budget=args.budget, longest=args.budget, say=say)
    report_separation(found, task, [believed], out, args.json)
    return int([one.effects for one in found.left] != [hidden])


def _written(args, believed, plant, motion, bag):
    """Write both robots; return what is hidden, and the Task whose first recording is ``bag``."""
    robot = load_robot([robot_file(), motion])
    known = random_error(np.random.default_rng(args.seed), robot)
    save_robot(known, believed, comment='The robot as it is believed to be: every parameter 1 to '
               '3 % off.')
    save_robot(robot, plant, comment='The robot as it is; unknown to the tool.')
    limits = load_limits([share_path() / 'config' / 'bridge.yaml'], known.joints)
    limits = replace(limits, torque=_TORQUE * limits.torque)
    gains = clipped(load_controller(controller_file(), known), limits)
    return (frozenset((spec.name, spec.joint) for spec in robot.effects),
            Task(known, gains, limits, [bag], sets_of(args.effects, known), 1.0 / RATE))


def _driven(runner, files, plant, out, plan, number):
    """Start the nodes, drive and record a plan as `gms_flex next --run` does; return it."""
    folder, log, robot = out / str(number), out / 'log' / str(number), plan.beliefs.robot
    write_files(plan, folder)
    say(f'three nodes over DDS: {plan.best.candidate.words}, {plan.best.duration:.0f} s')
    with stepped_loop(files, files[0], plant, RATE, log=log):
        runner.drive_motion(plan.best.candidate.parameters, plan.best.duration, folder / 'bag',
                            patience=_PATIENCE, say=say)
    return read_recording(folder / 'bag', robot.joints, robot.motors)
