# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The identification experiment in this process: the same steps without ROS, and fast."""

from dataclasses import replace

from gms_flex_control.data.recording import Phase, Recording
from gms_flex_control.errors import ConfigError, ParameterError, SimulationError
from gms_flex_control.experiment.identification_plan import (
    Adaptation,
    IdentificationPlan,
    LEAVING,
    plan_identification,
)
from gms_flex_control.experiment.identification_steps import BRAKING_TIME
from gms_flex_control.experiment.simulated import recording_of
from gms_flex_control.schema.files import located, read_values
from gms_flex_control.schema.keys import known_keys
from gms_flex_control.simulation.loop import Loop
from gms_flex_control.trajectory import builders
import numpy as np

NANOSECONDS = 1_000_000_000
IDLE = 'idle'
_INTEGRATION_STEP = 1e-4  # [s]
_START = 1e-3  # links begin within this, so that encoders turn over elsewhere each time [rad]


def read_identification_plan(files, robot, gains, *,
                             overrides: dict | None = None) -> IdentificationPlan:
    """
    Plan the experiment from parameter files, later ones winning; see `plan_identification`.

    Such as ``config/identification.yaml``; keys of other nodes may stand in the same files.
    ``overrides`` are single parameters. ConfigError begins with file and line where it has them.
    """
    values, places = read_values(files)
    values |= overrides or {}
    try:
        known_keys(values, robot.joints)
        return plan_identification(values, robot, gains)
    except (ConfigError, ParameterError) as error:
        raise located(error, files, places) from error


def simulate_identification(plan, robot, gains, seed, *, rate=1000, torque_noise=1e-3,
                            model=None) -> tuple[Recording, tuple]:
    """
    Run the IdentificationPlan on a simulated robot; return its Recording and Phases.

    The plan chooses the compensation of ``gains``; ``model`` is the robot as the controller
    believes it to be, by default as it is. ``seed`` is of encoder and torque noise, and of where
    within a count the links begin; ``rate`` in samples per second [Hz]; ``torque_noise`` the
    standard deviation of the recorded torque beyond what acts [N m]. SimulationError if it
    diverges.
    """
    experiment = _Experiment(plan, robot, gains, model or robot, seed, rate)
    for step in plan.steps():
        experiment.do(step)
    experiment.phase(IDLE, '', '', 0.0)
    return experiment.recording(torque_noise, np.random.default_rng([seed, 1])), \
        tuple(experiment.phases)


class _Experiment:
    """Takes the part of trajectory node, controller node and identification node."""

    def __init__(self, plan, robot, gains, model, seed, rate):
        self._plan, self._robot, self._adaptation = plan, robot, Adaptation(plan)
        self._gains = replace(gains, compensation=plan.compensation)
        self._relaxed = replace(gains, compensation='none')
        self._period_ns = round(NANOSECONDS / rate)
        self._period = self._period_ns / NANOSECONDS
        start = _START * np.random.default_rng([seed, 2]).uniform(-1.0, 1.0, robot.n_joints)
        self._loop = Loop(robot, replace(model, effects=()), period_ns=self._period_ns, seed=seed,
                          q_link=start, substeps=max(1, round(self._period / _INTEGRATION_STEP)))
        self._state = builders.at_rest(np.zeros(robot.n_joints))
        self._q_link = self._state[0].copy()
        self._runs, self._references, self.phases = [], [], []

    def phase(self, name, joint, step, value) -> None:
        """Note that a phase begins with the next sample."""
        self.phases.append(Phase(self._loop.samples * self._period_ns, name, joint, step, value))

    def do(self, step) -> None:
        """Carry out one step."""
        step = self._adaptation.applied_to(step)
        self.phase(step.phase, step.joint, step.name, step.value)
        if step.kind == 'relax':
            for _ in range(2):
                self._state = builders.at_rest(self._q_link)
                self._follow(builders.hold(self._q_link), self._plan.relax_time, self._relaxed)
        elif step.kind == 'torque':
            self._open_loop(step)
            self._brake()
        else:
            self._move(step)

    def _move(self, step):
        time, chosen = 0.0, self._plan.trajectory(step)
        if step.kind == 'approach':
            time = self._plan.approach_time(self._state[0], step.end)
        moved = builders.approach(self._state, chosen, 0.0, duration=time)
        self._follow(moved, moved.end + self._plan.rest_time, self._gains)
        self._state = builders.at_rest(chosen.sample(chosen.end)[0])

    def _open_loop(self, step):
        trajectory, travel = self._plan.trajectory(step), np.full(len(self._q_link), np.inf)
        travel[self._robot.joints.index(step.joint)] = step.travel or np.inf
        self._keep(trajectory, trajectory.end, self._relaxed, is_effort=True, travel=travel)
        if step.phase == 'break_away':
            j = self._robot.joints.index(step.joint)
            q_link = self._runs[-1].measured[:, 0, j]
            still = np.flatnonzero(np.abs(q_link - q_link[0]) <= LEAVING * step.travel)
            self._adaptation.broke_away(step, still[-1] * self._period)

    def _brake(self):
        state = builders.at_rest(self._q_link)
        state[1] = self._runs[-1].measured[-1, 1]
        goal = self._q_link + 0.5 * BRAKING_TIME * state[1]
        way = builders.approach(state, builders.hold(goal), 0.0, duration=BRAKING_TIME)
        self._state = builders.at_rest(goal)
        self._follow(way, BRAKING_TIME + self._plan.rest_time, self._gains)

    def _follow(self, trajectory, duration, gains):
        self._keep(trajectory, duration, gains, is_effort=False, travel=None)

    def _keep(self, trajectory, duration, gains, *, is_effort, travel):
        time = self._period * np.arange(max(1, round(duration / self._period)))
        reference = trajectory.sample(time)
        run = self._loop.run(reference, gains, is_effort=is_effort, travel=travel)
        reference = reference[:len(run.command)]
        self._q_link = run.measured[-1, 0].copy()
        if not np.isfinite(run.measured).all():
            raise SimulationError(f'the simulated experiment diverged in '
                                  f'{self.phases[-1].step}; check gains, inertia and stiffness')
        self._runs.append(run)
        self._references.append(np.full_like(reference, np.nan) if is_effort else reference)

    def recording(self, torque_noise, rng) -> Recording:
        """Return all samples as a Recording."""
        measured, command, applied = (np.concatenate([getattr(run, name) for run in self._runs])
                                      for name in ('measured', 'command', 'applied'))
        noise = torque_noise * rng.standard_normal(applied.shape)
        return recording_of(
            self._robot, measured, time=self._period * np.arange(len(command)),
            tau_motor=applied + noise, command=command, source='simulated identification',
            reference=np.concatenate(self._references),
            friction_hat=np.full_like(command, np.nan))
