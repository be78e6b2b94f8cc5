# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The closed loop stretch by stretch: motion or open-loop torque, as the nodes would have it."""

from typing import NamedTuple

from gms_flex_control.compiled import compiled
from gms_flex_control.control import cascade
from gms_flex_control.simulation import closed_loop, encoder, plant
import numpy as np

MEASURED = ('q_link', 'dq_link', 'q_motor', 'dq_motor')


class Stretch(NamedTuple):
    """What was measured and commanded at the T samples of a stretch."""

    measured: np.ndarray  # (T, 4, n): q_link, dq_link, q_motor, dq_motor
    command: np.ndarray   # (T, n) torque that answers each sample [N m]
    applied: np.ndarray   # (T, n) torque given over the sample before [N m]


@compiled
def run_stretch(reference, is_effort, travel, first, period, substeps, plant_state,
                plant_constants, plant_work, measured, encoders, rng, control_state,
                control_constants, control_work, angles, torques):
    """Run until the reference ends or a link has moved by ``travel`` (n,); return samples."""
    n = plant_state.q_link.shape[0]
    for k in range(reference.shape[0]):
        time = (first + k) * period
        encoder.draw(measured, encoders, rng)
        closed_loop.sense(measured, plant_state, time, period, plant_constants, encoders,
                          plant_work)
        if is_effort:
            for j in range(n):
                limit = control_constants.torque_limit[j]
                control_state.command[j] = min(max(reference[k, 0, j], -limit), limit)
        else:
            elapsed = period if first + k > 0 else 0.0
            cascade.tick(control_state, measured, reference[k], elapsed, control_constants,
                         control_work)
        arrived = False
        for j in range(n):
            angles[k, 0, j], angles[k, 1, j] = measured.q_link[j], measured.dq_link[j]
            angles[k, 2, j], angles[k, 3, j] = measured.q_motor[j], measured.dq_motor[j]
            torques[k, 0, j], torques[k, 1, j] = control_state.command[j], plant_state.applied[j]
            arrived |= abs(measured.q_link[j] - angles[0, 0, j]) > travel[j]
        plant.advance(plant_state, control_state.command, time, period, substeps,
                      plant_constants, plant_work)
        if arrived:
            return k + 1
    return reference.shape[0]


class StretchedLoop:
    """
    A robot and its controller, run one stretch of reference after the other.

    Parameters
    ----------
    robot, model : RobotParams
        As it is, and as the controller believes it to be.
    period : float
        Sample [s].
    substeps : int
        Integration steps in it.
    seed : int
        Of the encoder noise.
    q_link : ndarray, shape (n_joints,), optional
        Where the links rest at the start [rad].

    """

    def __init__(self, robot, model, *, period, substeps, seed=0, q_link=None):
        n = robot.n_joints
        self._period, self._substeps, self._model, self.samples = period, substeps, model, 0
        self._plant = (plant.init(robot, q_link), plant.constants_of(robot), plant.workspace(n))
        self._encoders = (encoder.init(n), encoder.constants_of(robot.encoder),
                          np.random.default_rng(seed))
        self._control, self._control_work = cascade.init(model), cascade.workspace(n)
        self._n = n

    def run(self, reference, gains, *, is_effort=False, travel=None):
        """
        Follow a reference.

        Parameters
        ----------
        reference : ndarray, shape (T, 5, n_joints)
            One row per sample; of an effort the first counts.
        gains : ControllerParams
            Of this stretch.
        is_effort : bool
            Whether the reference is a torque; the controller then forgets its past.
        travel : ndarray, shape (n_joints,), optional
            End when a link has moved by more than this [rad].

        Returns
        -------
        Stretch

        """
        samples = len(reference)
        angles, torques = np.empty((samples, 4, self._n)), np.empty((samples, 2, self._n))
        travel = np.full(self._n, np.inf) if travel is None else np.asarray(travel, dtype=float)
        done = run_stretch(np.ascontiguousarray(reference), is_effort, travel, self.samples,
                           self._period, self._substeps, *self._plant, *self._encoders,
                           self._control, cascade.constants_of(gains, self._model),
                           self._control_work, angles, torques)
        if is_effort:
            self._control = cascade.init(self._model)
        self.samples += done
        return Stretch(angles[:done], torques[:done, 0], torques[:done, 1])
