# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What one experiment is: robot, belief, gains, motion and timing, read from parameter files."""

from dataclasses import dataclass

from gms_flex_control.errors import ConfigError, ParameterError
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.key import checked
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema.build import controller_from_values, robot_from_values
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
ENDLESS_DURATION = 20.0  # of a motion without end where none is asked for [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """
    One closed-loop experiment.

    Parameters
    ----------
    robot, model : RobotParams
        The robot as it is, and as the controller believes it to be.
    gains : ControllerParams
        Of the controller.
    trajectory : Trajectory
        Reference in the time of the experiment.
    motion : str
        Name of the trajectory type.
    duration : float
        Length [s].
    period_ns : int
        Sample [ns].
    substeps, seed : int
        Integration steps per sample; seed of the encoder noise.
    q_link : ndarray, shape (n_joints,)
        Where the links rest at the start [rad].

    """

    robot: RobotParams
    model: RobotParams
    gains: ControllerParams
    trajectory: Trajectory
    motion: str
    duration: float
    period_ns: int
    substeps: int
    seed: int
    q_link: np.ndarray


def read_plan(files, *, model=None, overrides: dict | None = None,
              duration: float | None = None) -> Plan:
    """
    Read an experiment from the files the nodes would get.

    Parameters
    ----------
    files : sequence of str or Path
        Robot, controller and trajectory parameters, later ones winning.
    model : str, Path or sequence of them, optional
        Robot files the controller believes in; default the true robot.
    overrides : dict of str to object, optional
        Single parameters, as ``-p name:=value`` of a node.
    duration : float, optional
        Length [s]; default the parameter ``duration``, else until the trajectory ends, else
        `ENDLESS_DURATION`.

    Returns
    -------
    Plan

    Raises
    ------
    ConfigError, ParameterError
        One sentence with file and line where it has one.

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
        timing = _filled(plant_node_keys(robot.joints), values)
        motion = _filled(trajectory_keys(robot.joints), values)
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


def _filled(keys, values):
    return {key.name: checked(key, values[key.name]) if key.name in values else key.default
            for key in keys}
