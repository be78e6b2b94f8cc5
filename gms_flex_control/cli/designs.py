# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The verbs `next` and `plan`: motions that separate explanations, or identify an arm best."""

import json
from pathlib import Path
import sys
from typing import NamedTuple

from gms_flex_control.answer import Answer, command, Number
from gms_flex_control.cli.robots import controller_of
from gms_flex_control.cli.terminal import end, import_ros, progress, refuse_unwritable, say
from gms_flex_control.compiled import in_one_thread
from gms_flex_control.data.conditions import conditions_of, KEYS, OF_ROBOT, repeat_conditions
from gms_flex_control.data.reader import read_experiment_of
from gms_flex_control.design import plan as planning
from gms_flex_control.design.determination import in_words, missing_of, plan_determination
from gms_flex_control.design.excitation import Bounds, plan_excitation, sentence
from gms_flex_control.design.separation import beliefs_of, closed_loop_plan, loaded
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import ConfigError
from gms_flex_control.experiment.simulated import simulate_to_bag
from gms_flex_control.file_io import write_json, written_together
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.arm import together
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams, WHOLE_ARM
from gms_flex_control.reports.figure_style import save_figure
from gms_flex_control.reports.pictures import next_figure, separated_figure
from gms_flex_control.schema.files import load_controller, load_limits, load_robot, save_values
import numpy as np

_DETERMINED = 20.0  # length of a motion that determines parameters, at most [s]


class Task(NamedTuple):
    """What is to be separated, and with which robot."""

    robot: RobotParams       # as believed
    gains: ControllerParams  # within the limits
    limits: Limits
    bags: list               # paths of the recordings so far
    sets: list               # of the explanations
    period: float            # of the controller [s]

    def recordings(self) -> list:
        """Return the recordings so far."""
        return [read_experiment_of(bag, self.robot)[0] for bag in self.bags]


def next_recording(args) -> int:
    """Write the plan, or carry it out; return 0, or 1 if not all explanations are separated."""
    refuse_unwritable(args, 'trajectory.yaml', 'identification.yaml')
    out, report = Path(args.out), _report(args.result)
    if 'joints' in report:
        return _determine(report, args, out)
    task = _task(report, args)
    with in_one_thread(), np.errstate(all='ignore'):
        if args.with_ros or args.simulate:
            return _carry_out(task, args, out)
        say('explanations along the recordings so far')
        plan = planning.plan_next(
            beliefs_of(task.recordings(), task.robot, task.sets), task.gains, task.limits,
            period=task.period, odds=args.odds, longest=args.longest, weight=args.weight, say=say)
    trajectory, load = write_files(plan, out), plan.best.candidate.load
    if load is not None:  # to be put into the folder of the new bag
        repeat_conditions(task.bags[-1], out, OF_ROBOT, load)
    numbers = tuple(Number(
        f'{one.duration:.0f} s of {one.candidate.words}',
        f'{100.0 * plan.share(one):.0f} %', f'{plan.pace(one):.2g}', '')
        for one in plan.compared[:3])
    return end(args, _as_dict(plan), '', Answer(plan.sentence(), (
        'leaves the true one', 'log Bayes factor a second', ''), numbers, _simulated(
            args, trajectory, plan.best.duration, out)),
        {'motion': trajectory, 'picture': out / 'plan.png', 'numbers': out / 'plan.json'},
        code=int(plan.probability < planning.LIKELY))


def _simulated(args, trajectory, duration, out, *further):
    """Return the command that simulates a planned motion."""
    return command('simulate', '--robot', *args.robot, *further, '--trajectory', trajectory,
                   '--duration', f'{duration:.0f}', '--out', out / 'bag')


def _loaded(args):
    """Return RobotParams, gains and Limits of the arguments."""
    robot = load_robot(args.robot)
    limits = load_limits(args.limits, robot.joints)
    missing = limits.missing(robot.joints) if limits else f'limits.{robot.joints[0]}.torque'
    if missing:
        raise ConfigError(f'--limits {" ".join(args.limits)}: {missing} is missing')
    return robot, load_controller(controller_of(args, robot.joints), robot), limits


