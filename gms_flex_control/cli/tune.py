# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The verbs on gains: `tune` proposes them, `check-gains` judges them, `compare` their modes."""

from dataclasses import asdict
from functools import partial
import math
from pathlib import Path

from gms_flex_control import __version__, results
from gms_flex_control.batches import run_batch
from gms_flex_control.cli.robots import controller_of
from gms_flex_control.cli.terminal import end, refuse_unwritable
from gms_flex_control.control.gain_conditions import check
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import controller_file, robot_file, write_json, written_together
from gms_flex_control.params.arm import in_units
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.reports import comparison_page, tuning_page
from gms_flex_control.reports.figure_style import save_figure
from gms_flex_control.schema.build import controller_values
from gms_flex_control.schema.files import load_controller, load_robot, save_values
from gms_flex_control.tuning import study
from gms_flex_control.tuning.linear_loop import Timing
from gms_flex_control.tuning.propose import Demands
import numpy as np


def tune(args) -> int:
    """Propose, try, write, verify; return 1 where something asked is not met, else 0."""
    refuse_unwritable(args, 'controller.yaml', 'trajectory.yaml')
    robot, base, demands = _asked(args)
    tuned = results.tune(robot, base, demands=demands, amplitude=args.amplitude)
    proposal, trials, values = tuned.proposal, tuned.trials, tuned.to_dict()
    units = partial(in_units, robot.arm)
    if not args.json:
        print(tuned.summary())
    if not proposal.unmet:
        if args.verify:
            values['verify'] = _verified(robot, proposal.gains, demands, args)
            if not args.json:
                print(units(f"\n{tuning_page.verify_text(values['verify'], robot)}"))
    with written_together():
        if not proposal.unmet:
            _write(args, robot, proposal, demands)
        write_json(Path(args.out) / 'tuning.json', values)
    written = {} if proposal.unmet else {'gains': Path(args.out) / 'controller.yaml'}
    found = values.get('verify', {'lost': [], 'unstable': []})
    return end(args, values, '', tuning_page.answer_of(
        proposal, trials, robot, demands, args.robot or (), args.out),
        written | {'numbers': Path(args.out) / 'tuning.json'}, units,
        int(bool(proposal.unmet or found['lost'] or found['unstable'])))


def _asked(args):
    """Return robot, the controller to begin with, and the Demands of the command line."""
    robot = load_robot(args.robot or robot_file())
    n = robot.n_joints
    limit = _per_joint('torque-limit', args.torque_limit, n)
    if args.controller or not args.robot:
        base = load_controller(args.controller or controller_file(), robot)
    elif limit is None:
        raise ConfigError('--torque-limit is required: the torque that the motors of this robot '
                          'can give; or a --controller file that states it')
    else:
        one = np.ones(n)
        base = ControllerParams(
            compensation='gms', kd_link=one, lambda_link=one, kd_motor=one, lambda_motor=one,
            observer_gain=one, sign_slope=50.0 * one, filter_bandwidth=100.0 * one,
            torque_limit=limit)
    timing = Timing(1.0 / args.rate, 1e-3 * args.delay)
    further = timing.period if args.delay_margin is None else 1e-3 * args.delay_margin
    return robot, base, Demands(
        timing=timing, torque_limit=base.torque_limit if limit is None else limit,
        damping=args.damping, bandwidth=_per_joint('bandwidth', args.bandwidth, n),
        gain=args.gain_margin, phase=math.radians(args.phase_margin), delay=further,
        noise=args.noise)


def _per_joint(name, values, n):
    """Return an option's values as (n,), one given value for all joints; None if not given."""
    if values is None:
        return None
    if len(values) not in (1, n) or not all(0.0 < value < np.inf for value in values):
        raise ConfigError(f'--{name} {values}: give one number above 0, or one for each of the '
                          f'{n} joints')
    return np.broadcast_to(np.array(values, dtype=float), (n,)).copy()


def _verified(robot, gains, demands, args):
    """Return the summary of the draws asked for."""
    amplitude = np.full(robot.n_joints, args.amplitude)
    items = {f'draw {k}': study.Drawn(robot, gains, demands.timing, amplitude,
                                      args.seed, k) for k in range(args.verify)}
    found = run_batch(study.try_drawn, items, args.workers, 'robots')
    return study.summary(list(found.values()))


def _write(args, robot, proposal, demands):
    out = Path(args.out)
    comment = '\n'.join([
        f'Gains proposed by gms_flex tune {__version__} for {args.rate:g} Hz and '
        f'{args.delay:g} ms of delay.',
        *tuning_page.loop_lines(proposal.judgement, demands.timing)[:1],
        tuning_page.margins_table(proposal.judgement, robot)])
    save_values(controller_values(proposal.gains, robot.joints), out / 'controller.yaml',
                comment=in_units(robot.arm, comment))
    if args.robot:
        _sinusoid(args, robot)
    save_figure(tuning_page.tuning_figure(robot, proposal.gains, demands.timing),
                out / 'tuning.png')


def check_gains(args) -> int:
    """Print the conditions on the gains; return 0, or 1 where one does not hold."""
    robot = load_robot(args.robot or robot_file())
    report = check(load_controller(args.controller or controller_file(), robot), robot)
    return end(args, _gains_values(report), tuning_page.conditions_text(report),
               code=int(not report.met))


def _gains_values(report):
    """Return a GainReport as plain values; an infinite bound becomes None."""
    conditions = [{**asdict(c), 'met': c.met} for c in report.conditions]
    return {'met': report.met, 'conditions': conditions,
            'alpha': dict(zip(report.joints, report.alpha.tolist(), strict=True)),
            'mass_eigenvalues': report.mass_range, 'n1_eigenvalues': report.energy_range,
            'disturbance_bound': report.disturbance,
            'residual_bound': report.residual if math.isfinite(report.residual) else None}


def compare(args) -> int:
    """Compare, write and print; return 0."""
    refuse_unwritable(args, 'trajectory.yaml')
    robot = load_robot(args.robot or robot_file())
    gains = load_controller(controller_of(args, robot.joints), robot)
    found = results.compare(robot, gains, draws=args.draws, rate=args.rate, seed=args.seed,
                            amplitude=args.amplitude, workers=args.workers)
    values = found.to_dict() | {'cells': found.outcomes}
    page, numbers = Path(args.out) / 'report.html', Path(args.out) / 'comparison.json'
    again = ('--controller', *args.controller) if args.controller else ()
    with written_together():
        write_json(numbers, values)
        if args.robot:
            again = '--robot', *args.robot, *again, '--trajectory', _sinusoid(args, robot)
        answer = comparison_page.plant_answer(found.rows, found.outcomes, again)
        comparison_page.plant_page(found.rows, found.outcomes, found.setting, args.robot,
                                   answer).write(page)
    return end(args, values, found.summary(), answer, {'report': page, 'numbers': numbers},
               partial(in_units, robot.arm))


def _sinusoid(args, robot):
    """Write the sinusoid that was simulated as a trajectory file, and return its path."""
    path = Path(args.out) / 'trajectory.yaml'
    sizes = {f'trajectory.{joint}.amplitude': args.amplitude for joint in robot.joints}
    save_values({'trajectory.type': 'sinusoid'} | sizes, path,
                comment='The sinusoid that the gains were tried with.')
    return path
