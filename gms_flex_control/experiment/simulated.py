# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Run a plan in this process and write the bag its nodes would have made."""

from gms_flex_control.data.recording import Recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import SimulationError
from gms_flex_control.experiment.plan import Plan
from gms_flex_control.simulation import closed_loop
from gms_flex_control.simulation.closed_loop import Run
import numpy as np


def simulate(plan: Plan, source: str = 'simulation') -> Recording:
    """
    Simulate a plan.

    Parameters
    ----------
    plan : Plan
        The experiment.
    source : str
        For messages and titles.

    Returns
    -------
    Recording
        What was measured, commanded and estimated.

    Raises
    ------
    SimulationError
        If it diverges; the sentence says when.

    """
    return to_recording(run_plan(plan), plan, source)


def run_plan(plan: Plan) -> Run:
    """Return the Run of a plan, true states included; arguments and errors as of `simulate`."""
    run = closed_loop.run(
        plan.robot, plan.model, plan.gains, plan.trajectory, duration=plan.duration,
        period_ns=plan.period_ns, substeps=plan.substeps, seed=plan.seed, q_link=plan.q_link)
    sound = np.isfinite(run.true).all(axis=(1, 2)) & np.isfinite(run.command).all(axis=1)
    if not sound.all():
        raise SimulationError(f'the simulation diverged at {run.time[np.argmin(sound)]:g} s; '
                              'raise substeps, or check stiffness, inertia and gains')
    return run


def to_recording(run: Run, plan: Plan, source: str = 'simulation') -> Recording:
    """
    Return a simulated run as a Recording: what was measured, commanded and estimated.

    Parameters
    ----------
    run : Run
        From `run_plan`.
    plan : Plan
        It was made from.
    source : str
        For messages and titles.

    Returns
    -------
    Recording

    """
    q_link, dq_link, q_motor, dq_motor = np.moveaxis(run.measured, 1, 0)
    rigid = plan.robot.arm.rigid
    return Recording(
        joints=plan.robot.joints, time=run.time, q_link=q_link, dq_link=dq_link,
        q_motor=np.where(rigid, np.nan, q_motor), dq_motor=np.where(rigid, np.nan, dq_motor),
        tau_motor=run.applied, command=run.command, reference=run.reference,
        friction_hat=run.friction_hat, source=source)


def simulate_to_bag(plan: Plan, path) -> Recording:
    """
    Simulate a plan and write its bag, whole or not at all.

    Parameters
    ----------
    plan : Plan
        The experiment.
    path : str or Path
        Bag folder to be made.

    Returns
    -------
    Recording

    Raises
    ------
    BagError
        If ``path`` exists or cannot be written.

    """
    recording = simulate(plan, str(path))
    write_recording(path, recording, plan.robot.motors,
                    source='/cascade_controller', custom={
                        'trajectory': plan.motion, 'compensation': plan.gains.compensation,
                        'period_ns': str(plan.period_ns)})
    return recording
