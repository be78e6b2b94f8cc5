# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench paper-method`: the identification of the paper beside the default."""

from functools import partial

from bench.paper_method.method import fit_paper
from gms_flex_control.answer import align
from gms_flex_control.cli.options import add_verb, BAG, ROBOT, Verb
from gms_flex_control.data.reader import read_experiment
from gms_flex_control.file_io import robot_file
from gms_flex_control.identification.assumed_robot import believed_model
from gms_flex_control.identification.identify import identify
from gms_flex_control.identification.problem import Problem
from gms_flex_control.schema.files import load_robot
from gms_flex_control.simulation.predictor import ATTRACTION

NAMES = (*(f'{way}.{name}' for way in ('forward', 'backward')
           for name in ('static', 'coulomb', 'velocity', 'viscous')), 'attraction')
VERB = Verb(
    'paper-method', lambda args: paper_method(args),
    'identification as section 4 of the paper, beside the default',
    'Identify the friction of a bag step by step as section 4 of the paper does, six blocks of '
    'equal weight, and with gms_flex identify; print the parameters that both have.',
    (BAG, ROBOT), ())
add_parser = partial(add_verb, VERB)


def paper_method(args):
    """Print a table of the parameters found by both methods; return 0."""
    robot = load_robot(args.robot or [robot_file()])
    take = read_experiment(args.bag, robot.joints, robot.motors)
    bundle = Problem([take], [], believed_model(robot, whole=False, force=False)).bundle
    default = {one.name: one for result in identify([take], robot).joints
               for one in result.estimates}
    rows = []
    for j, joint in enumerate(robot.joints):
        paper = fit_paper(bundle.segments, bundle.arm, j, bundle.period, bundle.half[j])
        for name, value, interval in zip(NAMES, paper.theta, paper.intervals[:ATTRACTION + 1],
                                         strict=False):
            one = default[f'friction.{joint}.{name}']
            rows.append([f'{joint}.{name}', *cells(value, interval),
                         *cells(one.value, one.interval)])
    print(align(['', 'paper', '95 %', 'default', '95 %'], rows))
    return 0


def cells(value, interval):
    """Return a value and its interval as texts."""
    return f'{value:.4g}', f'{interval.low:.4g} to {interval.high:.4g}' if interval else '-'
