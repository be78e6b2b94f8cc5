# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Whether torque may flow, and the watches that may take it away: sources, silence, lateness."""

from abc import ABC, abstractmethod
from typing import NamedTuple

ZERO, ACTIVE, FAULT = 'ZERO', 'ACTIVE', 'FAULT'
STOOD_STILL = 0.05     # of the bridge, upon which its guardian sends zero efforts [s]
NOTABLE = 0.1          # share of late samples from which on an arm is not what its gains make it
LATE = ('the controller is late, and the arm does not move as its gains would have it; run fewer '
        'programs, set realtime_priority, lower the rate')
# on /diagnostics, of a simulated robot and of a bridge: samples, those without a command in time,
# and those that never were because the machine was too busy
SIMULATED = 'samples', 'samples without a fresh command', 'samples left out'
BRIDGED = 'states out', 'states without a fresh command', ''
UNNAMED = 'somebody without a source label'
_RECENT = 1.0          # over which lateness is counted [s]
_WINDOW = 50_000_000   # a source that was heard within this is still there [ns]


class Outcome(NamedTuple):
    """Answer to a request."""

    success: bool
    message: str


class Supervisor:
    """
    State machine of everything that may be given torque.

    ZERO --enable--> ACTIVE --disable--> ZERO; a fault leads from ACTIVE to FAULT, an emergency
    stop from anywhere. Only `reset` leads out of FAULT, to ZERO.
    """

    def __init__(self, reason='not enabled yet'):
        self.state, self.reason = ZERO, reason
        self.stopped, self.faults = False, 0   # whether by an emergency stop; how many so far
        self.refusals = 0   # of torque, whatever the state was: who waits to enable it counts them
        self._pressed = False

    @property
    def active(self) -> bool:
        """Return whether torque may flow."""
        return self.state == ACTIVE

    def enable(self, obstacle='') -> Outcome:
        """Go from ZERO to ACTIVE, unless ``obstacle`` says what stands against it."""
        if self.state == ACTIVE:
            return Outcome(True, 'ACTIVE already')
        if self.state == FAULT:
            return Outcome(False, f'FAULT: {self.reason}; reset first')
        if obstacle:
            return Outcome(False, f'not enabled: {obstacle}')
        self.state, self.reason = ACTIVE, 'enabled'
        return Outcome(True, 'ACTIVE')

    def disable(self, reason='disabled') -> Outcome:
        """Go from ACTIVE to ZERO; a fault stays one."""
        self.refusals += 1
        if self.state == FAULT:
            return Outcome(True, f'no torque: FAULT, {self.reason}')
        self.state, self.reason = ZERO, reason
        return Outcome(True, 'ZERO')

    def trip(self, reason) -> bool:
        """Go from ACTIVE to FAULT; the first reason stays. Return whether it did."""
        self.refusals += 1
        if self.state != ACTIVE:
            return False
        self.state, self.reason = FAULT, reason
        self.faults += 1
        return True

    def stop(self, reason) -> Outcome:
        """Emergency stop: to FAULT from any state, before any other reason."""
        self.refusals += 1
        if not self.stopped:
            self.faults += self.state != FAULT
            self.state, self.reason, self.stopped = FAULT, reason, True
        return Outcome(True, f'FAULT: {self.reason}')

    def button(self, pressed, name) -> None:
        """Take the position of the emergency-stop button called ``name``."""
        self._pressed = pressed
        if pressed:
            self.stop(f'emergency stop by {name}')

    def reset(self) -> Outcome:
        """Go from FAULT to ZERO, unless the emergency-stop button is still pressed."""
        self.refusals += 1
        if self._pressed:
            return Outcome(False, f'FAULT: {self.reason}; release the button first')
        if self.state == FAULT:
            self.state, self.reason, self.stopped = ZERO, 'reset, not enabled yet', False
        return Outcome(True, f'{self.state}: {self.reason}')

    def amend(self, reason) -> None:
        """Say more about the fault there is."""
        if self.state == FAULT and not self.stopped:
            self.reason = reason


class SupervisedRobot(ABC):
    """A robot under a ``_supervisor``, with a reentrant ``_lock``: any thread may ask of it."""

    @abstractmethod
    def _settle(self):
        """Say and do what a change of the supervisor's state asks for."""

    @property
    def refusals(self) -> int:
        """Return how often torque was taken away so far, see Supervisor."""
        return self._supervisor.refusals

    @property
    def at_zero(self) -> bool:
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

    def stop(self, reason) -> Outcome:
        """Stop in an emergency; return an Outcome."""
        with self._lock:
            return self._settled(self._supervisor.stop(reason))

    def button(self, pressed, name) -> None:
        """Take the position of the emergency-stop button."""
        with self._lock:
            self._supervisor.button(pressed, name)
            self._settle()


class SourceWatch:
    """Report two who send at once; ``what`` they do, such as 'controllers command'."""

    def __init__(self, what):
        self._what, self._heard, self._conflict = what, {}, ''

    def hear(self, source, now) -> str:
        """
        Note that ``source``, '' if it has no label, sends at ``now`` [ns], acted on or not.

        Return a sentence that names both if another one sends as well; else ''.
        """
        self._heard[source] = now
        self._conflict = ''
        if len(self._heard) > 1:
            self._forget(now)
        if len(self._heard) > 1:
            names = sorted(name or UNNAMED for name in self._heard)
            self._conflict = f"{len(names)} {self._what} at once: {' and '.join(names[:4])}"
        return self._conflict

    def _forget(self, now):
        self._heard = {name: time for name, time in self._heard.items() if now - time <= _WINDOW}

    def conflict(self, now) -> str:
        """Return what `hear` did last; '' once nobody sends any more."""
        if self._conflict:
            self._forget(now)
            if not self._heard:
                self._conflict = ''
        return self._conflict


class CommandWatch:
    """Report two commanding controllers, and the silence of one."""

    def __init__(self):
        self._sources = SourceWatch('controllers command')
        self.last, self.source = None, ''   # when a command was acted on [ns], and whose it was

    def hear(self, source, now) -> str:
        """Note that somebody commands, acted on or not; see `SourceWatch.hear`."""
        return self._sources.hear(source, now)

    def take(self, source, now) -> None:
        """Note that a command is acted on."""
        self.last, self.source = now, source

    def silence(self, now) -> int | None:
        """Return how long nobody has commanded [ns]; None if nobody ever did."""
        return None if self.last is None else now - self.last

    @property
    def name(self) -> str:
        """Return who commanded last."""
        return self.source or UNNAMED

    def figures(self, now) -> dict:
        """Return what to report of the controller."""
        silence = self.silence(now)
        return {'controller': 'none yet' if silence is None else self.name,
                'silence of the controller [ms]': round((silence or 0) / 1e6, 1)}


def recently(share, now, elapsed) -> float:
    """Return the share of recent time something took, after ``elapsed`` [s] with it or without."""
    return share + (now - share) * min(elapsed / _RECENT, 1.0)


class Lateness:
    """The share of recent states whose command had not come when the next one did."""

    def __init__(self):
        self.share = 0.0

    def restart(self) -> None:
        """Begin anew, as where no command is to be expected."""
        self.share = 0.0

    def note(self, missed, elapsed) -> None:
        """Note whether the command of a state was ``missed``, ``elapsed`` [s] after it."""
        self.share = recently(self.share, missed, elapsed)

    def __str__(self):
        return f'{self.share:.0%} of the states of the last second had no fresh command'
