# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The closed loop whose controller knows effects, in this process, as the nodes run it."""

from gms_flex_control.effect_compensation.feedforward import CompensatingController
from gms_flex_control.simulation.closed_loop import NANOSECONDS, Run
from gms_flex_control.simulation.stepped import SteppedPlant
import numpy as np

_MEASURED = ('q_link', 'dq_link', 'q_motor', 'dq_motor')


def run(robot, model, gains, reference, *, period_ns=2_000_000, substeps=20, seed=0, q_link=None,
        supply=None, begin=0.0, prepare=lambda plant: None):
    """
    Simulate the closed loop along a reference given sample by sample.

    Parameters
    ----------
    robot : RobotParams
        The plant as it is.
    model : RobotParams
        The robot as the controller believes it to be, effects included.
    gains : ControllerParams
        Of the controller.
    reference : ndarray, shape (T, 5, n_joints)
        Desired link angle and derivatives.
    period_ns : int
        Length of a sample [ns].
    substeps : int
        Integration steps per sample.
    seed : int
        Of the encoder noise.
    q_link : ndarray, shape (n_joints,), optional
        Where the links rest at the start [rad]; default zero.
    supply : ndarray, shape (T,), optional
        Voltage of the drives' supply [V]; default not known.
    begin : float
        Time of the first sample, for effects that look at it [s].
    prepare : callable, optional
        Gets the plant (SteppedPlant) before its first sample, to begin elsewhere than at rest.

    Returns
    -------
    Run
        See simulation.closed_loop; of a model without effects bit by bit what that gives.
        ``friction`` is without viscous part and effects.

    """
    period, n, samples = period_ns / NANOSECONDS, robot.n_joints, len(reference)
    plant = SteppedPlant(robot, period=period, substeps=substeps, seed=seed, q_link=q_link,
                         begin=begin)
    controller = CompensatingController(gains, model)
    # a copy: the controller is compiled anew for a read-only reference
    reference = np.array(reference, dtype=float, order='C')
    prepare(plant)
    angles, torques = np.empty((samples, 8, n)), np.empty((samples, 4, n))
    plant.measure()
    for k in range(samples):
        for i, name in enumerate(_MEASURED):
            value = getattr(plant.measured, name)
            getattr(controller.measured, name)[:] = value
            angles[k, i], angles[k, 4 + i] = value, getattr(plant.state, name)
        if supply is not None:
            plant.supply[:] = supply[k]
        # as a node that has no earlier state to form a difference with
        command = controller.tick(reference[k], period if k > 0 else 0.0)
        torques[k, 0], torques[k, 1] = command, plant.applied
        torques[k, 2] = plant.state.friction.torque.sum(axis=1)
        torques[k, 3] = controller.state.friction_hat
        plant.advance(command)
    return Run(time=np.arange(samples) * period_ns / NANOSECONDS, reference=reference,
               measured=angles[:, :4], true=angles[:, 4:], command=torques[:, 0],
               applied=torques[:, 1], friction=torques[:, 2], friction_hat=torques[:, 3])
