# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The bridge itself: states in, judged; commands out, limited; every fault ends in zero."""

from collections import Counter
from dataclasses import dataclass
from types import SimpleNamespace

from gms_flex_control.errors import ParameterError
from gms_flex_control.hardware import limits as limiting
from gms_flex_control.hardware.command_watch import CommandWatch
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.hardware.mapping import JointMap
from gms_flex_control.hardware.merger import NANOSECONDS, StateMerger
from gms_flex_control.hardware.supervisor import STOOD_STILL, Supervisor
import numpy as np

_KEPT_STATES = 64          # published states that a command may answer
_NO_COMMAND = 'no command from'
_LONGEST_RAMP = 0.05       # a torque never rises for longer than that at once [s]
_RECENT, _OFTEN = 1.0, 0.2  # time [s] and share of it in which a torque that comes late is told


@dataclass(frozen=True, kw_only=True)
class BridgeParams:
    """
    What a bridge needs to know.

    Parameters
    ----------
    joint_map : JointMap
        Names and units.
    limits : Limits
        Of every joint.
    sources : tuple of str
        Where joint states come from, for messages.
    state_timeout, silence_timeout : float
        Silence of the robot and of the controller that is a fault [s].
    velocity_cutoff : float
        See StateMerger [Hz].
    skew : float
        See StateMerger [s].
    guarded : bool
        Whether a guardian sends zero while the bridge stands still.

    """

    joint_map: JointMap
    limits: Limits
    sources: tuple
    state_timeout: float = 0.03
    silence_timeout: float = 0.035
    velocity_cutoff: float = 50.0
    skew: float = 0.01
    guarded: bool = False

    def __post_init__(self):
        missing = self.limits.missing()
        if missing:
            raise ParameterError(f'limits: {missing[0]} is missing for some joint; a real robot '
                                 'needs torque, torque_rate, velocity, lower and upper of all')


