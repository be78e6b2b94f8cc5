# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The plant one sample at a time, as a node runs it."""

from gms_flex_control.compiled import compiled
from gms_flex_control.effects import signals as sig
from gms_flex_control.records import boxed, views
from gms_flex_control.simulation import closed_loop, encoder, plant
import numpy as np


@compiled
def _advance(state, command, time, period, substeps, constants, work):
    """Advance a plant by one sample; records come boxed, as Python hands them over fast."""
    plant.advance(state[0], command, time, period, substeps, constants[0], work[0])


@compiled
def _sense(measured, state, time, period, constants, encoders, work):
    """Read the encoders; records come boxed."""
    closed_loop.sense(measured[0], state[0], time, period, constants[0], encoders[0], work[0])


class SteppedPlant:
    """
    A simulated robot that is advanced sample by sample.

    ``period`` is the sample [s], with ``substeps`` of integration; ``seed`` is of the encoder
    noise; the links rest at ``q_link`` (n_joints,) at first [rad]. ``supply[:]`` is the voltage of
    its drives [V], 0 where it is not known, as at first.
    """

    def __init__(self, robot, *, period, substeps, seed=0, q_link=None):
        self._period, self._substeps, self._ticks = period, substeps, 0
        self._constants = boxed(plant.constants_of(robot))
        self._encoders = boxed(encoder.constants_of(robot.encoder))
        self._work = boxed(plant.workspace(robot.n_joints))
        self._state = boxed(plant.init(robot, q_link))
        self._measured = boxed(encoder.init(robot.n_joints))
        self._noisy, self._rng = bool(robot.encoder.noise > 0), np.random.default_rng(seed)
        self.state, self.measured = self._state[0], views(self._measured[0])
        self.supply = self._work[0].signals[:, sig.SUPPLY]
        self.applied = self.state.applied  # torque given over the last sample (n_joints,) [N m]

    def measure(self) -> None:
        """Read the encoders into ``measured``."""
        if self._noisy:
            self._rng.standard_normal(out=self.measured.normal)
        _sense(self._measured, self._state, self._ticks * self._period, self._period,
               self._constants, self._encoders, self._work)

    def advance(self, command) -> None:
        """Hold ``command`` (n_joints,) [N m] for one sample, then read the encoders."""
        _advance(self._state, command, self._ticks * self._period, self._period, self._substeps,
                 self._constants, self._work)
        self._ticks += 1
        self.measure()
