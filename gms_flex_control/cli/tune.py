# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex tune`: gains for a robot, judged, tried and written as controller.yaml."""

from functools import partial
from pathlib import Path

from gms_flex_control.cli.output import add_batch_options, conclude, refuse_unwritable

_MOST_AT_LIMIT = 0.02  # share of a motion that may be spent at the torque limit
# what a simulated figure depends on
SOURCES = ('params', 'friction', 'effects', 'dynamics', 'trajectory', 'control', 'simulation',
           'tuning')


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'tune', help='gains for a robot: proposed, judged, tried, verified',
        description='Propose the stiffest gains of the cascade controller that keep margins, '
                    'encoder noise and the conditions (39), show margins and expected tracking '
                    'error, and write controller.yaml. Exit code 1 if no gains meet the '
                    'requirements, or a robot drawn by --verify is lost.')
    parser.add_argument('--robot', nargs='+', metavar='FILE',
                        help='robot files, later ones winning; default: the arm of the paper')
    parser.add_argument('--controller', nargs='+', metavar='FILE',
                        help='compensation, observer and torque limits; default: gms, k_e 1')
    parser.add_argument('--torque-limit', nargs='+', type=float, metavar='NM',
                        help='of each joint, or one for all; default: of --controller')
    parser.add_argument('--rate', type=float, default=500.0, metavar='HZ',
                        help='of the controller (default: %(default)g)')
    parser.add_argument('--delay', type=float, default=0.0, metavar='MS',
                        help='from measurement to torque (default: %(default)g)')
    parser.add_argument('--bandwidth', nargs='+', type=float, metavar='RAD/S',
                        help='of each link, or one for all; default: as much as margins allow')
    parser.add_argument('--damping', type=float, default=1.0, metavar='D',
                        help='of the pair of link poles, at least 1 (default: %(default)g)')
    _add_demands(parser)
    parser.add_argument('--amplitude', type=float, default=1.0, metavar='RAD',
                        help='of the motions simulated (default: %(default)g)')
    parser.add_argument('--verify', type=int, default=0, metavar='N',
                        help='try the gains on N robots drawn from the uncertainty')
    parser.add_argument('--intervals', metavar='FILE',
                        help='report.json of gms_flex identify: draw from its intervals; what '
                             'has none: friction and M 30 %%, K 20 %%')
    parser.add_argument('--seed', type=int, default=0, metavar='N', help='of the draws')
    add_batch_options(parser)
    parser.add_argument('--out', required=True, metavar='DIR',
                        help='controller.yaml, tuning.json, tuning.png, journal of --verify')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')
    parser.set_defaults(run=run)


def _add_demands(parser):
    parser.add_argument('--gain-margin', type=float, default=2.0, metavar='TIMES',
                        help='factor on the torque, up and down (default: %(default)g)')
    parser.add_argument('--phase-margin', type=float, default=30.0, metavar='DEG',
                        help='default: %(default)g')
    parser.add_argument('--delay-margin', type=float, metavar='MS',
                        help='further delay that the loop must tolerate (default: one sample)')
    parser.add_argument('--noise', type=float, default=0.1, metavar='SHARE',
                        help='of the torque limit that encoder noise may take as rms torque '
                             '(default: %(default)g)')


def run(args):
    """Propose, try, write, verify; return 1 where something asked is not met, else 0."""
    import json

    from gms_flex_control.files import write_text
    from gms_flex_control.params.units import in_units
    from gms_flex_control.tuning import words

    robot, base, demands = asked(args)
    intervals = intervals_asked(args)
    refuse_unwritable(args.out)
    proposal, trials = proposed(robot, base, demands, args.amplitude)
    values = words.as_values(proposal, robot, demands.timing, trials)
    units = partial(in_units, robot.arm)
    if not args.json:
        print(units(text_of(proposal, trials, robot, demands)))
    if not proposal.unmet:
        if args.verify:
            values['verify'] = verified(robot, proposal.gains, demands, intervals, args)
            if not args.json:
                print(units(f"\n{words.verify_text(values['verify'], robot)}"))
        write(args, robot, proposal, demands)
    write_text(Path(args.out) / 'tuning.json', json.dumps(values, indent=2) + '\n')
    if args.json:
        print(json.dumps(values, indent=2))
    else:
        written = {} if proposal.unmet else {'gains': Path(args.out) / 'controller.yaml'}
        conclude(words.answer_of(proposal, trials, robot, demands, args.robot or (), args.out),
                 written | {'numbers': Path(args.out) / 'tuning.json'}, units)
    found = values.get('verify', {'lost': [], 'unstable': []})
    return int(bool(proposal.unmet or found['lost'] or found['unstable']))


def asked(args):
    """Return robot, the controller to begin with, and the Demands of the command line."""
    import math

    from gms_flex_control.errors import ConfigError
    from gms_flex_control.params.gains import ControllerParams
    from gms_flex_control.resources import controller_file, robot_file
    from gms_flex_control.schema.files import load_controller, load_robot
    from gms_flex_control.tuning.linear_loop import Timing
    from gms_flex_control.tuning.propose import Demands
    import numpy as np

    for name, value, least in (('rate', args.rate, 1.0), ('delay', args.delay, 0.0),
                               ('damping', args.damping, 1.0), ('noise', args.noise, 1e-6),
                               ('gain-margin', args.gain_margin, 1.0),
                               ('phase-margin', args.phase_margin, 0.0),
                               ('verify', args.verify, 0), ('amplitude', args.amplitude, 1e-6)):
        if not least <= value < math.inf:
            raise ConfigError(f'--{name} {value:g}: must be at least {least:g} and finite')
    if args.delay > 50.0:
        raise ConfigError(f'--delay {args.delay:g}: in milliseconds, at most 50')
    robot = load_robot(args.robot or robot_file())
    n = robot.n_joints
    limit = per_joint('torque-limit', args.torque_limit, n)
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
        damping=args.damping, bandwidth=per_joint('bandwidth', args.bandwidth, n),
        gain=args.gain_margin, phase=math.radians(args.phase_margin), delay=further,
        noise=args.noise)


