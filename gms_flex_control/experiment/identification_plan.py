# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The identification experiment as a frozen list of steps, planned before anything moves."""

from dataclasses import dataclass
import hashlib
import json
from typing import NamedTuple

from gms_flex_control.errors import ConfigError, ParameterError
from gms_flex_control.experiment import identification_steps as steps
from gms_flex_control.schema.files import located, read_values
from gms_flex_control.schema.key import checked
from gms_flex_control.schema.keys import known_keys
from gms_flex_control.schema.motion import trajectory_from_values
from gms_flex_control.schema.node_keys import identification_keys, trajectory_keys
import numpy as np

# of a move of degree 9 from rest to rest over unit distance in unit time
_PEAK_VELOCITY, _PEAK_ACCELERATION = 2.461, 9.372
_SHORTEST_APPROACH = 1.0  # [s]
_RESET_TIME = 0.2         # for the reference to come to rest where the links are [s]
_APPROACH_SPEED = 0.5     # of the velocity limit
APPROACH = 'approach'


class Step(NamedTuple):
    """
    One step of the experiment.

    Parameters
    ----------
    name : str
        Unique in the plan.
    phase : str
        constant_velocity, break_away, presliding, sliding or approach.
    joint : str
        Which joint is identified.
    kind : {'motion', 'torque', 'approach', 'relax'}
        Follow the reference; apply it as open-loop torque; go to ``end``; let the springs
        unload where the arm is.
    trajectory_parameters : dict of str to object
        For the trajectory node.
    value : float
        Signed velocity [rad/s] or torque amplitude [N m].
    duration_estimate : float
        Expected [s].
    begin, end : tuple of float, or None
        Link angles at both ends [rad]; None where they depend on the robot.
    travel : float
        The step ends once the joint has moved this far [rad]; 0 for never.

    """

    name: str
    phase: str
    joint: str
    kind: str
    trajectory_parameters: dict
    value: float
    duration_estimate: float
    begin: tuple = None
    end: tuple = None
    travel: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentificationPlan:
    """
    What the experiment does, and within which limits.

    Parameters
    ----------
    joints : tuple of str
        Link names of the robot.
    experiments : tuple of Step
        The steps that measure something, in order.
    compensation : str
        Mode of the controller in motion steps.
    lower, upper, velocity, acceleration, torque : ndarray, shape (n_joints,)
        Limits [rad, rad/s, rad/s^2, N m].
    static : ndarray, shape (n_joints,)
        Expected static friction of the weaker direction [N m].
    rest_time, relax_time : float
        Rest after each step; time for the springs to unload [s].

    """

    joints: tuple
    experiments: tuple
    compensation: str
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    static: np.ndarray
    rest_time: float
    relax_time: float

    def steps(self, finished=(), q_link=None):
        """
        Return all steps in order, with the moves between those that measure.

        Parameters
        ----------
        finished : collection of str, optional
            Names of steps to leave out.
        q_link : ndarray, shape (n_joints,), optional
            Where the links are [rad]; default zero.

        Returns
        -------
        tuple of Step

        """
        place = tuple(np.zeros(len(self.joints)) if q_link is None else np.asarray(q_link))
        result = []
        for step in self.experiments:
            if step.name in finished:
                continue
            if place is None or not np.allclose(place, step.begin, rtol=0.0, atol=1e-9):
                result.append(self._approach(step, place))
            if step.kind == 'torque':
                result.append(self._relax(step))
            result.append(step)
            place = step.end
        return tuple(result)

    def duration(self, finished=()):
        """Return the expected length of what is not finished [s]."""
        return sum(step.duration_estimate for step in self.steps(finished))

    def approach_time(self, begin, end):
        """Return the time for a move from rest to rest within the limits [s]."""
        distance = np.abs(np.asarray(end) - np.asarray(begin))
        at_speed = _PEAK_VELOCITY * distance / (_APPROACH_SPEED * self.velocity)
        at_force = np.sqrt(_PEAK_ACCELERATION * distance / self.acceleration)
        return float(max(_SHORTEST_APPROACH, at_speed.max(), at_force.max()))

    def _approach(self, step, place):
        values = {'trajectory.type': 'via_points', 'trajectory.hold_time': 0.0}
        values |= {f'trajectory.{joint}.points': [float(angle)]
                   for joint, angle in zip(self.joints, step.begin, strict=True)}
        time = self.approach_time(step.begin if place is None else place, step.begin)
        return Step(f'{step.name}/approach', APPROACH, step.joint, 'approach', values, 0.0,
                    time + self.rest_time, end=step.begin)

    def _relax(self, step):
        return Step(f'{step.name}/relax', APPROACH, step.joint, 'relax',
                    {'trajectory.approach_time': _RESET_TIME}, 0.0,
                    2 * self.relax_time, begin=step.begin)

    def trajectory(self, step):
        """Return the reference of a motion or torque step (Trajectory)."""
        values = {key.name: key.default for key in trajectory_keys(self.joints)}
        return trajectory_from_values(values | step.trajectory_parameters, self.joints)

    def fingerprint(self):
        """Return a short text that changes with the plan."""
        text = json.dumps([[*step] for step in self.experiments])
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def plan_identification(values, robot, gains):
    """
    Plan the experiment from flat parameters.

    Parameters
    ----------
    values : dict of str to object
        With ``identification.*`` keys, see schema.keys.identification_keys.
    robot : RobotParams
        As the user believes it to be.
    gains : ControllerParams
        Of the controller that will run.

    Returns
    -------
    IdentificationPlan

    Raises
    ------
    ConfigError
        If a value is out of range, or a step cannot keep a limit.

    """
    flat = {key.name: checked(key, values[key.name]) if key.name in values else key.default
            for key in identification_keys(robot.joints)}
    limits = steps.Limits.read(flat, robot, gains)
    unknown = [joint for joint in flat['identification.joints'] if joint not in robot.joints]
    if unknown:
        raise ConfigError(f'identification.joints: unknown joint {unknown[0]!r} '
                          f'(robot has {", ".join(robot.joints)})')
    planner = steps.Planner(flat, robot, limits)
    experiments = []
    for joint in flat['identification.joints'] or robot.joints:
        for number, experiment in enumerate(flat['identification.experiments']):
            if experiment not in steps.EXPERIMENTS:
                raise ConfigError(f'identification.experiments: unknown {experiment!r} at place '
                                  f'{number + 1}, known are {", ".join(steps.EXPERIMENTS)}')
            experiments += [Step(*fields) for fields in planner.plan(experiment, joint)]
    return IdentificationPlan(
        joints=robot.joints, experiments=tuple(experiments),
        compensation=flat['identification.compensation'], lower=limits.lower,
        upper=limits.upper, velocity=limits.velocity, acceleration=limits.acceleration,
        torque=limits.torque, static=limits.weakest_static,
        rest_time=flat['identification.rest_time'],
        relax_time=flat['identification.relax_time'])


def read_identification_plan(files, robot, gains, *, overrides=None):
    """
    Plan the experiment from parameter files, later ones winning.

    Parameters
    ----------
    files : sequence of str or Path
        Such as ``config/identification.yaml``; keys of other nodes may stand in the same files.
    robot : RobotParams
        As the user believes it to be.
    gains : ControllerParams
        Of the controller that will run.
    overrides : dict of str to object, optional
        Single parameters.

    Returns
    -------
    IdentificationPlan

    Raises
    ------
    ConfigError
        One sentence with file and line where it has one.

    """
    values, places = read_values(files)
    values |= overrides or {}
    try:
        known_keys(values, robot.joints)
        return plan_identification(values, robot, gains)
    except (ConfigError, ParameterError) as error:
        raise located(error, files, places) from error
