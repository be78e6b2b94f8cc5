# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which reference a joint state is answered with: received, carried on, held, let go."""

from typing import NamedTuple

from gms_flex_control.nodes.messages import EFFORT, NANOSECONDS
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.segments import extrapolate
import numpy as np

_KEPT = 4
_BRAKE_TIME = 0.5  # from a lost reference to rest [s]
_AVERAGE = 0.1     # time constant of the torque that is let down [s]
# A reference nearer to the robot is followed at once: the law's step is then small.
_NEAR, _NEAR_SPEED = 0.01, 0.2  # [rad], [rad/s]
_FADE = round(0.1 * NANOSECONDS)  # in which the torque rises where a motion begins
_RISE = 0.1        # the most it rises in one sample, of all: a loop may stall as it begins
FOLLOWING, HOLDING, RELAXING = 'following', 'holding', 'relaxing'


class Reference(NamedTuple):
    """One reference as received or made up."""

    quantity: str        # 'motion' or 'effort'
    value: np.ndarray    # (5, n) or (1, n)


class References:
    """
    References by the stamp of the joint state they are for.

    A motion whose references stop coming is brought to rest and held; then the torque of the
    hold is let down to zero without feedback.

    Parameters
    ----------
    timeout : float
        Age of a reference that is still followed [s].
    hold, relax : float
        How long a lost one is held, and how long the torque then takes to zero [s].

    Attributes
    ----------
    phase : str or None
        FOLLOWING, HOLDING or RELAXING; None where there is nothing to follow.

    """

    def __init__(self, timeout, hold, relax):
        self._timeout = round(NANOSECONDS * timeout)
        self._hold, self._relax = hold, relax
        self._kept = {}
        self.phase = None
        self._last = None     # (stamp, Reference) followed last
        self._rest = None     # (stamp, Trajectory) of the way to rest
        self._torque = None   # mean of the last commands

    def keep(self, stamp, reference, last=None):
        """
        Take a Reference for the joint state of ``stamp`` [ns].

        Of too many the one farthest from the ``last`` state goes: those of other times take no
        place of those that are followed. Without a last state, the oldest goes.
        """
        self._kept.pop(stamp, None)
        self._kept[stamp] = reference
        if len(self._kept) > _KEPT:
            del self._kept[next(iter(self._kept)) if last is None else
                           max(self._kept, key=lambda known: abs(known - last))]

    def has(self, stamp):
        """Return whether there is one for exactly this joint state."""
        return stamp in self._kept

    def forget(self):
        """Follow nothing that has been received."""
        self._kept.clear()
        self.forget_motion()

    def forget_motion(self):
        """Hold nothing from before: the robot is elsewhere, or its clock is."""
        self.phase = self._last = self._rest = self._torque = None

    def is_fresh(self, stamp, now):
        """Return whether one for ``stamp`` would be followed by the state of ``now`` [ns]."""
        return abs(stamp - now) <= self._timeout

    def nearest(self, stamp):
        """Return how far the nearest stamp is [s]; None without any reference."""
        return min((abs(known - stamp) for known in self._kept), default=None)

    def at(self, stamp):
        """Return the Reference for a joint state, moved to its time; None if there is none."""
        received = self._received(stamp)
        if received is not None:
            self.phase, self._last, self._rest = FOLLOWING, (stamp, received), None
            return received
        lost = self._lost(stamp)
        if lost is None:
            self.forget_motion()
        return lost

    def _received(self, stamp):
        reference = self._kept.get(stamp)
        if reference is not None or not self._kept:
            return reference
        nearest = min(self._kept, key=lambda known: abs(known - stamp))
        if abs(stamp - nearest) > self._timeout:
            return None
        reference = self._kept[nearest]
        if reference.quantity == EFFORT:
            return reference
        return Reference(reference.quantity,
                         extrapolate(reference.value, (stamp - nearest) / NANOSECONDS))

    def _lost(self, stamp):
        """Return what a motion that stopped coming is replaced by."""
        if self._last is None or self._last[1].quantity == EFFORT:
            return None
        if self._rest is None:
            state = self._last[1].value
            goal = state[0] + 0.5 * _BRAKE_TIME * state[1]
            self._rest = (self._last[0], builders.approach(
                state, builders.hold(goal), 0.0, duration=_BRAKE_TIME))
        since = (stamp - self._rest[0]) / NANOSECONDS
        if since < self._hold:
            self.phase = HOLDING
            return Reference('motion', self._rest[1].sample(since))
        if since - self._hold < self._relax and self._torque is not None:
            self.phase = RELAXING
            left = 1.0 - (since - self._hold) / self._relax
            return Reference(EFFORT, left * self._torque[None, :])
        return None

    def answered(self, torque, elapsed):
        """Note the command (n,) [N m] that the law gave, ``elapsed`` [s] after the one before."""
        if self.phase != HOLDING or self._torque is None:
            self._torque = np.array(torque)
        else:
            self._torque += min(1.0, elapsed / _AVERAGE) * (torque - self._torque)


class Handover:
    """
    The way from the robot's motion to a reference that is elsewhere, and from no torque to it.

    Parameters
    ----------
    duration : float
        How long it takes [s].

    Attributes
    ----------
    left : ndarray, shape (5, n_joints), or None
        What was added to the reference last; None where the handover is over.

    """

    def __init__(self, duration):
        self._duration = duration
        self._way = self.left = None
        self._share, self._seen = 1.0, 0  # of the torque that is given, and stamp it was given at

    def begin(self, stamp, measured, reference):
        """Begin at the joint state of ``stamp`` [ns]; nothing if ``reference`` (5, n) is near."""
        self._way = self.left = None
        self._share, self._seen = 0.0, stamp
        offset = -reference
        offset[0] += measured.q_link
        offset[1] += measured.dq_link
        if (np.abs(offset[0]).max() > _NEAR or np.abs(offset[1]).max() > _NEAR_SPEED):
            self._way = (stamp, builders.approach(
                offset, builders.hold(np.zeros(offset.shape[1])), 0.0, duration=self._duration))

    def applied(self, stamp, reference):
        """Return ``reference`` (5, n) with what is left of the way added."""
        if self._way is None:
            return reference
        since = (stamp - self._way[0]) / NANOSECONDS
        if since >= self._duration:
            self._way = self.left = None
            return reference
        self.left = self._way[1].sample(since)
        return reference + self.left

    def fade(self, stamp, torque):
        """Let ``torque`` (n,) rise from zero where the motion has just begun; in place."""
        if self._share < 1.0:
            self._share += min((stamp - self._seen) / _FADE, _RISE)
            self._seen = stamp
            torque *= min(self._share, 1.0)