def _determine(report, args, out):
    """Write the motion for what ``identify`` left open; return 0, or 1 if it determines none."""
    if args.with_ros or args.simulate or args.effects or args.weight:
        raise ConfigError(f'{args.result} is of identify: --run, --simulate, --effects and '
                          '--weight separate explanations of discrepancy')
    robot, gains, limits = _loaded(args)
    with in_one_thread(), np.errstate(all='ignore'):
        plan = plan_determination(
            robot, [read_experiment_of(bag, robot)[0] for bag in report['sources']],
            missing_of(report), gains, limits, period=1.0 / args.rate,
            duration=min(args.longest, _DETERMINED), say=say)
    columns, experiments = ('so far', 'then', ''), plan.experiments and plan.experiments.sentence()
    values = {'sentence': plan.sentence(), 'missing': plan.missing, 'duration': plan.duration,
              'experiments': experiments,
              'sd_before': plan.before.sd, 'compared': [
                  {'motion': one.candidate.name, 'log_determinant': one.information,
                   'sd': one.sd} for one in plan.compared]}
    files = {'numbers': out / 'plan.json'}
    with written_together():
        trajectory = files['motion'] = planning.write_plan(plan, out)
        if plan.experiments is not None and plan.experiments.measured:
            files['experiments'] = out / 'identification.yaml'
            save_values(plan.experiments.values, files['experiments'], comment=experiments)
        write_json(files['numbers'], values)
    numbers = tuple(Number(f'{in_words(name)} [%]', *(f'{100.0 * sd:.2g}' for sd in pair), '')
                    for name, *pair in zip(plan.missing, plan.before.sd, plan.best.sd,
                                           strict=True))
    sentence_of_all = ' '.join(filter(None, (plan.sentence(), experiments)))
    return end(args, values, '', Answer(sentence_of_all, columns, numbers[:3], _simulated(
        args, trajectory, plan.duration, out)), files, code=int(not plan.helps))


def _task(report, args):
    """Return the Task of the arguments."""
    robot, gains, limits = _loaded(args)
    if args.with_ros and args.simulate:
        raise ConfigError('--run and --simulate exclude each other: a robot is real or simulated')
    if args.weight and robot.arm.kind == 'decoupled':
        raise ConfigError('--weight: decoupled axes have no tip to hang it from')
    if args.weight and args.with_ros and not sys.stdin.isatty():
        raise ConfigError('--weight with --run needs a person at a terminal, to hang it')
    sets = sets_of(args.effects, robot) if args.effects else planning.surviving(report)
    if len(sets) < 2:
        raise ConfigError(f'{args.result} leaves one explanation, so there is nothing to '
                          'separate; --effects names others')
    return Task(robot, planning.clipped(gains, limits), limits, report['sources'], sets,
                1.0 / args.rate)


# --- rounds -------------------------------------------------------------------------------------


def _carry_out(task, args, out):
    """Plan and record in turn; return 0 if one explanation is left, else 1."""
    if (out / '1').exists():
        raise ConfigError(f'--out {out} has recordings of an earlier run; name another folder')
    bags, record = list(task.bags), _by_ros() if args.with_ros else _in_simulation(
        task, load_robot(args.simulate))

    def drive(plan, number):
        """Return the recording of a plan, the robot loaded as in the last recording."""
        write_files(plan, out / str(number))
        bag, motion = out / str(number) / 'bag', plan.best.candidate
        record(plan.best, bag, bags[-1], number)
        repeat_conditions(bags[-1], bag, KEYS if args.with_ros else OF_ROBOT, motion.load)
        bags.append(bag)
        return read_experiment_of(bag, task.robot)[0]

    found = planning.separate(
        task.recordings(), task.robot, task.sets, task.gains, task.limits, drive,
        period=task.period, odds=args.odds, budget=args.budget, longest=args.longest,
        weight=args.weight, say=say)
    report_separation(found, task, args.robot, out, args)
    return int(found.verdict != planning.ONE_LEFT)


def _in_simulation(task, robot):
    """Return what records a motion of a simulated robot (RobotParams)."""
    if robot.joints != task.robot.joints:
        raise ConfigError(f'--simulate: joints {", ".join(robot.joints)} are not those of --robot '
                          f'({", ".join(task.robot.joints)})')

    def record(best, bag, last, number):
        carried = together(conditions_of(last).operation.load, best.candidate.load)
        simulate_to_bag(closed_loop_plan(
            loaded(robot, carried), task.robot, best.candidate, best.duration, task.gains,
            period=task.period, seed=number), bag)
    return record


def _by_ros():
    """Return what records a motion of the running nodes."""
    runner = import_ros('gms_flex_control.nodes.step_runner')

    def record(best, bag, _last, _number):
        motion = best.candidate
        if motion.load is not None:
            input(f'Hang {motion.load.mass:g} kg at the tip, then press Enter: ')
        runner.drive_motion(motion.parameters, best.duration, bag, say=say)
    return record


@written_together()
def write_files(plan, out) -> Path:
    """Write trajectory, numbers and picture of a plan; return the path of the trajectory."""
    trajectory = planning.write_plan(plan, out)
    write_json(out / 'plan.json', _as_dict(plan))
    save_figure(next_figure(plan), out / 'plan.png')
    return trajectory


def report_separation(found, task, robot_files, out, args) -> None:
    """Write and print what a Separation ended with."""
    values = separation_values(found)
    files = {'numbers': out / 'separation.json'}
    with written_together():
        write_json(files['numbers'], values)
        if found.rounds:
            files['picture'] = out / 'separation.png'
            save_figure(separated_figure(found), files['picture'])
    before = (found.rounds[0].plan if found.rounds else found).beliefs
    shares = {one.effects: share for one, share in zip(before.hypotheses, before.probabilities,
                                                       strict=True)}
    numbers = tuple(Number(f'probability of {one.words}', f'{shares.get(one.effects, 0.0):.3g}',
                           f'{share:.3g}', '') for one, share in zip(
        found.beliefs.hypotheses, found.beliefs.probabilities, strict=True))
    new = [out / str(k + 1) / 'bag' for k in range(len(found.rounds))]
    end(args, values, '', Answer(found.sentence(), ('before', 'after', ''), numbers[:3], command(
        'discrepancy', *task.bags, *new, '--robot', *robot_files, '--out', out / 'gap')), files)


