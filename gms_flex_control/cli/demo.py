# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The verb `demo`: the paper's experiment over ROS 2."""

from dataclasses import replace
from itertools import product
from pathlib import Path
import time

from gms_flex_control.answer import align
from gms_flex_control.cli.robots import trajectory_file
from gms_flex_control.cli.terminal import conclude, import_ros, prepare, refuse_foreign, say
from gms_flex_control.cli.verbs import DEMO_MOTIONS
from gms_flex_control.control.cascade import SteppedController
from gms_flex_control.experiment.driven import drive_recorded, DrivenPlan
from gms_flex_control.experiment.simulated import (
    mixed_error,
    Plan,
    read_plan,
    simulate,
    simulate_to_bag,
)
from gms_flex_control.file_io import controller_file, robot_file
from gms_flex_control.reports.recordings_page import write_tracking_report
from gms_flex_control.schema.files import load_robot, save_robot
from gms_flex_control.simulation.loop import SteppedPlant
from gms_flex_control.tuning.tracking import table4, TrackingRun
import numpy as np

RATE = 500.0  # joint states per second [Hz]


def demo(args) -> int:
    """Drive, simulate, analyse and print; return 0."""
    begin, out = time.monotonic(), Path(args.out)
    refuse_foreign(out, 'demo')
    import_ros()  # which the processes will need
    plans = {(motion, mode): plan_of(motion, mode, args.duration)
             for motion, mode in product(args.motions, args.modes)}
    prepare(out, 'demo')
    driven = _drive_all(plans, out)
    exact = _simulate_all(plans, out)
    text, answer = _report_all(driven, exact, out)
    if args.json:
        print((out / 'table4.json').read_text(encoding='utf-8'), end='')
        return 0
    print(f'{text}\n\ndone in {time.monotonic() - begin:.0f} s')
    conclude(answer, {'report': out / 'report.html', 'numbers': out / 'table4.json',
                      'bags': out / 'bags'})
    return 0


def files_of(motion) -> tuple[Path, ...]:
    """Return robot, controller and trajectory file of one motion (tuple of Path)."""
    return robot_file(), controller_file(), trajectory_file(motion)


def plan_of(motion, mode, duration=None) -> Plan:
    """Return the in-process Plan of one motion and compensation."""
    if duration is None and motion == 'sinusoid':  # which has no end
        duration = 20.0
    return read_plan(files_of(motion), duration=duration,
                     overrides={'compensation': mode, 'rate': RATE})


def _drive_all(plans, out):
    """Run every combination over DDS and return its runs, labelled, with their recordings."""
    compile_loops(next(iter(plans.values())))
    model = out / 'believed_robot.yaml'
    save_robot(mixed_error(load_robot(files_of(DEMO_MOTIONS[0])[0])), model, comment=(
        'The robot as the controller of the demo believes it to be:\n'
        'friction x 0.85, joint stiffness x 1.05, link masses x 0.93.'))
    runs = []
    for number, ((motion, mode), plan) in enumerate(plans.items(), 1):
        say(f'[{number}/{len(plans)}] three nodes over DDS: {motion}, {mode}, '
            f'{plan.duration:g} s simulated')
        begin = time.monotonic()
        recording = drive_recorded(
            DrivenPlan(files=files_of(motion), model=model, compensation=mode,
                       duration=plan.duration, rate=RATE),
            out / 'bags' / f'{motion}_{mode}', log=out / 'log')
        say(f'      {len(recording.time)} joint states in {time.monotonic() - begin:.1f} s')
        runs.append(TrackingRun(motion, mode, recording))
    return runs


def compile_loops(plan) -> None:
    """Compile all kernels into the cache that the node processes share."""
    simulate(replace(plan, duration=0.1))
    step_loops(plan.robot, plan.model, plan.gains, plan.trajectory)


def step_loops(robot, model, gains, trajectory) -> None:
    """Compile the kernels of plant and controller as the nodes step them."""
    plant = SteppedPlant(robot, period=1e-3, substeps=1)
    plant.advance(np.zeros(robot.n_joints))
    SteppedController(gains, model).tick(trajectory.sample(0.0), 0.0)


def _simulate_all(plans, out):
    """Simulate every combination with the exact model; its bags stand beside the others."""
    runs = []
    for (motion, mode), plan in plans.items():
        bag = out / 'bags' / 'exact_model' / f'{motion}_{mode}'
        runs.append(TrackingRun(motion, mode, simulate_to_bag(plan, bag)))
    say(f'simulated the same {len(runs)} with the exact model in this process')
    return runs


def _report_all(driven, exact, out):
    """Write table4.json, report.html and PNGs; return the tables as text, and the Answer."""
    say('writing the report')
    table = write_tracking_report(
        driven, out, title="The paper's experiment, section 6", beside={'exact model': exact},
        subtitle='Three ROS 2 nodes in lockstep; the controller believes friction x 0.85, '
                 'stiffness x 1.05, masses x 0.93')
    return (f'Model error: friction x 0.85, stiffness x 1.05, masses x 0.93\n{table.text()}\n\n'
            f'Exact model\n{align(*table4(exact).rows())}'), table.answer()
