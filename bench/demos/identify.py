# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench demo-identify`: the identification experiment over ROS 2, and its use."""

from dataclasses import dataclass, replace
from functools import partial
import json
from pathlib import Path
import re
import time
from typing import NamedTuple

from bench.demos.hidden_effect import link_rms
from bench.identification_simulated import read_identification_plan
from bench.known import beside_truth
from gms_flex_control.answer import align, Answer, command, measured
from gms_flex_control.cli.demo import files_of, plan_of, RATE, step_loops
from gms_flex_control.cli.options import add_verb, JSON, option, out_folder, Verb
from gms_flex_control.cli.terminal import conclude, import_ros, prepare, refuse_foreign, say
from gms_flex_control.cli.verbs import DEMO_MOTIONS
from gms_flex_control.data import reader
from gms_flex_control.experiment.driven import (
    drive_recorded,
    DrivenPlan,
    LISTENERS,
    private_environment,
    Processes,
    SLOWEST_STEPS,
    START_BOUND,
)
from gms_flex_control.experiment.simulated import scaled_friction, simulate
from gms_flex_control.file_io import controller_file, robot_file, write_json
from gms_flex_control.identification.identify import identify
from gms_flex_control.identification.output import report_json, write_friction
from gms_flex_control.reports.answers import identification_text
from gms_flex_control.reports.recordings_page import write_identification_report
from gms_flex_control.schema.files import load_controller, load_robot, save_robot
import numpy as np

BELIEVED_FRICTION = 0.8  # of the true one, before the identification
ALLOWED = 1.5  # rms error of tracking, identified over true, medians of robots alike
_PROGRESS = re.compile(r'\[identification\]: +(\d+ %, .*)')
_HEADING = (
    'Tracking error, rms, by what the controller believes of the friction: one run over DDS, and',
    'in brackets the median of 16 simulated robots whose presliding differs by 0.1 %. In one run',
    'chance decides what a good compensation leaves; the ratio is that of the medians.')

VERB = Verb(
    'demo-identify', lambda args: demo_identify(args), 'the identification experiment over ROS 2',
    'Start plant, controller, trajectory and identification node as processes in lockstep, faster '
    'than real time, record the identification experiment (controller and experiment believe '
    f'friction x {BELIEVED_FRICTION:g}), fit the friction, and track the trajectories of the '
    'paper with the friction believed before, identified, and true. Exit code 1 if tracking with '
    f'identified friction is more than {ALLOWED:g} times worse than with the true one.', (
        out_folder('folder for everything; made anew', 'demo_identify_output'),
        option('--plan', metavar='YAML',
               help='parameters of the experiment (default: bench/demos/identification.yaml)'),
        JSON), ())
add_parser = partial(add_verb, VERB)


def demo_identify(args) -> int:
    """Drive the experiment, fit it, track with the result; return 0 if that is good enough."""
    begin, out = time.monotonic(), Path(args.out)
    refuse_foreign(out, VERB.name)
    experiment = read_experiment(args.plan)
    import_ros()  # which the processes will need
    prepare(out, VERB.name)
    bag = _drive_experiment(out, experiment)
    verdict, lines, values = 0, [], {}
    if {step.joint for step in experiment.plan.experiments} == set(experiment.believed.joints):
        text = fit_experiment(out, bag, experiment)
        if not args.json:
            print(f'{text}\n', flush=True)
        verdict, lines, values = _track(out)
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
        conclude(_identified_answer(values, out), made)
    else:
        print('\n'.join(map(str, made.values())))
    return verdict


def _identified_answer(values, out):
    """Return how the robot tracks with the friction identified, of the worst three links."""
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
            'view', *(out / 'tracking' / f'{DEMO_MOTIONS[0]}_{name}' for name in (
                'believed', 'identified'))))


def fit_experiment(out, bag, experiment) -> str:
    """Identify the bag and write its outcome; return it as text beside the truth."""
    found = identify([reader.read_experiment(bag)], experiment.believed, say=say)
    truth = load_robot(robot_file())
    write_friction(found, out / 'friction.yaml')
    write_json(out / 'report.json', report_json(found))
    write_identification_report(found, out, robot=[out / 'believed_robot.yaml'])
    return f'{identification_text(found)}\n\n{beside_truth(found, truth)}'