def separation_values(found) -> dict:
    """Return a Separation as plain values."""
    return {'sentence': found.sentence(), 'verdict': found.verdict, 'robot_time': found.spent,
            'probabilities': {one.words: share for one, share in zip(
                found.beliefs.hypotheses, found.beliefs.probabilities, strict=True)},
            'log_odds': found.beliefs.odds.round(3), 'wanted': found.wanted,
            'left': [one.words for one in found.left],
            'rounds': [_as_dict(one.plan) for one in found.rounds]}


# --- files --------------------------------------------------------------------------------------


def _report(folder):
    path = Path(folder) / 'report.json'
    try:
        report = json.loads(path.read_text(encoding='utf-8'))
        keys = ('sources', 'credible', 'findings', 'minor') if 'credible' in report else (
            'sources', 'joints')
        sources = [report[name] for name in keys][0]
    except OSError as error:
        raise ConfigError(f'{path}: cannot be read ({error.strerror}); name a folder that '
                          'gms_flex discrepancy or identify wrote') from error
    except (ValueError, KeyError, AttributeError) as error:
        raise ConfigError(f'{path}: no result of gms_flex discrepancy or identify ({error})'
                          ) from error
    missing = [bag for bag in sources if not Path(bag).exists()]
    if missing:
        raise ConfigError(f'{path}: the bag {missing[0]} is not there; run next in the folder '
                          'discrepancy was run in')
    return report


def sets_of(texts, robot) -> list:
    """Return explanations given as EFFECT:JOINT+EFFECT:JOINT; ConfigError if one is repeated."""
    if len(texts) > planning.MOST:
        raise ConfigError(f'--effects: {len(texts)} explanations, at most {planning.MOST} are '
                          'separated at once; name the likeliest')
    sets = []
    for text in texts:
        one = set()
        for part in text.split('+'):
            effect, _, joint = part.partition(':')
            find(effect)
            if joint not in (*robot.joints, WHOLE_ARM):
                raise ConfigError(f'--effects {text}: joint {joint!r} must be one of '
                                  f'{", ".join((*robot.joints, WHOLE_ARM))}')
            one.add((effect, joint))
        if one in sets:
            raise ConfigError(f'--effects {text}: is named twice, and nothing separates it from '
                              'itself')
        sets.append(frozenset(one))
    return sets


def _as_dict(plan):
    def of(one):
        return {'motion': one.candidate.name, 'duration': one.duration,
                'minutes_by_hand': one.candidate.minutes,
                'log_odds': one.odds.round(3), 'log_bayes_factor_per_second': plan.pace(one)}
    return {'sentence': plan.sentence(), 'wanted': plan.wanted,
            'explanations': [one.words for one in plan.beliefs.hypotheses],
            'best': of(plan.best), 'compared': [of(one) for one in plan.compared],
            'refused': plan.refused, 'probability': plan.probability}


def plan(args) -> int:
    """Write the motion and what it is worth; return 0."""
    refuse_unwritable(args, 'trajectory.yaml')
    robot = load_robot(args.robot)
    if robot.arm.frames is None:
        raise ConfigError(f'--robot {" ".join(args.robot)}: arm.kind is {robot.arm.kind}; plan '
                          'needs urdf; for decoupled axes or a planar arm use identification_node')
    limits = load_limits(args.limits, robot.joints) if args.limits else None
    bounds = Bounds.of_robot(robot, limits, args.acceleration or np.inf)
    with in_one_thread():
        found = plan_excitation(
            robot, bounds, period=args.period, harmonics=args.harmonics, repeats=args.repeats,
            radius=args.radius, seed=args.seed, say=progress(args, '  {} ...'))
    out = Path(args.out)
    words, trajectory = sentence(found, robot.joints), out / 'trajectory.yaml'
    values = {'condition_number': found.condition, 'sinusoids': found.usual,
              'base_parameters': found.parameters, 'shares_of_limits': found.used,
              'clearance': found.clearance,
              'duration': found.trajectory.end}
    with written_together():
        save_values(found.values, trajectory, comment=words)
        write_json(out / 'plan.json', values)
    shares = [Number(f'largest {name} [% of its limit]', '-', f'{100.0 * share:.0f}', '100')
              for name, share in found.used.items()]
    gains = Path(args.robot[0]).with_name('controller.yaml')
    return end(args, values, '', Answer(words, ('sinusoids', 'plan', 'limit'), (
        Number('condition number', f'{found.usual:.3g}', f'{found.condition:.3g}', '-'),
        *shares), _simulated(args, trajectory, found.trajectory.end, out, '--controller', gains)),
        {'motion': trajectory, 'numbers': out / 'plan.json'})
