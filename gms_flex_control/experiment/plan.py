# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What one experiment is: robot, belief, gains, motion and timing, read from parameter files."""

from dataclasses import dataclass

from gms_flex_control.errors import ConfigError, ParameterError
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema.build import complete, controller_from_values, robot_from_values
from gms_flex_control.schema.files import load_robot, located, read_values
from gms_flex_control.schema.keys import known_keys
from gms_flex_control.schema.motion import trajectory_from_values
from gms_flex_control.schema.node_keys import plant_node_keys, trajectory_keys
from gms_flex_control.simulation.stepped import SteppedPlant
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.limits import require_within
from gms_flex_control.trajectory.segments import Trajectory
import numpy as np

NANOSECONDS = 1_000_000_000
ENDLESS_DURATION = 20.0  # of a motion without end where none is given [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """One closed-loop experiment."""

    robot: RobotParams      # as it is
    model: RobotParams      # as the controller believes it to be
    gains: ControllerParams
    trajectory: Trajectory  # in the time of the experiment
    motion: str             # name of the trajectory type
    duration: float         # [s]
    period_ns: int          # sample [ns]
    substeps: int           # integration steps per sample
    seed: int               # of the encoder noise
    q_link: np.ndarray      # (n,) where the links rest at the start [rad]


def read_plan(files, *, model=None, overrides: dict | None = None,
              duration: float | None = None) -> Plan:
    """
    Read an experiment from the files the nodes would get, later ones winning.

    ``model`` is the robot file (or files) the controller believes in, by default the true robot;
    ``overrides`` are single parameters, as ``-p name:=value`` of a node. The length is
    ``duration`` [s], else the parameter of that name, else until the trajectory ends, else
    `ENDLESS_DURATION`. ConfigError or ParameterError is one sentence with file and line.
    """
    robot = load_robot(files)
    values, places = read_values(files)
    values |= overrides or {}
    places |= dict.fromkeys(overrides or {}, 'override')
    try:
        known_keys(values, robot.joints)
        if any(name.startswith(('arm.', 'friction.', 'effects.', 'encoder.', 'joints', 'motors'))
               for name in overrides or {}):
            robot = robot_from_values(values)
        gains = controller_from_values(values, robot.joints)
        timing = complete(plant_node_keys(robot.joints), values)
        motion = complete(trajectory_keys(robot.joints), values)
    except (ConfigError, ParameterError) as error:
        raise located(error, files, places) from error
    q_link = np.array([timing[f'initial.{joint}'] for joint in robot.joints])
    period_ns = round(NANOSECONDS / timing['rate'])
    trajectory = _reference(motion, robot, SteppedPlant(
        robot, period=period_ns / NANOSECONDS, substeps=timing['substeps'], seed=timing['seed'],
        q_link=q_link))
    if duration is None:
        duration = timing['duration'] or (
            trajectory.end if 0.0 < trajectory.end < np.inf else ENDLESS_DURATION)
    if not 2 * period_ns / NANOSECONDS <= duration < np.inf:
        raise ConfigError(f'--duration must be at least two samples '
                          f'({2e-9 * period_ns:g} s) and finite, got {duration}')
    return Plan(robot=robot, model=robot if model is None else load_robot(model),
                gains=gains, trajectory=trajectory,
                motion=motion['trajectory.type'], duration=duration, q_link=q_link,
                period_ns=period_ns, substeps=timing['substeps'], seed=timing['seed'])


def _reference(motion, robot, plant):
    """Return the reference from where the encoders see the robot, as trajectory_node does."""
    chosen = trajectory_from_values(motion, robot.joints)
    if chosen.quantity != 'motion':
        raise ConfigError(f"trajectory.type {motion['trajectory.type']} is an open-loop torque, "
                          'which the closed loop cannot follow; run the nodes')
    plant.measure()
    if motion['trajectory.type'] == 'hold':
        return builders.hold(plant.measured.q_link)
    reference = builders.approach(builders.at_rest(plant.measured.q_link), chosen, 0.0,
                                  duration=motion['trajectory.approach_time'])
    require_within(reference, robot.joints, robot.arm.frames, robot.arm.offset)
    return reference
