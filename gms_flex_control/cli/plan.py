# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex plan`: the motion that tells inertial parameters and friction of an arm best."""

import json
from pathlib import Path

from gms_flex_control import blas
from gms_flex_control.answer import Answer, command, Number
from gms_flex_control.cli.terminal import conclude, refuse_unwritable, say
from gms_flex_control.design.excitation import Bounds, plan_excitation, sentence
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import write_text
from gms_flex_control.schema.files import load_limits, load_robot, save_values
import numpy as np


def plan(args) -> int:
    """Write the motion and what it is worth; return 0."""
    refuse_unwritable(args.out)
    robot = load_robot(args.robot)
    if robot.arm.frames is None:
        raise ConfigError(f'--robot {" ".join(args.robot)}: arm.kind is {robot.arm.kind}; plan '
                          'needs urdf. identification_node moves axes that are alone')
    limits = load_limits(args.limits, robot.joints) if args.limits else None
    bounds = Bounds.of_robot(robot, limits, args.acceleration or np.inf)
    with blas.in_one_thread():
        found = plan_excitation(
            robot, bounds, period=args.period, harmonics=args.harmonics, repeats=args.repeats,
            radius=args.radius, seed=args.seed,
            say=(lambda _: None) if args.json else lambda text: say(f'  {text} ...'))
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    words, trajectory = sentence(found, robot.joints), out / 'trajectory.yaml'
    save_values(found.values, trajectory, comment=words)
    values = {'condition_number': found.condition, 'sinusoids': found.usual,
              'base_parameters': found.parameters, 'shares_of_limits': found.used,
              'clearance': found.clearance if np.isfinite(found.clearance) else None,
              'duration': found.trajectory.end}
    write_text(out / 'plan.json', json.dumps(values, indent=1) + '\n')
    if args.json:
        print(json.dumps(values, indent=1))
        return 0
    shares = [Number(f'largest {name} [% of its limit]', '-', f'{100.0 * share:.0f}', '100')
              for name, share in found.used.items()]
    conclude(Answer(words, ('sinusoids', 'plan', 'limit'), (
        Number('condition number', f'{found.usual:.3g}', f'{found.condition:.3g}', '-'),
        *shares), command(
            'simulate', '--robot', *args.robot, '--controller',
            Path(args.robot[0]).with_name('controller.yaml'), '--trajectory', trajectory,
            '--duration', f'{found.trajectory.end:.0f}', '--out', out / 'bag')),
        {'motion': trajectory, 'numbers': out / 'plan.json'})
    return 0
