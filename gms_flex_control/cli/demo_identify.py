# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex demo-identify`: the identification experiment over real ROS 2, from nothing."""

import json
from pathlib import Path
import time
from typing import NamedTuple

from gms_flex_control.cli.output import conclude, import_ros, prepare, refuse_foreign, say

RATE = 500.0  # joint states per second [Hz]
BELIEVED_FRICTION = 0.8  # of the true one, before identification
ALLOWED = 1.5  # rms error of tracking, identified over true, medians of robots alike
MOTIONS = ('sinusoid', 'polynomial')
MARKER = '.gms_flex_demo_identify'
_HEADING = (
    'Tracking error, rms, by what the controller believes of the friction: one run over DDS, and',
    'in brackets the median of 16 simulated robots whose presliding differs by 0.1 %. In one run',
    'chance decides what a good compensation leaves; the ratio is that of the medians.')


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'demo-identify', help='the identification experiment over ROS 2',
        description='Start plant, controller, trajectory and identification node as processes '
                    'in lockstep, faster than real time, record the identification '
                    f'experiment (controller and experiment believe friction x '
                    f'{BELIEVED_FRICTION:g}), fit the friction, and track the trajectories of '
                    'the paper with the friction believed before, identified, and true. '
                    f'Exit code 1 if tracking with identified friction is more than '
                    f'{ALLOWED:g} times worse than with the true one.')
    parser.add_argument('--out', default='demo_identify_output', metavar='DIR',
                        help='folder for everything; made anew (default: %(default)s)')
    parser.add_argument('--plan', metavar='YAML',
                        help='parameters of the experiment (default: '
                             'config/identification_demo.yaml)')
    parser.add_argument('--json', action='store_true', help='print the outcome as JSON')
    parser.set_defaults(run=run)


def run(args):
    """Drive the experiment, fit it, track with the result; return 0 if that is good enough."""
    begin, out = time.monotonic(), Path(args.out)
    refuse_foreign(out, MARKER, 'demo-identify')
    experiment = read_experiment(args.plan)
    import_ros()  # which the processes will need
    prepare(out, MARKER)
    bag = drive(out, experiment)
    verdict, lines, values = 0, [], {}
    if {step.joint for step in experiment.plan.experiments} == set(experiment.believed.joints):
        text = fit(out, bag, experiment)
        if not args.json:
            print(f'{text}\n', flush=True)
        verdict, lines, values = compare(out)
    else:
        lines = ['no fit: the plan leaves out a joint, whose friction moves the others']
    if args.json:
        print(json.dumps({'bag': str(bag), 'tracking': values, 'allowed': ALLOWED}, indent=2))
        return verdict
    print('\n'.join(['', *lines, '', f'done in {time.monotonic() - begin:.0f} s']))
    made = {'bag': bag, 'report': out / 'report.html', 'parameters': out / 'friction.yaml',
            'log': out / 'log'}
    made = {name: path for name, path in made.items() if path.exists()}
    if values:
        conclude(answer_of(values, out), made)
    else:
        print('\n'.join(map(str, made.values())))
    return verdict


def answer_of(values, out):
    """Return how the robot tracks with the friction identified, of the worst three links."""
    from gms_flex_control.answer import Answer, command, measured

    rows = [(f'error of link {j + 1}, {motion} [mrad]', *(
        of['copies'][name][j] for name in ('believed', 'identified', 'true')))
        for motion, of in values.items() for j in range(len(of['true']))]
    rows = sorted(rows, key=lambda row: row[3] / row[2])[:3]
    name, before, after, floor = rows[0]
    return Answer(
        f'With the friction identified tracking errors are at most {after / floor:.3g} times '
        f'those with the true friction, which are the floor; with what was believed they were '
        f'{before / floor:.3g} times as large there ({name.partition(" [")[0]}; medians of 16 '
        'robots).', ('believed', 'identified', 'true friction'),
        tuple(measured(*row) for row in rows), command(
            'view', *(out / 'tracking' / f'{MOTIONS[0]}_{name}' for name in (
                'believed', 'identified'))))


def fit(out, bag, experiment):
    """Identify the bag and write its outcome; return it as text beside the truth."""
    from gms_flex_control.bags import phases
    from gms_flex_control.identification.identify import identify
    from gms_flex_control.identification.output import write_friction, write_report_json
    from gms_flex_control.reports.identification import write_identification_report
    from gms_flex_control.reports.identification_text import identification_text
    from gms_flex_control.resources import robot_file
    from gms_flex_control.schema.files import load_robot

    found = identify([phases.read_experiment(bag)], experiment.believed, say=say)
    truth = load_robot(robot_file())
    write_friction(found, out / 'friction.yaml')
    write_report_json(found, out / 'report.json')
    write_identification_report(found, out, beside=truth, robot=[out / 'believed_robot.yaml'])
    return identification_text(found, beside=truth)


