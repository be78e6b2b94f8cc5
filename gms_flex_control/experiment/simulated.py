# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Run a plan in this process and write the bag its nodes would have made."""

from gms_flex_control.data.recording import Recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import SimulationError
from gms_flex_control.experiment.plan import Plan
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.simulation import closed_loop
from gms_flex_control.simulation.closed_loop import Run
import numpy as np


def simulate(plan: Plan, source: str = 'simulation') -> Recording:
    """
    Simulate a plan; return what was measured, commanded and estimated.

    ``source`` is for messages and titles. SimulationError says when it diverged.
    """
    return to_recording(run_plan(plan), plan, source)


def run_plan(plan: Plan) -> Run:
    """Return the Run of a plan, true states included; SimulationError as of `simulate`."""
    run = closed_loop.run(
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
    """
    Simulate a plan and write its bag, a folder at ``path``, whole or not at all.

    BagError if ``path`` exists or cannot be written.
    """
    recording = simulate(plan, str(path))
    write_recording(path, recording, plan.robot.motors,
                    source='/cascade_controller', custom={
                        'trajectory': plan.motion, 'compensation': plan.gains.compensation,
                        'period_ns': str(plan.period_ns)})
    return recording
