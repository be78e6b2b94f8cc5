# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Plant, encoders and controller in one compiled loop: the experiment without ROS."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import os

from gms_flex_control.compiled import compiled
from gms_flex_control.control import cascade
from gms_flex_control.effects import signals as sig
from gms_flex_control.simulation import encoder, plant
import numpy as np

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """
    What happened at T sample times; the command at k acts from sample k to k + 1.

    Parameters
    ----------
    time : ndarray, shape (T,)
        [s].
    reference : ndarray, shape (T, 5, n_joints)
        Desired link angle and derivatives.
    measured : ndarray, shape (T, 4, n_joints)
        Measured q_link, dq_link, q_motor, dq_motor.
    true : ndarray, shape (T, 4, n_joints)
        The same without encoders.
    command, applied : ndarray, shape (T, n_joints)
        Torque asked for at the sample, and given by the actuators in the one before [N m].
    friction, friction_hat : ndarray, shape (T, n_joints)
        True friction torque of the blocks plus viscous part, and the estimate [N m].

    """

    time: np.ndarray
    reference: np.ndarray
    measured: np.ndarray
    true: np.ndarray
    command: np.ndarray
    applied: np.ndarray
    friction: np.ndarray
    friction_hat: np.ndarray


@compiled
def sense(measured, state, time, period, constants, encoders, work):
    """Take one sample with the noise drawn before: sensor effects first, then encoders."""
    plant.sensed(state, state.applied, time, period, constants, work)
    s = work.signals
    encoder.measure(measured, s[:, sig.SENSED_LINK], s[:, sig.SENSED_MOTOR], state.dq_link,
                    state.dq_motor, period, encoders)


@compiled
def run_loop(reference, period, substeps, plant_state, plant_constants, plant_work, measured,
             encoders, rng, control_state, control_constants, control_work, angles, torques):
    """Run T samples; fills ``angles`` (T, 8, n) and ``torques`` (T, 4, n)."""
    for k in range(reference.shape[0]):
        time = k * period
        encoder.draw(measured, encoders, rng)
        sense(measured, plant_state, time, period, plant_constants, encoders, plant_work)
        # as a node that has no earlier state to form a difference with
        elapsed = period if k > 0 else 0.0
        cascade.tick(control_state, measured, reference[k], elapsed, control_constants,
                     control_work)
        plant.gms.total(plant_state.friction, plant_state.dq_link, plant_constants.friction,
                        plant_work.friction)
        for j in range(plant_state.q_link.shape[0]):
            angles[k, 0, j], angles[k, 1, j] = measured.q_link[j], measured.dq_link[j]
            angles[k, 2, j], angles[k, 3, j] = measured.q_motor[j], measured.dq_motor[j]
            angles[k, 4, j], angles[k, 5, j] = plant_state.q_link[j], plant_state.dq_link[j]
            angles[k, 6, j], angles[k, 7, j] = plant_state.q_motor[j], plant_state.dq_motor[j]
            torques[k, 0, j], torques[k, 1, j] = control_state.command[j], plant_state.applied[j]
            torques[k, 2, j] = plant_work.friction[j]
            torques[k, 3, j] = control_state.friction_hat[j]
        plant.advance(plant_state, control_state.command, time, period, substeps,
                      plant_constants, plant_work)


def run(robot, model, gains, trajectory, *, duration, period_ns=2_000_000, substeps=20, seed=0,
        q_link=None):
    """
    Simulate the closed loop.

    Parameters
    ----------
    robot : RobotParams
        The plant as it is.
    model : RobotParams
        The robot as the controller believes it to be.
    gains : ControllerParams
        Of the controller.
    trajectory : Trajectory
        Reference, a motion.
    duration : float
        Length of the run [s].
    period_ns : int
        Length of a sample [ns]; an integer, as the stamps of the nodes are.
    substeps : int
        Integration steps per sample.
    seed : int
        Of the encoder noise.
    q_link : ndarray, shape (n_joints,), optional
        Where the links rest at the start [rad]; default zero.

    Returns
    -------
    Run

    Notes
    -----
    Releases the GIL: `run_batch` runs many in threads.

    """
    n, period = robot.n_joints, period_ns / NANOSECONDS
    time = np.arange(round(duration / period)) * period_ns / NANOSECONDS
    reference = trajectory.sample(time)
    angles, torques = np.empty((len(time), 8, n)), np.empty((len(time), 4, n))
    run_loop(reference, period, substeps, plant.init(robot, q_link), plant.constants_of(robot),
             plant.workspace(n), encoder.init(n), encoder.constants_of(robot.encoder),
             np.random.default_rng(seed), cascade.init(model),
             cascade.constants_of(gains, model), cascade.workspace(n), angles, torques)
    return Run(time=time, reference=reference, measured=angles[:, :4], true=angles[:, 4:],
               command=torques[:, 0], applied=torques[:, 1], friction=torques[:, 2],
               friction_hat=torques[:, 3])


def run_batch(jobs, *, workers=None):
    """
    Simulate many parameter sets, in threads.

    Parameters
    ----------
    jobs : sequence of dict
        Arguments of `run`, by name.
    workers : int, optional
        Threads; default one per processor.

    Returns
    -------
    list of Run
        In the order of the jobs.

    """
    with ThreadPoolExecutor(max_workers=workers or os.cpu_count()) as pool:
        return list(pool.map(lambda job: run(**job), jobs))
