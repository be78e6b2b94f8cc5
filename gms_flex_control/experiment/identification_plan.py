# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The identification experiment: its plan from parameter files, and what of it is done."""

from dataclasses import dataclass
from pathlib import Path
import shutil

from gms_flex_control.errors import ConfigError, GmsFlexError
from gms_flex_control.experiment.identification_steps import Planner, Step, StepLimits
from gms_flex_control.schema.build import complete, trajectory_from_values
from gms_flex_control.schema.keys import EXPERIMENTS, identification_keys
from gms_flex_control.trajectory.polynomials import Trajectory
import numpy as np

# of a move of degree 9 from rest to rest over unit distance in unit time
_PEAK_VELOCITY, _PEAK_ACCELERATION = 2.461, 9.372
_SHORTEST_APPROACH = 1.0  # [s]
_RESET_TIME = 0.2         # for the reference to come to rest where the links are [s]
_APPROACH_SPEED = 0.5     # of the velocity limit
APPROACH = 'approach'


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentificationPlan:
    """What the experiment does, and within which limits."""

    joints: tuple             # link names of the robot
    experiments: tuple        # of Step, those that measure something, in order
    compensation: str         # of the controller in motion steps
    limits: StepLimits
    rest_time: float          # after each step [s]
    relax_time: float         # for the springs to unload [s]

    def steps(self, finished=(), q_link=None) -> tuple[Step, ...]:
        """Return all steps but ``finished`` ones, with moves between; links are at ``q_link``."""
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

    def duration(self) -> float:
        """Return the expected length of all of it [s]."""
        return sum(step.duration_estimate for step in self.steps())

    def approach_time(self, begin, end) -> float:
        """Return the time for a move from rest to rest within the limits [s]."""
        distance = np.abs(np.asarray(end) - np.asarray(begin))
        at_speed = _PEAK_VELOCITY * distance / (_APPROACH_SPEED * self.limits.velocity)
        at_force = np.sqrt(_PEAK_ACCELERATION * distance / self.limits.acceleration)
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

    def trajectory(self, step) -> Trajectory:
        """Return the reference of a motion or torque step."""
        return trajectory_from_values(step.trajectory_parameters, self.joints)


def plan_identification(values: dict, robot, gains) -> IdentificationPlan:
    """Plan the experiment for a robot as believed and the gains of the controller to be run."""
    flat = complete(identification_keys(robot.joints), values)
    limits = StepLimits.read(flat, robot, gains)
    unknown = [joint for joint in flat['identification.joints'] if joint not in robot.joints]
    if unknown:
        raise ConfigError(f'identification.joints: unknown joint {unknown[0]!r} '
                          f'(robot has {", ".join(robot.joints)})')
    planner = Planner(flat, robot, limits)
    experiments = []
    for joint in flat['identification.joints'] or robot.joints:
        for number, experiment in enumerate(flat['identification.experiments']):
            if experiment not in EXPERIMENTS:
                raise ConfigError(f'identification.experiments: unknown {experiment!r} at place '
                                  f'{number + 1}, known are {", ".join(EXPERIMENTS)}')
            experiments += planner.plan(experiment, joint)
    return IdentificationPlan(
        joints=robot.joints, experiments=tuple(experiments),
        compensation=flat['identification.compensation'], limits=limits,
        rest_time=flat['identification.rest_time'],
        relax_time=flat['identification.relax_time'])


_LEAST, _MOST = 0.2, 3.0  # of what was planned
LEAVING = 0.2  # of the travel that ends a break-away step: there it begins
_CAUTION = 0.85    # the torque found is late by what inertia takes, and differs each time


class ExperimentError(GmsFlexError):
    """An experiment cannot begin or go on."""


def require_space(folder, needed) -> None:
    """Raise ExperimentError if the disk of ``folder`` has less than ``needed`` bytes and 10 %."""
    folder = Path(folder).resolve()
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free < 1.1 * needed:
        raise ExperimentError(f'{folder}: has {free / 1e6:.0f} MB free and the recording needs '
                              f'about {needed / 1e6:.0f} MB; make room or name another '
                              'identification.bag')


class Adaptation:
    """The least break-away torque ``found`` by joint [N m], and what follows for presliding."""

    def __init__(self, plan):
        self._plan, self.found = plan, {}

    def broke_away(self, step, time) -> float:
        """Note at what ``time`` [s] a break-away step moved; return its torque less gravity."""
        j = self._plan.joints.index(step.joint)
        bias = step.trajectory_parameters[f'trajectory.{step.joint}.bias']
        trajectory = self._plan.trajectory(step)
        top_time = 0.5 * trajectory.end  # it rises, then falls
        torque = abs(trajectory.sample(min(time, top_time))[0, j] - bias)
        self.found[step.joint] = min(float(torque), self.found.get(step.joint, float(torque)))
        return torque

    def applied_to(self, step) -> Step:
        """Return a Step as to be done: presliding levels scaled by found over expected torque."""
        if step.phase != 'presliding' or step.joint not in self.found:
            return step
        j = self._plan.joints.index(step.joint)
        factor = _CAUTION * self.found[step.joint] / self._plan.limits.weakest_static[j]
        factor = min(max(factor, _LEAST), _MOST)
        name = f'trajectory.{step.joint}.levels'
        bias = abs(step.trajectory_parameters[f'trajectory.{step.joint}.bias'])
        factor = min(factor, (self._plan.limits.torque[j] - bias) / step.value)
        levels = [factor * level for level in step.trajectory_parameters[name]]
        return step._replace(trajectory_parameters=step.trajectory_parameters | {name: levels},
                             value=factor * step.value)
