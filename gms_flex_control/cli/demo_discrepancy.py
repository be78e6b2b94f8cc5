# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex demo-discrepancy`: an effect hidden in the plant, found, added and compensated."""

from pathlib import Path
import time

from gms_flex_control.cli.output import conclude, import_ros, prepare, refuse_foreign, say

RATE = 500.0  # joint states per second [Hz]
MARKER = '.gms_flex_demo_discrepancy'


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'demo-discrepancy', help='hide an effect, find it over ROS 2, drive with it known',
        description='Hide an effect, drawn by a seed, in the simulated robot; drive it with '
                    'plant, controller and trajectory as three processes in lockstep and record '
                    'a bag; find what the model believed in lacks (the tool gets no more than '
                    'bag and robot file, every parameter 1 to 3 % off); drive the same motion '
                    'with what was found, and with the true model. Exit code 0 if the name is '
                    'right and the gap shrank, 1 if not.')
    parser.add_argument('--out', default='demo_discrepancy_output', metavar='DIR',
                        help='folder for everything; made anew (default: %(default)s)')
    parser.add_argument('--seed', type=int, default=0, metavar='N',
                        help='of effect, joint, size, errors of the model and motion (default: '
                             '%(default)s)')
    parser.add_argument('--effect', metavar='NAME',
                        help='hide this one of the catalogue; default: one is drawn that a '
                             'controller can compensate')
    parser.add_argument('--duration', type=float, default=60.0, metavar='S',
                        help='of the motion, simulated (default: %(default)g)')
    parser.add_argument('--json', action='store_true', help='print report.json, not the text')
    parser.set_defaults(run=run)


def run(args):
    """Hide, drive, find, drive again and report; return 0 if the name is right, the gap less."""
    from gms_flex_control.reports.discrepancy_demo import (
        demo_answer,
        outcome_text,
        write_demo_report,
    )

    begin, out = time.monotonic(), Path(args.out)
    refuse_foreign(out, MARKER, 'demo-discrepancy')
    import_ros()  # which the processes will need
    hidden, gains = draw(args)
    prepare(out, MARKER)
    outcome = found_and_driven(hidden, gains, args.seed, write_files(hidden, out), out)
    say('writing the report')
    write_demo_report(outcome, out)
    if args.json:
        print((out / 'report.json').read_text(encoding='utf-8'), end='')
    else:
        print(f'{outcome_text(outcome)}\n\ndone in {time.monotonic() - begin:.0f} s')
        conclude(demo_answer(outcome), {
            'report': out / 'report.html', 'numbers': out / 'report.json',
            'model': out / 'robot.yaml', 'bags': out / 'bags'})
    return int(not (outcome.named and outcome.shrank))


def draw(args):
    """Return the HiddenEffect that the arguments ask for, and the gains."""
    from gms_flex_control.demonstration import hide_effect
    from gms_flex_control.errors import ConfigError
    from gms_flex_control.resources import controller_file, robot_file
    from gms_flex_control.schema.files import load_controller, load_robot

    if args.seed < 0:
        raise ConfigError(f'--seed {args.seed}: give a whole number from 0 on')
    say('drawing what is hidden (compiles the inner loops once)')
    robot = load_robot(robot_file())
    gains = load_controller(controller_file(), robot)
    return hide_effect(robot, gains, args.seed, effect=args.effect,
                       duration=args.duration), gains


def write_files(hidden, out):
    """Write robot and motion for the nodes; return the files that all of them get, and plant's."""
    from gms_flex_control.resources import controller_file
    from gms_flex_control.schema.files import save_robot, save_values

    believed, motion, plant = (out / name for name in (
        'believed_robot.yaml', 'trajectory.yaml', 'hidden_robot.yaml'))
    save_robot(hidden.believed, believed, comment='The robot as it is believed to be: every '
               'parameter 1 to 3 % off.')
    save_robot(hidden.robot, plant, comment='The robot as it is; unknown to the tool.')
    save_values(hidden.trajectory_values(), motion)
    return (believed, controller_file(), motion), plant


def found_and_driven(hidden, gains, seed, files, out):
    """Drive, find, and drive again with what was found and with the truth: a DemoOutcome."""
    from gms_flex_control.experiment.driven import drive_recorded, DrivenPlan
    from gms_flex_control.reports.discrepancy_demo import DemoOutcome

    (believed, *_), plant = files
    warm_up(files)
    recordings = {}

    def driven(belief, model):
        say(f'three nodes over DDS, {hidden.duration:g} s simulated: the controller believes the '
            f'model {belief}')
        recordings[belief] = drive_recorded(
            DrivenPlan(files=files[0], model=model, compensation='gms', rate=RATE, plant=plant,
                       duration=hidden.duration), out / 'bags' / belief, log=out / 'log')

    driven('believed', believed)
    result = find(recordings['believed'], believed, gains, out / 'robot.yaml')
    driven('found', out / 'robot.yaml' if result.robot is not None else believed)
    driven('true', plant)
    return DemoOutcome(hidden, seed, result, recordings)


def warm_up(files):
    """Compile all kernels, those for effects as well, into the cache that the nodes share."""
    from gms_flex_control.cli.demo import warm_up as compile_loops
    from gms_flex_control.experiment.plan import read_plan
    for model in files[0][0], files[1]:
        compile_loops(read_plan([*files[0], files[1]], model=model, overrides={'rate': RATE}))


def find(recording, believed, gains, path):
    """Ask the workflow about a recording; write the model found; return the Discrepancy."""
    from gms_flex_control.discrepancy.closed_loop import with_closed_loop
    from gms_flex_control.discrepancy.workflow import find_discrepancy
    from gms_flex_control.reports.discrepancy_values import write_robot
    from gms_flex_control.schema.files import load_robot

    result = find_discrepancy([recording], load_robot(believed),
                              say=lambda text: say(f'  {text} ...'))
    result = with_closed_loop(result, [recording], gains)
    if result.robot is not None:
        write_robot(result, path)
    return result
