# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What an experiment sees of the robot: time, place, and whether a limit was passed."""

from gms_flex_control.nodes import messages, refusal
from gms_flex_control.nodes.messages import NANOSECONDS
import numpy as np

_WINDOW = 50_000_000   # over which speed is measured [ns]
_OVERSPEED = 1.25      # of the limit that steps are planned for


class Watch:
    """
    Follow the joint states.

    Parameters
    ----------
    plan : IdentificationPlan
        Names the joints and their limits.

    Attributes
    ----------
    stamp : int
        Of the last joint state [ns].
    samples : int
        Joint states so far.
    q_link : ndarray, shape (n_joints,)
        Where the links are [rad]; NaN before the first state.
    fault : str or None
        The sentence about the first limit that was passed; limits count once `guard` was called.

    """

    def __init__(self, plan):
        self._plan = plan
        self.stamp, self.samples, self.fault = 0, 0, None
        self.q_link = np.full(len(plan.joints), np.nan)
        self._first = self._window = self._names = self._order = None
        self._guarded, self._origin = False, None

    @property
    def period(self):
        """Return the mean sample [s]."""
        return max(self.stamp - self._first, 1) / (NANOSECONDS * max(self.samples - 1, 1))

    def guard(self, on):
        """Watch the limits from now on, or no longer."""
        self._guarded = on

    def mark(self):
        """Measure travel from here."""
        self._origin = self.q_link.copy()

    def travel(self, j):
        """Return how far link ``j`` has moved since `mark` [rad]."""
        return float(abs(self.q_link[j] - self._origin[j]))

    def take(self, message):
        """Read a JointState; raises RefusedError if it lacks a joint or a finite angle."""
        if message.name != self._names:
            missing = [name for name in self._plan.joints if name not in message.name]
            if missing:
                raise messages.RefusedError(f'lacks {missing[0]!r}')
            self._names = list(message.name)
            self._order = [message.name.index(name) for name in self._plan.joints]
        position = message.position
        if len(position) != len(self._names):
            raise messages.RefusedError(f'{len(self._names)} names, {len(position)} positions')
        q_link = [position[index] for index in self._order]
        if not refusal.all_finite(q_link):
            raise messages.RefusedError(f'positions {q_link}')
        stamp = messages.to_nanoseconds(message.header.stamp)
        if self._first is None:
            self._first = stamp
        if stamp <= self.stamp and self.samples:
            return  # sent again
        self.q_link[:] = q_link
        self.stamp, self.samples = stamp, self.samples + 1
        self._judge(q_link)

    def _judge(self, q_link):
        if self._window is None or self.stamp - self._window[0] > 10 * _WINDOW:
            self._window = (self.stamp, list(q_link))
        if not self._guarded or self.fault is not None:
            return
        plan = self._plan
        for j, joint in enumerate(plan.joints):
            if not plan.lower[j] <= q_link[j] <= plan.upper[j]:
                self.fault = (f'{joint} is at {q_link[j]:.4g} rad, outside its range '
                              f'{plan.lower[j]:g} to {plan.upper[j]:g} rad: zero torque')
        elapsed = self.stamp - self._window[0]
        if elapsed < _WINDOW:
            return
        for j, joint in enumerate(plan.joints):
            speed = abs(q_link[j] - self._window[1][j]) * NANOSECONDS / elapsed
            if speed > _OVERSPEED * plan.velocity[j]:
                self.fault = (f'{joint} moves at {speed:.3g} rad/s, the limit is '
                              f'{plan.velocity[j]:g} rad/s: zero torque')
        self._window = (self.stamp, list(q_link))