def intervals_asked(args):
    """Return the intervals to draw from (dict); raise ConfigError if nothing would be drawn."""
    from gms_flex_control.errors import ConfigError
    from gms_flex_control.tuning.uncertainty import read_intervals

    if not args.intervals:
        return {}
    if not args.verify:
        raise ConfigError(f'--intervals {args.intervals}: concerns the robots that --verify '
                          'draws; give --verify N as well, or leave it out')
    return read_intervals(args.intervals)


def per_joint(name, values, n):
    """Return an option's values as (n,), one given value for all joints; None if not given."""
    from gms_flex_control.errors import ConfigError
    import numpy as np

    if values is None:
        return None
    if len(values) not in (1, n) or not all(0.0 < value < np.inf for value in values):
        raise ConfigError(f'--{name} {values}: give one number above 0, or one for each of the '
                          f'{n} joints')
    return np.broadcast_to(np.array(values, dtype=float), (n,)).copy()


def proposed(robot, base, demands, amplitude):
    """Return the Proposal, completed by what simulation shows, and Trials by mode and motion."""
    from dataclasses import replace

    from gms_flex_control.tuning.propose import propose
    from gms_flex_control.tuning.trial import MOTIONS, try_gains
    import numpy as np

    proposal = propose(robot, base, demands)
    reach, trials, unmet = np.full(robot.n_joints, amplitude), {}, []
    for mode in dict.fromkeys(('none', base.compensation)):
        gains = replace(proposal.gains, compensation=mode)
        trials[mode] = {}
        for motion in MOTIONS:
            trial, run = try_gains(robot, robot, gains, demands.timing, motion, reach)
            trials[mode][motion] = trial
            if trial.lost:
                unmet.append(f'{motion}, compensation {mode}: the simulated robot was lost')
            else:
                unmet += at_limit(run, robot, demands.torque_limit,
                                  f'{motion}, compensation {mode}')
    return proposal._replace(unmet=tuple(dict.fromkeys([*proposal.unmet, *unmet]))), trials


def at_limit(run, robot, limit, motion):
    """Return a sentence for each joint whose torque limit is met too often in a Run."""
    import numpy as np

    share = np.mean(np.abs(run.command) >= limit, axis=0)
    return [f'{joint}: at the torque limit for {100 * share[j]:.0f} % of the {motion}; give a '
            'smaller --amplitude or a larger --torque-limit'
            for j, joint in enumerate(robot.joints) if share[j] > _MOST_AT_LIMIT]


def text_of(proposal, trials, robot, demands):
    """Return gains, margins, conditions and expected errors as lines of text."""
    from gms_flex_control.cli import check_gains
    from gms_flex_control.tuning import words

    return '\n'.join([
        words.gains_table(proposal.gains, robot),
        '\nMargins of the sampled loop, worst of all poses',
        words.margins_table(proposal.judgement, robot),
        *words.loop_lines(proposal.judgement, robot, demands.timing),
        f'\n{check_gains.text(proposal.judgement.conditions)}',
        f'\nSimulated, exact model\n{words.trials_table(trials, robot)}',
        *words.expected_lines(trials, proposal.judgement, robot),
        *(f'NOT MET: {sentence}' for sentence in proposal.unmet)])


def verified(robot, gains, demands, intervals, args):
    """Return the summary of the draws asked for; finished ones are kept in --out."""
    from gms_flex_control.batches.batch import run_batch
    from gms_flex_control.batches.executor import open_executor
    from gms_flex_control.batches.journal import digest_of, fingerprint, Journal
    from gms_flex_control.schema.build import robot_values
    from gms_flex_control.tuning import uncertainty, words
    import numpy as np

    amplitude = np.full(robot.n_joints, args.amplitude)
    items = {f'draw {k}': uncertainty.Drawn(robot, gains, demands.timing, amplitude, intervals,
                                            args.seed, k) for k in range(args.verify)}
    digest = digest_of((robot_values(robot), words.controller_values(gains, robot.joints),
                        demands.timing, args.amplitude, intervals, args.seed))
    journal = Journal(args.out, f'{fingerprint(SOURCES)} {digest}')
    with open_executor(args.workers, args.scheduler) as executor:
        found = run_batch(uncertainty.try_drawn, items, executor=executor, journal=journal,
                          label='robots')
    return uncertainty.summary(list(found.values()))


def write(args, robot, proposal, demands):
    """Write controller.yaml and tuning.png."""
    from gms_flex_control import __version__
    from gms_flex_control.reports.figures import save_figure
    from gms_flex_control.reports.tuning_figure import tuning_figure
    from gms_flex_control.schema.files import save_values
    from gms_flex_control.tuning import words

    out = Path(args.out)
    comment = '\n'.join([
        f'Gains proposed by gms_flex tune {__version__} for {args.rate:g} Hz and '
        f'{args.delay:g} ms of delay.',
        *words.loop_lines(proposal.judgement, robot, demands.timing)[:1],
        words.margins_table(proposal.judgement, robot)])
    save_values(words.controller_values(proposal.gains, robot.joints), out / 'controller.yaml',
                comment=comment)
    save_figure(tuning_figure(robot, proposal.gains, demands.timing), out / 'tuning.png')
