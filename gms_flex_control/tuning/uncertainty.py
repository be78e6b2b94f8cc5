# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
A controller on robots that are not quite what it believes: drawn, simulated, judged.

Every parameter that was identified with an interval is drawn evenly from it; the others are
scaled evenly within a spread. What is drawn together is named in `GROUPS`.
"""

import json
from pathlib import Path
import re
from typing import NamedTuple

from gms_flex_control.errors import ConfigError
from gms_flex_control.schema.build import robot_from_values, robot_values
from gms_flex_control.tuning.judge import judged
from gms_flex_control.tuning.trial import MOTIONS, try_gains
import numpy as np

# what is scaled by one factor per joint, and by how much at most
SPREADS = {'friction level': 0.3, 'viscous friction': 0.3, 'presliding stiffness': 0.3,
           'joint stiffness': 0.2, 'link mass': 0.3, 'motor inertia': 0.3}
GROUPS = {'static': 'friction level', 'coulomb': 'friction level',
          'viscous': 'viscous friction', 'stiffness': 'presliding stiffness',
          'mass': 'link mass', 'inertia': 'link mass', 'mass_factor': 'link mass',
          'inertia_factor': 'link mass', 'motor_inertia': 'motor inertia'}
_BLOCK = re.compile(r'(.+)\[(\d+)\]')


class Drawn(NamedTuple):
    """One robot to be tried: an item of a batch."""

    robot: object       # RobotParams as believed
    gains: object       # ControllerParams
    timing: object      # Timing
    amplitude: object   # (n,) of the motions [rad]
    intervals: dict     # flat parameter name -> (low, high)
    seed: int
    number: int


def read_intervals(path):
    """
    Return the intervals of an identification.

    Parameters
    ----------
    path : str or Path
        The report.json of gms_flex identify.

    Returns
    -------
    dict of str to (float, float)
        By name of the parameter; those the data could not tell are left out.

    Raises
    ------
    ConfigError
        If it cannot be read or is none.

    """
    try:
        report = json.loads(Path(path).read_text('utf-8'))
        estimates = [one for joint in report['joints'] for one in joint['estimates']]
        found = {one['name']: one['interval'] for one in estimates
                 if 'not identifiable' not in one['flags']}
        return {name: (float(ends[0]), float(ends[1])) for name, ends in found.items()
                if None not in ends}
    except OSError as error:
        raise ConfigError(f'--intervals {path}: cannot be read ({error.strerror})') from error
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise ConfigError(f'--intervals {path}: is no report.json of gms_flex identify') from error


def draw(robot, intervals, rng):
    """
    Return a robot that differs from what is believed, and how.

    Parameters
    ----------
    robot : RobotParams
        As believed.
    intervals : dict of str to (float, float)
        From `read_intervals`; may be empty.
    rng : numpy.random.Generator
        Draws.

    Returns
    -------
    robot : RobotParams
        One that may be.
    factors : dict of str to float
        What was scaled, as ``joint1 link mass``.

    """
    values = robot_values(robot)
    factors = {f'{joint} {group}': float(1.0 + spread * rng.uniform(-1.0, 1.0))
               for joint in robot.joints for group, spread in SPREADS.items()}
    for name, value in values.items():
        group = _group_of(name)
        if group is None or name in intervals:
            continue
        factor = factors[f"{name.split('.')[1]} {group}"]
        scaled = np.asarray(value) * factor
        values[name] = scaled.tolist()
    for name, (low, high) in intervals.items():
        _put(values, name, float(rng.uniform(low, high)))
    for joint in robot.joints:
        _make_possible(values, f'friction.{joint}.')
    return robot_from_values(values), factors


def _group_of(name):
    part, last = name.partition('.')[0], name.rpartition('.')[2]
    if part == 'arm' and last == 'stiffness':
        return 'joint stiffness'
    return GROUPS.get(last) if part in ('arm', 'friction') else None


def _put(values, name, value):
    block = _BLOCK.fullmatch(name)
    if block and block[1] in values and int(block[2]) < len(values[block[1]]):
        values[block[1]] = list(values[block[1]])
        values[block[1]][int(block[2])] = value
    elif name in values:
        values[name] = value


def _make_possible(values, prefix):
    """Let weights sum to 1 and static friction not be below Coulomb's."""
    weight = np.asarray(values[f'{prefix}weight'])
    values[f'{prefix}weight'] = (weight / weight.sum()).tolist()
    for way in ('forward', 'backward'):
        static, coulomb = (f'{prefix}{way}.{name}' for name in ('static', 'coulomb'))
        values[static] = max(values[static], values[coulomb])


def try_drawn(item):
    """
    Draw a robot and try the controller on it.

    Parameters
    ----------
    item : Drawn
        Which one.

    Returns
    -------
    dict
        ``factors``; ``stable``, ``gain``, ``phase`` of the linear loop; ``trials``, a Trial as a
        dict for each of `MOTIONS`.

    """
    rng = np.random.default_rng([item.seed, item.number])
    robot, factors = draw(item.robot, item.intervals, rng)
    linear = judged(robot, item.robot, item.gains, item.timing, with_delay=False)
    trials = {motion: try_gains(robot, item.robot, item.gains, item.timing, motion,
                                item.amplitude, seed=item.number)[0]._asdict()
              for motion in MOTIONS}
    return {'factors': factors, 'stable': linear.stable, 'trials': trials,
            'gain': [min(float(one.gain_up), 1e9) for one in linear.joints],
            'phase': [float(one.phase) for one in linear.joints]}


class Spread(NamedTuple):
    """A figure over all draws, one entry per joint."""

    median: list
    worst: list
    worst_draw: list    # its number


def summary(outcomes):
    """
    Return what the draws say together.

    Parameters
    ----------
    outcomes : list of dict
        Of `try_drawn`, by number.

    Returns
    -------
    dict
        ``draws``; ``lost``, ``unstable``, numbers of those; ``rms`` and ``hold``, Spread as a
        dict by motion [rad]; ``gain``, ``phase``, least per joint.

    """
    lost = [k for k, one in enumerate(outcomes)
            if any(trial['lost'] for trial in one['trials'].values())]
    kept = [k for k in range(len(outcomes)) if k not in lost]
    rms = {motion: _spread([np.sqrt(outcomes[k]['trials'][motion]['mse']) for k in kept], kept)
           for motion in MOTIONS}
    hold = _spread([outcomes[k]['trials']['polynomial']['hold'] for k in kept], kept)
    return {'draws': len(outcomes), 'lost': lost, 'rms': rms, 'hold': hold,
            'unstable': [k for k, one in enumerate(outcomes) if not one['stable']],
            'gain': np.min([one['gain'] for one in outcomes], axis=0).tolist(),
            'phase': np.min([one['phase'] for one in outcomes], axis=0).tolist()}


def _spread(values, numbers):
    if not numbers:
        return None
    values = np.array(values)
    return Spread(np.median(values, axis=0).tolist(), values.max(axis=0).tolist(),
                  [numbers[k] for k in values.argmax(axis=0)])._asdict()
