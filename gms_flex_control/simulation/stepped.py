# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Plant, controller and reference one sample at a time, as the nodes run them."""

from gms_flex_control.control import cascade
from gms_flex_control.simulation import closed_loop, encoder, plant
import numpy as np


class SteppedPlant:
    """
    A simulated robot that is advanced sample by sample.

    Parameters
    ----------
    robot : RobotParams
        The robot.
    period : float
        Sample [s].
    substeps : int
        Integration steps in it.
    seed : int
        Of the encoder noise.
    q_link : array_like, shape (n_joints,), optional
        Where the links rest at the start [rad].

    """

    def __init__(self, robot, *, period, substeps, seed=0, q_link=None):
        self._period, self._substeps, self._ticks = period, substeps, 0
        self._constants = plant.constants_of(robot)
        self._encoders = encoder.constants_of(robot.encoder)
        self._work = plant.workspace(robot.n_joints)
        self._rng = np.random.default_rng(seed)
        self.state = plant.init(robot, q_link)
        self.measured = encoder.init(robot.n_joints)

    @property
    def applied(self):
        """Return the torque really applied over the last sample (n_joints,) [N m]."""
        return self.state.applied

    def measure(self):
        """Read the encoders into ``measured``."""
        closed_loop.sense(self.measured, self.state, self._ticks * self._period, self._period,
                          self._constants, self._encoders, self._work, self._rng)

    def advance(self, command):
        """Hold ``command`` (n_joints,) [N m] for one sample, then read the encoders."""
        plant.advance(self.state, command, self._ticks * self._period, self._period,
                      self._substeps, self._constants, self._work)
        self._ticks += 1
        self.measure()


class SteppedController:
    """
    The cascade controller, tick by tick, with gains that may change in between.

    Parameters
    ----------
    gains : ControllerParams
        Of the start.
    model : RobotParams
        The robot as believed.

    """

    def __init__(self, gains, model):
        self._model = model
        self._work = cascade.workspace(model.n_joints)
        self.measured = encoder.init(model.n_joints)
        self.use(gains)
        self.reset()

    def use(self, gains):
        """Take other gains from the next tick on."""
        self._constants = cascade.constants_of(gains, self._model)

    def reset(self):
        """Forget the motion so far: observer and filters begin anew."""
        self.state = cascade.init(self._model)

    def tick(self, reference, dt):
        """Answer ``measured`` with a torque (n_joints,) [N m]; see control.cascade.tick."""
        cascade.tick(self.state, self.measured, reference, dt, self._constants, self._work)
        return self.state.command