class Bridge:
    """
    One robot between its joint states and its efforts.

    All times are integer nanoseconds of one steady clock. Not safe against threads: hold a lock.

    Parameters
    ----------
    params : BridgeParams
        What it is.

    Attributes
    ----------
    supervisor : Supervisor
        Whether torque flows.
    torque : ndarray, shape (n_joints,)
        Given to the robot last [N m].
    measured : SimpleNamespace
        ``q_link``, ``dq_link``, ``q_motor``, ``dq_motor`` (n_joints,) of the last state.
    applied : ndarray, shape (n_joints,)
        Torque of the last sample, as measured, else as given [N m].
    stamp : int
        Of the last state.
    counters : Counter
        Of what came, went and was refused.
    worst : dict of str to int
        Largest ages and answer times so far [ns].
    late : float
        Share of recent states (about a second) whose command had not come when the next one did.

    """

    def __init__(self, params):
        self.params = params
        n = len(params.joint_map.joints)
        self.supervisor = Supervisor()
        self.merger = StateMerger(params.joint_map, params.sources,
                                  cutoff=params.velocity_cutoff, skew=params.skew)
        self.watch_commands = CommandWatch()
        self.torque, self.applied = np.zeros(n), np.zeros(n)
        self.measured = SimpleNamespace(**{name: np.zeros(n) for name in (
            'q_link', 'dq_link', 'q_motor', 'dq_motor')})
        self.stamp, self.counters = 0, Counter()
        self.worst = {'state_age': 0, 'answer': 0}
        self._published = {}       # stamp -> when the state was published
        self._arrived = None       # when the last state came
        self._watched = np.inf     # when the bridge last looked after both sides; not yet
        self._enabled = 0          # stamp of the state at which torque was enabled
        self._given = 0            # when torque was given last
        self._held_back = np.zeros(n)  # share of recent time in which the rate held a torque back
        self._answered = None      # stamp of the newest state a command answered
        self.late = 0.0
        self._violation = ''
        self._refused_state = self._refused_command = ''
        self._silent_for = ''      # the fault of a silent controller, while it lasts

    # states --------------------------------------------------------------------------------

    def take_state(self, source, names, position, velocity, effort, stamp, now):
        """
        Take one message of joint states.

        Returns
        -------
        bool
            Whether ``measured``, ``applied`` and ``stamp`` are a new state to be published.

        Raises
        ------
        ReadingError
            As `StateMerger.take`.

        """
        self.counters['states in'] += 1
        if not self.merger.take(source, names, position, velocity, effort, stamp, now):
            return False
        joint_map, measured = self.params.joint_map, self.measured
        before = measured.q_link, measured.q_motor
        elapsed = (self.merger.time - self.stamp) / NANOSECONDS
        measured.q_link, measured.q_motor = joint_map.sides(self.merger.position.copy())
        measured.dq_link, measured.dq_motor = joint_map.sides(self.merger.velocity.copy())
        self.applied = joint_map.torques(self.merger.effort, self.torque)
        self.worst['state_age'] = max(self.worst['state_age'], now - self.merger.time)
        self._note_late(elapsed)
        self._violation = limiting.violation(joint_map.joints, measured, self.params.limits)
        if not self._violation and self.stamp:
            self._violation = limiting.jump(joint_map.joints, measured, before, elapsed,
                                            self.params.limits)
        if self._violation:
            self.fault(self._violation + self._of_late_torque())
        self.stamp, self._arrived, self._refused_state = self.merger.time, now, ''
        self.counters['states out'] += 1
        self._published[self.stamp] = now
        if len(self._published) > _KEPT_STATES:
            del self._published[next(iter(self._published))]
        return True

    def _note_late(self, elapsed):
        """Note whether the state that another follows now was answered; `stamp` is still its."""
        if not self.supervisor.active or self._answered is None:  # plain commands answer no state
            self.late = 0.0
            return
        missed = self._answered < self.stamp
        self.counters['states without a fresh command'] += missed
        self.late = _recently(self.late, missed, elapsed)

    def lateness(self):
        """Return in words how many states had no command in time (str)."""
        return f'{self.late:.0%} of the states of the last second had no fresh command'

    def refuse_state(self, sentence):
        """Note that joint states were refused, for the sentence of a fault."""
        self.counters['states refused'] += 1
        self._refused_state = sentence

    # commands ------------------------------------------------------------------------------

    def take_command(self, command, stamp, source, now):
        """
        Take one command.

        Parameters
        ----------
        command : array_like, shape (n_joints,)
            Finite torques [N m].
        stamp : int or None
            Of the state it answers.
        source : str
            Who commands.
        now : int
            Time.

        Returns
        -------
        bool
            Whether ``torque`` is to be sent to the robot.

        """
        self.counters['commands in'] += 1
        if self.watch(now):  # the process stood still: a command that waited ends no silence
            return True
        conflict = self.watch_commands.hear(source, now)
        if conflict:
            return self.fault(conflict)
        if not self._is_fresh(stamp, now):
            self.counters['commands stale'] += 1
            return False
        self._answered = stamp
        self._end_silence(now)
        self.watch_commands.take(source, now)
        self._refused_command = ''
        if not self.supervisor.active or (stamp is not None and stamp <= self._enabled):
            return False
        elapsed = min((now - self._given) / NANOSECONDS, _LONGEST_RAMP)
        command, limits = np.array(command, dtype=float), self.params.limits
        self._note_held_back(limiting.held_back(command, self.torque, elapsed, limits), elapsed)
        self.torque = limiting.limited(command, self.torque, elapsed, self.measured.q_link,
                                       self.measured.dq_link, limits)
        self._given = now
        self.counters['commands acted on'] += 1
        return True

    def _note_held_back(self, held, elapsed):
        self._held_back = _recently(self._held_back, held, elapsed)
        self.counters['commands held back by torque_rate'] += int(held.any())

    def _of_late_torque(self):
        """Return what a fault of the motion adds where torque often came late; '' else."""
        if not self.supervisor.active:
            return ''
        if self.late >= _OFTEN:
            return f'; {self.lateness()}: the controller is late'
        j = int(np.argmax(self._held_back))
        if self._held_back[j] < _OFTEN:
            return ''
        return (f'; torque_rate ({self.params.limits.torque_rate[j]:.4g} N m/s) held back the '
                f'torque of {self.params.joint_map.joints[j]} for {self._held_back[j]:.0%} of the '
                'last second: raise it, or take gentler gains')

    def _is_fresh(self, stamp, now):
        if stamp is None:
            return True
        published = self._published.get(stamp)
        if published is None or now - published > self.params.silence_timeout * NANOSECONDS:
            return False
        self.worst['answer'] = max(self.worst['answer'], now - published)
        return True

    def refuse_command(self, sentence):
        """Note that a command was refused, for the sentence of a fault."""
        self.counters['commands refused'] += 1
        self._refused_command = sentence

    # faults --------------------------------------------------------------------------------

    def fault(self, sentence):
        """Take all torque away; return whether zero is to be sent at once."""
        if not self.supervisor.trip(sentence):
            return False
        self.torque = np.zeros_like(self.torque)
        return True

    def take_torque_away(self):
        """Forget the torque given; what the supervisor is told beside this says why."""
        self.torque = np.zeros_like(self.torque)

    def watch(self, now):
        """
        Look whether robot and controller still speak; call it every millisecond or two.

        Returns
        -------
        bool
            Whether a fault has begun: zero is to be sent at once.

        """
        stood, self._watched = now - self._watched, now
        if not self.supervisor.active:
            return False
        if self.params.guarded and stood > STOOD_STILL * NANOSECONDS:  # torque went to zero
            return self.fault(f'the bridge stood still for {stood / 1e6:.0f} ms')
        sentence = self._silent_robot(now) or self._silent_controller(now)
        self._silent_for = sentence if sentence.startswith(_NO_COMMAND) else ''
        return bool(sentence) and self.fault(sentence)

    def looked(self, now):
        """Return how long ago it was looked after both sides [ns]."""
        return now - self._watched

    def _silent_robot(self, now):
        if self._arrived is None:
            return f"no joint states from {', '.join(self.params.sources)} yet"
        if now - self._arrived <= self.params.state_timeout * NANOSECONDS:
            return ''
        return self._about_robot(now)

    def _about_robot(self, now):
        sentence = f'no new joint states for {(now - self._arrived) / 1e6:.0f} ms'
        absent = self.merger.absent()
        if self._refused_state:
            return f'{sentence}: {self._refused_state}'
        if len(absent) < len(self.params.joint_map.names):
            return f"{sentence}: nothing of {', '.join(absent) or 'all at one time'}"
        return sentence

    def _silent_controller(self, now):
        spoken = max(self.watch_commands.last or 0, self._given)
        if now - spoken <= self.params.silence_timeout * NANOSECONDS:
            return ''
        if now - self._arrived > 0.5 * (now - spoken):  # nothing to be answered
            return self._about_robot(now)
        said = f'; refused last: {self._refused_command}' if self._refused_command else ''
        return (f'{_NO_COMMAND} {self.watch_commands.name} for '
                f'{(now - spoken) / 1e6:.0f} ms{said}')

    def _end_silence(self, now):
        """Say how long the silence was that was the fault, once it is over."""
        if self._silent_for and self.supervisor.reason == self._silent_for:
            silence = self.watch_commands.silence(now)
            self.supervisor.amend(f'{_NO_COMMAND} {self.watch_commands.name} for '
                                  f'{(silence or 0) / 1e6:.0f} ms; they come again')
        self._silent_for = ''

    # requests ------------------------------------------------------------------------------

    def obstacle(self, now):
        """Return what stands against torque now (str); '' if nothing does."""
        sentence = self._silent_robot(now) or self._violation
        if sentence:
            return sentence
        silence = self.watch_commands.silence(now)
        if silence is None:
            return 'no controller commands yet'
        if silence > self.params.silence_timeout * NANOSECONDS:
            return f'{_NO_COMMAND} {self.watch_commands.name} for {silence / 1e6:.0f} ms'
        return ''

    def enable(self, now):
        """Let torque flow, from zero on and for states from now on; return an Outcome."""
        if self.supervisor.active:  # and goes on as it does: nothing begins anew
            return self.supervisor.enable()
        outcome = self.supervisor.enable(self.obstacle(now))
        if outcome.success:
            self.torque = np.zeros_like(self.torque)
            self._held_back = np.zeros_like(self.torque)
            self._enabled, self._given = self.stamp, now
        return outcome


def _recently(share, now, elapsed):
    """Return the share of recent time something took, after ``elapsed`` [s] with it or without."""
    return share + (now - share) * min(elapsed / _RECENT, 1.0)
