# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench demo-next`: a recording leaves two names, designed motions over ROS 2 one."""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
import os
from pathlib import Path

from bench.demos.discrepancy import compile_effects
from bench.demos.hidden_effect import random_error
from gms_flex_control.cli.demo import RATE
from gms_flex_control.cli.designs import report_separation, sets_of, Task, write_files
from gms_flex_control.cli.options import add_verb, JSON, number, option, out_folder, Verb
from gms_flex_control.cli.terminal import import_ros, prepare, refuse_foreign, say
from gms_flex_control.compiled import in_one_thread
from gms_flex_control.data.reader import read_recording
from gms_flex_control.design.plan import clipped, separate
from gms_flex_control.experiment.driven import (
    drive_recorded,
    DrivenPlan,
    LISTENERS,
    private_environment,
    Processes,
)
from gms_flex_control.experiment.simulated import read_plan
from gms_flex_control.file_io import controller_file, robot_file, share_path
from gms_flex_control.schema.files import load_controller, load_limits, load_robot, save_robot
import numpy as np

_TORQUE = 3.0      # times the limits of config/bridge.yaml: those are of a first start
_PATIENCE = 120.0  # for nodes to start, compiling included [s]
VERB = Verb(
    'demo-next', lambda args: demo_next(args),
    'two names for one recording; designed motions leave one, over ROS 2',
    'Hide a play in the second joint and record a slow motion one way: friction presses the gear '
    'to one side, which an offset of the spring explains as well. Then design, drive and record '
    'motions until one of both names is left. Exit code 1 if it is not the true one.', (
        option('--effects', nargs='+', metavar='EFFECT:JOINT',
               default=['backlash:joint2', 'spring_offset:joint2'],
               help='explanations (default: %(default)s)'),
        option('--seed', type=int, default=0, least=0, help='of what is believed of the robot'),
        number('--budget', 'S', 30.0, 'robot time after the first recording', least=8.0,
               most=3600.0),
        out_folder('folder for everything; made anew', 'demo_next_output'), JSON), ())
add_parser = partial(add_verb, VERB)


def demo_next(args) -> int:
    """Drive, design, drive until one name is left; return 0 if it is that of what is hidden."""
    out = Path(args.out)
    refuse_foreign(out, VERB.name)
    runner = import_ros('gms_flex_control.nodes.step_runner')
    os.environ.update(private_environment())  # of the nodes and of this process
    prepare(out, VERB.name)
    believed, plant = (out / f'{name}_robot.yaml' for name in ('believed', 'hidden'))
    motion = Path(__file__).with_name('next.yaml')
    hidden, task = _written(args, believed, plant, motion, out / 'first')
    files = believed, controller_file(), motion
    compile_effects((files, plant))
    duration = read_plan([*files, plant]).duration
    say(f'first recording over DDS, {duration:g} s')
    drive_recorded(DrivenPlan(files=files, model=believed, compensation='gms', rate=RATE,
                              plant=plant, duration=duration), out / 'first', log=out / 'log')
    with in_one_thread(), np.errstate(all='ignore'):
        found = separate(task.recordings(), task.robot, task.sets, task.gains, task.limits,
                         partial(_driven, runner, files[:2], plant, out), period=task.period,
                         budget=args.budget, longest=args.budget, say=say)
    report_separation(found, task, [believed], out, args)
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
    return (frozenset(spec.key for spec in robot.effects),
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


@contextmanager
def stepped_loop(files, model: Path, plant: Path, rate: float, *, log: Path) -> Generator:
    """
    Run plant, controller and trajectory node in lockstep for the ``with`` block.

    Arguments as the fields of DrivenPlan; the reference stays where the robot is.
    """
    with Processes(dict(os.environ), log) as processes:
        processes.start_node('controller', [*files, model])
        processes.start_node('trajectory', files)
        processes.start_node('plant', [*files, plant],
                             {'rate': rate, 'wait_for_subscribers': LISTENERS})
        yield processes
        processes.stop_all('plant', 'trajectory', 'controller')
