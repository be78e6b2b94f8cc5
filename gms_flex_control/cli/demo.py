# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex demo`: the paper's experiment over real ROS 2, from nothing to Table 4."""

from itertools import product
from pathlib import Path
import time

from gms_flex_control.cli.output import conclude, import_ros, prepare, refuse_foreign, say

MOTIONS = ('sinusoid', 'polynomial')
MODES = ('none', 'gms_paper', 'gms')
RATE = 500.0  # joint states per second [Hz]
SINUSOID_DURATION = 20.0  # [s]
MARKER = '.gms_flex_demo'


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'demo', help="the paper's experiment over ROS 2, with table and report",
        description='Start plant, controller and trajectory as three processes for every '
                    "trajectory and compensation of the paper's section 6, record them into "
                    'bags, and write Table 4, a report and pictures. The controller believes a '
                    'robot with friction x 0.85, stiffness x 1.05 and masses x 0.93; the same '
                    'with the exact model is simulated in this process for comparison.')
    parser.add_argument('--out', default='demo_output', metavar='DIR',
                        help='folder for everything; made anew (default: demo_output)')
    parser.add_argument('--motions', nargs='+', default=MOTIONS, choices=MOTIONS,
                        help='trajectories (default: all)')
    parser.add_argument('--modes', nargs='+', default=MODES, choices=MODES,
                        help='compensations (default: all)')
    parser.add_argument('--duration', type=float, metavar='S',
                        help=f'simulated length of each run (default: sinusoid '
                             f'{SINUSOID_DURATION:g}, polynomial to its end)')
    parser.add_argument('--json', action='store_true', help='print table4.json, not the text')
    parser.set_defaults(run=run)


def run(args):
    """Drive, simulate, analyse and print; return 0."""
    begin, out = time.monotonic(), Path(args.out)
    refuse_foreign(out, MARKER, 'demo')
    import_ros()  # which the processes will need
    say('compiling the inner loops (once)')
    plans = {(motion, mode): plan_of(motion, mode, args.duration)
             for motion, mode in product(args.motions, args.modes)}
    prepare(out, MARKER)
    driven = drive_all(plans, out)
    exact = simulate_all(plans, out)
    text, answer = report_all(driven, exact, out)
    if args.json:
        print((out / 'table4.json').read_text(encoding='utf-8'), end='')
        return 0
    print(f'{text}\n\ndone in {time.monotonic() - begin:.0f} s')
    conclude(answer, {'report': out / 'report.html', 'numbers': out / 'table4.json',
                      'bags': out / 'bags'})
    return 0


def files_of(motion):
    """Return robot, controller and trajectory file of one motion (tuple of Path)."""
    from gms_flex_control.cli.simulate import trajectory_file
    from gms_flex_control.resources import controller_file, robot_file
    return robot_file(), controller_file(), trajectory_file(motion)


def plan_of(motion, mode, duration=None):
    """Return the in-process Plan of one motion and compensation."""
    from gms_flex_control.experiment.plan import read_plan
    if duration is None and motion == 'sinusoid':
        duration = SINUSOID_DURATION
    return read_plan(files_of(motion), duration=duration,
                     overrides={'compensation': mode, 'rate': RATE})


def drive_all(plans, out):
    """Run every combination over DDS and return its runs, labelled, with their recordings."""
    from gms_flex_control.analysis.tracking import Run
    from gms_flex_control.experiment.believed import mixed_error
    from gms_flex_control.experiment.driven import drive_recorded, DrivenPlan
    from gms_flex_control.schema.files import load_robot, save_robot

    warm_up(next(iter(plans.values())))
    model = out / 'believed_robot.yaml'
    save_robot(mixed_error(load_robot(files_of(MOTIONS[0])[0])), model, comment=(
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
        runs.append(Run(motion, mode, recording))
    return runs


def warm_up(plan):
    """Compile all kernels into the cache that the node processes share."""
    from dataclasses import replace

    from gms_flex_control.experiment.simulated import simulate
    from gms_flex_control.simulation.stepped import SteppedController, SteppedPlant
    import numpy as np
    simulate(replace(plan, duration=0.1))
    plant = SteppedPlant(plan.robot, period=1e-3, substeps=1)
    plant.advance(np.zeros(plan.robot.n_joints))
    SteppedController(plan.gains, plan.model).tick(plan.trajectory.sample(0.0), 0.0)


def simulate_all(plans, out):
    """Simulate every combination with the exact model; its bags stand beside the others."""
    from gms_flex_control.analysis.tracking import Run
    from gms_flex_control.experiment.simulated import simulate_to_bag
    runs = []
    for (motion, mode), plan in plans.items():
        bag = out / 'bags' / 'exact_model' / f'{motion}_{mode}'
        runs.append(Run(motion, mode, simulate_to_bag(plan, bag)))
    say(f'simulated the same {len(runs)} with the exact model in this process')
    return runs


def report_all(driven, exact, out):
    """Write table4.json, report.html and PNGs; return the tables as text, and the Answer."""
    from gms_flex_control.analysis.table4 import align
    from gms_flex_control.analysis.tracking import table4
    from gms_flex_control.reports.tracking import write_tracking_report
    say('writing the report')
    table = write_tracking_report(
        driven, out, title="The paper's experiment, section 6", beside={'exact model': exact},
        subtitle='Three ROS 2 nodes in lockstep; the controller believes friction x 0.85, '
                 'stiffness x 1.05, masses x 0.93')
    return (f'Model error: friction x 0.85, stiffness x 1.05, masses x 0.93\n{table.text()}\n\n'
            f'Exact model\n{align(*table4(exact).rows())}'), table.answer()
