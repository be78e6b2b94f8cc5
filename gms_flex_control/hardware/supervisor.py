# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Whether torque may flow: ZERO, ACTIVE or FAULT, and why."""

from abc import ABC, abstractmethod
from typing import NamedTuple

ZERO, ACTIVE, FAULT = 'ZERO', 'ACTIVE', 'FAULT'
STOOD_STILL = 0.05  # of the bridge, upon which its guardian sends zero efforts [s]


class Outcome(NamedTuple):
    """Answer to a request."""

    success: bool
    message: str


class Supervisor:
    """
    State machine of everything that may be given torque.

    ZERO --enable--> ACTIVE --disable--> ZERO; a fault leads from ACTIVE to FAULT, an emergency
    stop from anywhere. Only `reset` leads out of FAULT, to ZERO.

    Attributes
    ----------
    state : {'ZERO', 'ACTIVE', 'FAULT'}
        Torque flows in ACTIVE only.
    reason : str
        Why it is so, in words.
    stopped : bool
        Whether the fault is an emergency stop.
    faults : int
        How many there have been.
    refusals : int
        How often torque was taken away or asked to be, whatever the state was: who waits to enable
        it sees by this that it is no longer wanted.

    """

    def __init__(self, reason='not enabled yet'):
        self.state, self.reason = ZERO, reason
        self.stopped, self.faults, self.refusals = False, 0, 0
        self._pressed = False

    @property
    def active(self):
        """Return whether torque may flow."""
        return self.state == ACTIVE

    def enable(self, obstacle=''):
        """
        Go from ZERO to ACTIVE.

        Parameters
        ----------
        obstacle : str
            A sentence on what stands against it; '' if nothing does.

        Returns
        -------
        Outcome

        """
        if self.state == ACTIVE:
            return Outcome(True, 'ACTIVE already')
        if self.state == FAULT:
            return Outcome(False, f'FAULT: {self.reason}; reset first')
        if obstacle:
            return Outcome(False, f'not enabled: {obstacle}')
        self.state, self.reason = ACTIVE, 'enabled'
        return Outcome(True, 'ACTIVE')

    def disable(self, reason='disabled'):
        """Go from ACTIVE to ZERO; a fault stays one."""
        self.refusals += 1
        if self.state == FAULT:
            return Outcome(True, f'no torque: FAULT, {self.reason}')
        self.state, self.reason = ZERO, reason
        return Outcome(True, 'ZERO')

    def trip(self, reason):
        """Go from ACTIVE to FAULT; the first reason stays. Return whether it did."""
        self.refusals += 1
        if self.state != ACTIVE:
            return False
        self.state, self.reason = FAULT, reason
        self.faults += 1
        return True

    def stop(self, reason):
        """Emergency stop: to FAULT from any state, before any other reason."""
        self.refusals += 1
        if not self.stopped:
            self.faults += self.state != FAULT
            self.state, self.reason, self.stopped = FAULT, reason, True
        return Outcome(True, f'FAULT: {self.reason}')

    def button(self, pressed, name):
        """Take the position of the emergency-stop button called ``name``."""
        self._pressed = pressed
        if pressed:
            self.stop(f'emergency stop by {name}')

    def reset(self):
        """Go from FAULT to ZERO, unless the emergency-stop button is still pressed."""
        self.refusals += 1
        if self._pressed:
            return Outcome(False, f'FAULT: {self.reason}; release the button first')
        if self.state == FAULT:
            self.state, self.reason, self.stopped = ZERO, 'reset, not enabled yet', False
        return Outcome(True, f'{self.state}: {self.reason}')

    def amend(self, reason):
        """Say more about the fault there is."""
        if self.state == FAULT and not self.stopped:
            self.reason = reason


class SupervisedRobot(ABC):
    """
    A robot whose torque a Supervisor lets flow; requests may come from any thread.

    Subclasses set ``_supervisor``, a Supervisor, and ``_lock``, a lock that one thread may take
    more than once.
    """

    @abstractmethod
    def _settle(self):
        """Say and do what a change of the supervisor's state asks for."""

    @property
    def refusals(self):
        """Return how often torque was taken away so far, see Supervisor."""
        return self._supervisor.refusals

    @property
    def at_zero(self):
        """Return whether the robot waits in ZERO to be enabled."""
        return self._supervisor.state == ZERO

    def _settled(self, outcome):
        self._settle()
        return outcome

    def _outdated(self, refusals):
        """Return the Outcome of a request to enable that began when there were ``refusals``."""
        if refusals in (None, self.refusals):
            return None
        return Outcome(False, 'not enabled: torque was withdrawn, or about to be, while this '
                              'request waited; call it again')

    def stop(self, reason):
        """Stop in an emergency; return an Outcome."""
        with self._lock:
            return self._settled(self._supervisor.stop(reason))

    def button(self, pressed, name):
        """Take the position of the emergency-stop button."""
        with self._lock:
            self._supervisor.button(pressed, name)
            self._settle()
