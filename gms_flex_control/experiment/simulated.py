# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""An experiment in this process: read from files, what is believed of the robot, simulated."""

from dataclasses import dataclass, replace

from gms_flex_control.data.recording import Recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import ConfigError, ParameterError, SimulationError
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import FrictionParams, RobotParams
from gms_flex_control.schema.build import (
    complete,
    controller_from_values,
    robot_from_values,
    trajectory_from_values,
)
from gms_flex_control.schema.files import load_robot, located, read_values
from gms_flex_control.schema.keys import known_keys, plant_node_keys, trajectory_keys
from gms_flex_control.simulation import loop
from gms_flex_control.simulation.loop import NANOSECONDS, Run, SteppedPlant
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.polynomials import require_within, Trajectory
import numpy as np

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
    places |= {name: f'--set {name}={value}' for name, value in (overrides or {}).items()}
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


def simulate(plan: Plan, source: str = 'simulation') -> Recording:
    """Return the Recording of a plan, simulated; SimulationError where it diverges."""
    return to_recording(run_plan(plan), plan, source)


def run_plan(plan: Plan) -> Run:
    """Return the Run of a plan, true states included; SimulationError as of `simulate`."""
    run = loop.run(
        plan.robot, plan.model, plan.gains, plan.trajectory, duration=plan.duration,
        period_ns=plan.period_ns, substeps=plan.substeps, seed=plan.seed, q_link=plan.q_link)
    sound = np.isfinite(run.true).all(axis=(1, 2)) & np.isfinite(run.command).all(axis=1)
    if not sound.all():
        raise SimulationError(f'the simulation diverged at {run.time[np.argmin(sound)]:g} s; '
                              'raise substeps, or check stiffness, inertia and gains')
    return run


def to_recording(run: Run, plan: Plan, source: str = 'simulation') -> Recording:
    """Return the Run of a plan as a Recording."""
    return recording_of(
        plan.robot, run.measured, time=run.time, tau_motor=run.applied, command=run.command,
        reference=run.reference, friction_hat=run.friction_hat, source=source)


def recording_of(robot: RobotParams, measured: np.ndarray, **channels) -> Recording:
    """Return a Recording; ``measured`` is (T, 4, n): q_link, dq_link, q_motor, dq_motor."""
    q_link, dq_link, q_motor, dq_motor = np.moveaxis(measured, 1, 0)
    rigid = robot.arm.rigid
    return Recording(
        joints=robot.joints, q_link=q_link, dq_link=dq_link,
        q_motor=np.where(rigid, np.nan, q_motor), dq_motor=np.where(rigid, np.nan, dq_motor),
        **channels)


def simulate_to_bag(plan: Plan, path) -> Recording:
    """Simulate a plan into a bag at ``path``, whole or not at all; BagError if it cannot be."""
    recording = simulate(plan, str(path))
    write_recording(path, recording, plan.robot.motors,
                    source='/cascade_controller', custom={
                        'trajectory': plan.motion, 'compensation': plan.gains.compensation,
                        'period_ns': str(plan.period_ns), 'axes': plan.robot.arm.axes})
    return recording


# the mixed model error of docs/model.md
FRICTION, STIFFNESS, MASS = 0.85, 1.05, 0.93


def scaled_friction(friction, factor) -> FrictionParams:
    """Return FrictionParams with static, coulomb, viscous and block stiffness scaled."""
    return friction.each_way(
        lambda steady: steady.scaled(static=factor, coulomb=factor, viscous=factor),
        stiffness=friction.stiffness * factor)


def scaled_robot(robot, friction=1.0, stiffness=1.0, mass=1.0) -> RobotParams:
    """Return the robot with friction, joint stiffness, and masses and inertias of links scaled."""
    return replace(robot, friction=scaled_friction(robot.friction, friction), arm=replace(
        robot.arm.scaled(mass), stiffness=robot.arm.stiffness * stiffness))


def mixed_error(robot) -> RobotParams:
    """Return the robot with friction x 0.85, joint stiffness x 1.05 and link masses x 0.93."""
    return scaled_robot(robot, FRICTION, STIFFNESS, MASS)
