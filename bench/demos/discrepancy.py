# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench demo-discrepancy`: an effect is hidden, found over ROS 2, and driven with."""

from functools import partial
from pathlib import Path
import time

from bench.demos import page
from bench.demos.hidden_effect import hide_effect
from gms_flex_control.cli.demo import compile_loops, RATE
from gms_flex_control.cli.options import add_verb, JSON, number, option, out_folder, Verb
from gms_flex_control.cli.terminal import conclude, import_ros, prepare, refuse_foreign, say
from gms_flex_control.discrepancy.compared import with_closed_loop
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.experiment.driven import drive_recorded, DrivenPlan
from gms_flex_control.experiment.simulated import read_plan
from gms_flex_control.file_io import controller_file, robot_file
from gms_flex_control.reports.discrepancy_values import write_robot
from gms_flex_control.schema.files import load_controller, load_robot, save_robot, save_values

VERB = Verb(
    'demo-discrepancy', lambda args: demo_discrepancy(args),
    'hide an effect, find it over ROS 2, drive with it known',
    'Hide an effect, drawn by a seed, in the simulated robot; drive it with plant, controller and '
    'trajectory as three processes in lockstep and record a bag; find what the model believed in '
    'lacks (the tool gets no more than bag and robot file, every parameter 1 to 3 % off); drive '
    'the same motion with what was found, and with the true model. Exit code 0 if the name is '
    'right and the gap shrank, 1 if not.', (
        out_folder('folder for everything; made anew', 'demo_discrepancy_output'),
        option('--seed', type=int, default=0, metavar='N', least=0,
               help='of effect, joint, size, errors of the model and motion (default: '
                    '%(default)s)'),
        option('--effect', metavar='NAME',
               help='hide this one of the catalogue; default: one is drawn that a controller can '
                    'compensate'),
        number('--duration', 'S', 60.0, 'of the motion, simulated'), JSON), ())
add_parser = partial(add_verb, VERB)


def demo_discrepancy(args) -> int:
    """Hide, drive, find, drive again and report; return 0 if the name is right, the gap less."""
    begin, out = time.monotonic(), Path(args.out)
    refuse_foreign(out, VERB.name)
    import_ros()  # which the processes will need
    hidden, gains = _draw(args)
    prepare(out, VERB.name)
    outcome = _found_and_driven(hidden, gains, args.seed, _write_files(hidden, out), out)
    say('writing the report')
    page.write_demo_report(outcome, out)
    if args.json:
        print((out / 'report.json').read_text(encoding='utf-8'), end='')
    else:
        print(f'{page.outcome_text(outcome)}\n\ndone in {time.monotonic() - begin:.0f} s')
        conclude(page.demo_answer(outcome), {
            'report': out / 'report.html', 'numbers': out / 'report.json',
            'model': out / 'robot.yaml', 'bags': out / 'bags'})
    return int(not (outcome.named and outcome.shrank))


def _draw(args):
    say('drawing what is hidden')
    robot = load_robot(robot_file())
    gains = load_controller(controller_file(), robot)
    return hide_effect(robot, gains, args.seed, effect=args.effect,
                       duration=args.duration), gains


def _write_files(hidden, out):
    """Write robot and motion for the nodes; return the files that all of them get, and plant's."""
    believed, motion, plant = (out / name for name in (
        'believed_robot.yaml', 'trajectory.yaml', 'hidden_robot.yaml'))
    save_robot(hidden.believed, believed, comment='The robot as it is believed to be: every '
               'parameter 1 to 3 % off.')
    save_robot(hidden.robot, plant, comment='The robot as it is; unknown to the tool.')
    save_values(hidden.trajectory_values(), motion)
    return (believed, controller_file(), motion), plant


def _found_and_driven(hidden, gains, seed, files, out):
    """Drive, find, and drive again with what was found and with the truth: a DemoOutcome."""
    (believed, *_), plant = files
    compile_effects(files)
    recordings = {}

    def driven(belief, model):
        say(f'three nodes over DDS, {hidden.duration:g} s simulated: the controller believes the '
            f'model {belief}')
        recordings[belief] = drive_recorded(
            DrivenPlan(files=files[0], model=model, compensation='gms', rate=RATE, plant=plant,
                       duration=hidden.duration), out / 'bags' / belief, log=out / 'log')

    driven('believed', believed)
    result = _find(recordings['believed'], believed, gains, out / 'robot.yaml')
    driven('found', out / 'robot.yaml' if result.robot is not None else believed)
    driven('true', plant)
    return page.DemoOutcome(hidden, seed, result, recordings)


def compile_effects(files) -> None:
    """Compile all kernels, those for effects as well, into the cache that the nodes share."""
    for model in files[0][0], files[1]:
        compile_loops(read_plan([*files[0], files[1]], model=model, overrides={'rate': RATE}))


def _find(recording, believed, gains, path):
    """Ask the workflow about a recording; write the model found; return the Discrepancy."""
    result = find_discrepancy([recording], load_robot(believed),
                              say=lambda text: say(f'  {text} ...'))
    result = with_closed_loop(result, [recording], gains)
    if result.robot is not None:
        write_robot(result, path)
    return result
