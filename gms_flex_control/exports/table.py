# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Every parameter of a robot as a table: name, joint, value, unit, meaning."""

import csv
import io

from gms_flex_control.params.robot import RobotParams, WHOLE_ARM
from gms_flex_control.params.units import in_units
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.values import known_keys

COLUMNS = ('parameter', 'joint', 'value', 'unit', 'meaning')


def table(robot: RobotParams) -> str:
    """
    Return a robot as CSV with the columns `COLUMNS`.

    Parameters
    ----------
    robot : RobotParams
        As its files state it, effects included.

    Returns
    -------
    str
        One row per number; entry k of an array is ``name[k]``.

    """
    values = robot_values(robot)
    keys = known_keys(values, robot.joints)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(COLUMNS)
    for name, value in values.items():
        if name in ('joints', 'motors'):
            continue
        parts, key = name.split('.'), keys[name]
        joint = next((part for part in parts[1:-1] if part in (*robot.joints, WHOLE_ARM)), '')
        entries = enumerate(value) if isinstance(value, list) else ((None, value),)
        for k, entry in entries:
            writer.writerow([name if k is None else f'{name}[{k}]', joint, entry,
                             in_units(robot.arm, key.unit), key.description])
    return text.getvalue()
