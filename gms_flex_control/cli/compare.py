# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The verb `compare`: friction compensations side by side on a plant."""

from functools import partial
from pathlib import Path

from gms_flex_control.batches import run_batch
from gms_flex_control.cli.robots import controller_of
from gms_flex_control.cli.terminal import conclude, refuse_unwritable
from gms_flex_control.comparison import study
from gms_flex_control.file_io import as_json, robot_file, write_json
from gms_flex_control.params.arm import in_units
from gms_flex_control.reports import comparison_page
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np


def compare_verb(args) -> int:
    """Compare, write and print; return 0."""
    refuse_unwritable(args.out)
    robot = load_robot(args.robot or robot_file())
    gains = load_controller(controller_of(args, robot.joints), robot)
    setting = study.Setting(robot, gains, np.full(robot.n_joints, args.amplitude), args.rate,
                            args.draws, args.seed)
    outcomes = run_batch(study.try_cell, study.cells(setting), args.workers, 'cells')
    rows = study.table(outcomes, setting)
    values = {'rate': args.rate, 'amplitude': args.amplitude, 'draws': args.draws,
              'seed': args.seed, 'rows': [row._asdict() for row in rows], 'cells': outcomes}
    page, numbers = Path(args.out) / 'report.html', Path(args.out) / 'comparison.json'
    write_json(numbers, values)
    comparison_page.plant_page(rows, outcomes, setting, args.robot).write(page)
    if args.json:
        print(as_json(values))
        return 0
    words = partial(in_units, robot.arm)
    print(words(comparison_page.plant_text(rows)))
    conclude(comparison_page.plant_answer(rows, outcomes, args.robot),
             {'report': page, 'numbers': numbers}, words)
    return 0
