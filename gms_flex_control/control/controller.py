# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The cascade law with its friction compensation, one joint state at a time, as a node runs it."""

from gms_flex_control.compiled import compiled
from gms_flex_control.control import cascade, feedforward
from gms_flex_control.records import boxed, views
import numpy as np


@compiled
def tick(state, measured, reference, dt, constants, work, feeding, fed) -> None:
    """Tick the controller and feed effects forward; records come boxed."""
    cascade.tick(state[0], measured[0], reference, dt, constants[0], work[0])
    feedforward.feed(state[0], measured[0], reference, dt, feeding[0], fed[0])


class SteppedController:
    """
    The cascade controller, tick by tick, with gains that may change in between.

    ``gains`` are ControllerParams of the start, ``model`` the RobotParams as believed; effects
    that no controller can compensate are left aside.
    """

    def __init__(self, gains, model):
        self._model = feedforward.as_parameters(model)
        self._work = boxed(cascade.workspace(model.n_joints))
        self._measured = boxed(cascade.measurement(model.n_joints))
        self.measured = views(self._measured[0])
        self.use(gains)
        self.reset()

    def use(self, gains) -> None:
        """Use other ControllerParams from the next tick on."""
        self._limit = gains.torque_limit
        self._constants = boxed(cascade.constants_of(gains, self._model))
        self._feeding = boxed(feedforward.constants_of(gains, self._model))

    def reset(self) -> None:
        """Forget the motion so far: observer and filters begin anew."""
        self._state = boxed(cascade.init(self._model))
        self._fed = boxed(feedforward.init(self._model.n_joints))
        self.state = views(self._state[0])
        self._command = self.state.command

    @property
    def boxes(self) -> tuple:
        """Return state, measurement, constants and work space, as `tick` takes them boxed."""
        return (self._state, self._measured, self._constants, self._work, self._feeding,
                self._fed)

    def pass_on(self, torque) -> np.ndarray:
        """Begin anew, and answer with a torque that is asked for, within limits (n_joints,)."""
        self.reset()
        self._command[:] = np.clip(torque, -self._limit, self._limit)
        return self._command

    def tick(self, reference, dt) -> np.ndarray:
        """Answer ``measured`` with a torque (n_joints,) [N m]; see control.cascade.tick."""
        tick(self._state, self._measured, reference, dt, self._constants, self._work,
             self._feeding, self._fed)
        return self._command