def compare(out):
    """
    Track the trajectories with three beliefs of the friction, over DDS and with robots alike.

    Parameters
    ----------
    out : Path
        Folder with believed_robot.yaml and friction.yaml.

    Returns
    -------
    verdict : int
        0 if identified friction tracks nearly as well as the true one, 1 if not.
    lines : list of str
        A table.
    values : dict
        Motion, belief, rms error of each link [rad], over DDS; with ``copies`` the medians.

    """
    from gms_flex_control.analysis.table4 import align
    from gms_flex_control.analysis.tracking import link_rms, tracking_of_copies
    from gms_flex_control.cli.demo import files_of, plan_of
    from gms_flex_control.experiment.driven import drive_recorded, DrivenPlan
    from gms_flex_control.resources import robot_file
    from gms_flex_control.schema.files import load_robot
    import numpy as np

    models = {'believed': out / 'believed_robot.yaml', 'identified': out / 'friction.yaml',
              'true': robot_file()}
    rows, worst, values = [], 0.0, {}
    for motion in MOTIONS:
        rms, usual, plan = {}, {}, plan_of(motion, 'gms')
        for name, model in models.items():
            say(f'tracking the {motion} over DDS, friction as {name}')
            rms[name] = link_rms(drive_recorded(
                DrivenPlan(files=files_of(motion), model=model, compensation='gms',
                           duration=plan.duration, rate=RATE),
                out / 'tracking' / f'{motion}_{name}', log=out / 'log'))
            usual[name] = np.median(tracking_of_copies(
                plan, load_robot([robot_file(), model])), axis=0)
        values[motion] = {name: error.tolist() for name, error in rms.items()} | {
            'copies': {name: error.tolist() for name, error in usual.items()}}
        ratio = usual['identified'] / usual['true']
        worst = max(worst, ratio.max())
        rows += [[motion, f'link {j + 1}', *(
            f'{1e3 * rms[name][j]:.3g} ({1e3 * usual[name][j]:.3g})' for name in models),
            f'{ratio[j]:.2f}'] for j in range(len(ratio))]
    table = align(['motion', '', *(f'{name} [mrad]' for name in models), 'identified / true'],
                  rows)
    verdict = f'worst ratio {worst:.2f}, {"within" if worst <= ALLOWED else "ABOVE"} {ALLOWED:g}'
    return int(worst > ALLOWED), [*_HEADING, table, verdict], values


class Experiment(NamedTuple):
    """What is run: a plan, its file, and what is believed of the robot before."""

    plan: object
    plan_file: Path
    believed: object
    gains: object


def read_experiment(plan_file=None):
    """Return the Experiment of a plan file; by default the short one of the package."""
    from dataclasses import replace

    from gms_flex_control.experiment.believed import scaled_friction
    from gms_flex_control.experiment.identification_plan import read_identification_plan
    from gms_flex_control.resources import controller_file, robot_file, share_path
    from gms_flex_control.schema.files import load_controller, load_robot

    robot = load_robot(robot_file())
    believed = replace(robot, friction=scaled_friction(robot.friction, BELIEVED_FRICTION))
    gains = load_controller(controller_file(), robot)
    plan_file = Path(plan_file or share_path() / 'config' / 'identification_demo.yaml')
    plan = read_identification_plan([plan_file], believed, gains)
    return Experiment(plan, plan_file, believed, gains)


def drive(out, experiment):
    """Run the experiment over DDS; return its bag (Path)."""
    from gms_flex_control.experiment.driven import drive_identification, DrivenIdentification
    from gms_flex_control.resources import controller_file, robot_file
    from gms_flex_control.schema.files import save_robot

    plan, model, bag = experiment.plan, out / 'believed_robot.yaml', out / 'bag'
    save_robot(experiment.believed, model, comment='The robot as it is believed to be before '
               f'identification: friction x {BELIEVED_FRICTION:g}.')
    say('compiling the inner loops (once)')
    warm_up(plan, experiment.believed, experiment.gains)
    joints = {step.joint for step in plan.experiments}
    say(f'{len(plan.experiments)} steps on {len(joints)} joints over DDS, '
        f'{plan.duration():.0f} s simulated')
    drive_identification(
        DrivenIdentification(files=(robot_file(), controller_file()), model=model,
                             plan=experiment.plan_file, duration=plan.duration(), rate=RATE),
        bag, log=out / 'log', say=lambda line: say(f'  {line}'))
    return bag


def warm_up(plan, robot, gains):
    """Compile all kernels into the cache that the node processes share."""
    from gms_flex_control.simulation.stepped import SteppedController, SteppedPlant
    import numpy as np
    plant = SteppedPlant(robot, period=1e-3, substeps=1)
    plant.advance(np.zeros(robot.n_joints))
    SteppedController(gains, robot).tick(plan.trajectory(plan.experiments[0]).sample(0.0), 0.0)
