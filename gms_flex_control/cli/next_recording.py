# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex next`: the motion to be recorded next, that separates what is left."""

import json
from pathlib import Path

from gms_flex_control import blas
from gms_flex_control.answer import Answer, command, Number
from gms_flex_control.cli.terminal import conclude, say
from gms_flex_control.data.reader import read_recording
from gms_flex_control.design.plan import plan_next, surviving, write_plan
from gms_flex_control.design.separation import beliefs_of
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import write_text
from gms_flex_control.params.robot import WHOLE_ARM
from gms_flex_control.reports.figures import save_figure
from gms_flex_control.reports.pictures import next_figure
from gms_flex_control.resources import controller_file
from gms_flex_control.schema.files import load_controller, load_limits, load_robot
import numpy as np


def next_recording(args) -> int:
    """Write the plan; return 0, or 1 if no motion separates the explanations."""
    robot = load_robot(args.robot)
    gains = load_controller(args.controller or controller_file(), robot)
    limits = load_limits(args.limits, robot.joints)
    if limits is None or limits.missing():
        raise ConfigError(f'--limits {" ".join(args.limits)}: limits.{robot.joints[0]}.'
                          f'{limits.missing()[0] if limits else "torque"} is missing')
    report = _report(args.result)
    sets = _sets(args.effects, robot) if args.effects else surviving(report)
    if len(sets) < 2:
        raise ConfigError(f'{args.result} leaves one explanation, so there is nothing to '
                          'separate; --effects names others')
    with blas.in_one_thread(), np.errstate(all='ignore'):
        say('explanations along the recordings so far')
        beliefs = beliefs_of([read_recording(bag, robot.joints, robot.motors)
                              for bag in report['sources']], robot, sets)
        plan = plan_next(beliefs, gains, limits, period=1.0 / args.rate, odds=args.odds,
                         longest=args.longest, say=say)
    out = Path(args.out)
    trajectory = write_plan(plan, out)
    write_text(out / 'plan.json', json.dumps(_as_dict(plan), indent=1) + '\n')
    save_figure(next_figure(plan), out / 'plan.png')
    if args.json:
        print(json.dumps(_as_dict(plan), indent=1))
    else:
        numbers = tuple(Number(f'nats in {one.duration:.0f} s: {one.candidate.words}',
                               f'{one.least:.1f}', f'{plan.wanted:.1f}', '')
                        for one in plan.compared[:3])
        conclude(Answer(plan.sentence(), ('worst pair', 'wanted', ''), numbers, command(
            'simulate', '--robot', *args.robot, '--trajectory', trajectory, '--duration',
            f'{plan.best.duration:.0f}', '--out', out / 'bag')),
            {'motion': trajectory, 'picture': out / 'plan.png', 'numbers': out / 'plan.json'})
    return 1 if plan.undecided else 0


def _report(folder):
    path = Path(folder) / 'report.json'
    try:
        report = json.loads(path.read_text(encoding='utf-8'))
        sources = [report[name] for name in ('sources', 'credible', 'findings', 'minor')][0]
    except (OSError, ValueError, KeyError) as error:
        raise ConfigError(f'{path}: no result of gms_flex discrepancy ({error})') from error
    missing = [bag for bag in sources if not Path(bag).exists()]
    if missing:
        raise ConfigError(f'{path}: the bag {missing[0]} is not there; run next in the folder '
                          'discrepancy was run in')
    return report


def _sets(texts, robot):
    """Return explanations given as EFFECT:JOINT+EFFECT:JOINT."""
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
        sets.append(frozenset(one))
    return sets


def _as_dict(plan):
    def of(one):
        return {'motion': one.candidate.name, 'duration': one.duration,
                'nats': one.nats.round(3).tolist()}
    return {'sentence': plan.sentence(), 'wanted': plan.wanted,
            'explanations': [one.words for one in plan.beliefs.hypotheses],
            'best': of(plan.best), 'compared': [of(one) for one in plan.compared],
            'refused': list(plan.refused), 'undecided': plan.undecided}