def _track(out):
    """
    Track the trajectories with three beliefs of the friction, over DDS and with robots alike.

    ``out`` has believed_robot.yaml and friction.yaml. Returned are 0 if the friction identified
    tracks nearly as well as the true one, else 1; a table (list of str); and by motion and belief
    the rms error of each link [rad] over DDS, with ``copies`` the medians (dict).
    """
    models = {'believed': out / 'believed_robot.yaml', 'identified': out / 'friction.yaml',
              'true': robot_file()}
    rows, worst, values = [], 0.0, {}
    for motion in DEMO_MOTIONS:
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


def read_experiment(plan_file=None) -> Experiment:
    """Return the Experiment of a plan file; by default the short one beside this file."""
    robot = load_robot(robot_file())
    believed = replace(robot, friction=scaled_friction(robot.friction, BELIEVED_FRICTION))
    gains = load_controller(controller_file(), robot)
    plan_file = Path(plan_file or Path(__file__).with_name('identification.yaml'))
    plan = read_identification_plan([plan_file], believed, gains)
    return Experiment(plan, plan_file, believed, gains)


def _drive_experiment(out, experiment):
    plan, model, bag = experiment.plan, out / 'believed_robot.yaml', out / 'bag'
    save_robot(experiment.believed, model, comment='The robot as it is believed to be before '
               f'identification: friction x {BELIEVED_FRICTION:g}.')
    step_loops(experiment.believed, experiment.believed, experiment.gains,
               plan.trajectory(plan.experiments[0]))
    joints = {step.joint for step in plan.experiments}
    say(f'{len(plan.experiments)} steps on {len(joints)} joints over DDS, '
        f'{plan.duration():.0f} s simulated')
    drive_identification(
        DrivenIdentification(files=(robot_file(), controller_file()), model=model,
                             plan=experiment.plan_file, duration=plan.duration(), rate=RATE),
        bag, log=out / 'log', say=lambda line: say(f'  {line}'))
    return bag


@dataclass(frozen=True, kw_only=True)
class DrivenIdentification:
    """One identification experiment over DDS in lockstep."""

    files: tuple     # of Path: robot as it is, and controller parameters
    model: Path      # robot file that controller and experiment believe in
    plan: Path       # parameters of the experiment, such as config/identification.yaml
    duration: float  # expected, simulated [s]
    rate: float      # joint states per simulated second [Hz]


def drive_identification(experiment: DrivenIdentification, bag: Path, *, log: Path,
                         say=print) -> None:
    """
    Run plant, controller, trajectory and identification node until the experiment is over.

    ``say`` gets a line of progress for each step; all else as of `drive`.
    """
    believed = [*experiment.files, experiment.model]
    bound = START_BOUND + experiment.duration * experiment.rate / SLOWEST_STEPS
    said = 0
    with Processes(private_environment(), log) as processes:
        def report():
            nonlocal said
            lines = _PROGRESS.findall(processes.printed('identification'))
            for line in lines[said:]:
                say(line)
            said = len(lines)

        processes.start_node('controller', believed)
        processes.start_node('trajectory', experiment.files)
        processes.start_node('identification', [*believed, experiment.plan],
                             {'identification.bag': bag, 'identification.fit': False})
        processes.start_node('plant', experiment.files, {
            'rate': experiment.rate, 'wait_for_subscribers': LISTENERS})
        processes.wait('identification', bound, report)
        processes.stop_all('plant', 'trajectory', 'controller')


def tracking_of_copies(plan, model, count=16, spread=1e-3, seed=0) -> np.ndarray:
    """
    Return the rms tracking errors (count, n) [rad] of robots whose friction differs a little.

    Compensated well, what is left of an error is made of single events: a link that sticks a
    moment too long. Whether one happens hangs on friction to a millionth, so one run says little;
    the median over robots that differ by less than anyone could know says what to expect.
    ``spread`` is the standard deviation of each stiffness of their blocks, relative; a ``seed``
    gives every model the same robots.
    """
    rng, friction, errors = np.random.default_rng(seed), plan.robot.friction, []
    for _ in range(count):
        factor = 1.0 + spread * rng.standard_normal(friction.stiffness.shape)
        robot = replace(plan.robot, friction=replace(
            friction, stiffness=factor * friction.stiffness))
        own = replace(plan, robot=robot, model=model)
        errors.append(link_rms(simulate(own, 'copy')))
    return np.array(errors)
