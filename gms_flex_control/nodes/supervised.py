# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What simulated and bridged robots do alike when torque is let flow or taken away."""

from abc import ABC, abstractmethod

from gms_flex_control.hardware.supervisor import Outcome, ZERO


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
