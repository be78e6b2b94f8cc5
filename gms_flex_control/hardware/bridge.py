# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The bridge itself: states in, judged; commands out, limited; every fault ends in zero."""

from collections import Counter
from dataclasses import dataclass
from types import SimpleNamespace

from gms_flex_control.errors import ParameterError
from gms_flex_control.hardware import limits as limiting
from gms_flex_control.hardware import supervision
from gms_flex_control.hardware.limits import Limits, NEEDED
from gms_flex_control.hardware.mapping import JointMap, NANOSECONDS, sort, StateMerger
import numpy as np

_KEPT_STATES = 64          # published states that a command may answer
_NO_COMMAND = 'no command from'
LONGEST_RAMP = 0.05       # a torque never rises for longer than that at once [s]
_OFTEN = 0.2               # share of recent time in which a torque that comes late is reported


@dataclass(frozen=True, kw_only=True)
class BridgeParams:
    """What a bridge needs to know."""

    joint_map: JointMap             # names and units
    limits: Limits                  # of every joint
    sources: tuple                  # where joint states come from, for messages
    state_timeout: float = 0.03     # silence of the robot that is a fault [s]
    silence_timeout: float = 0.035  # and of the controller [s]
    velocity_cutoff: float = 50.0   # see StateMerger [Hz]
    skew: float = 0.01              # see StateMerger [s]
    guarded: bool = False           # whether a guardian sends zero while the bridge stands still

    def __post_init__(self):
        missing = self.limits.missing(self.joint_map.joints)
        if missing:
            raise ParameterError(f'{missing} is missing: the bridge to a real robot needs '
                                 f'{", ".join(NEEDED)} of every joint')


class RobotSide:
    """What the robot measures: the last state, when it came, and what is wrong with it."""

    def __init__(self, params):
        n = len(params.joint_map.joints)
        self.merger = StateMerger(params.joint_map, params.sources,
                                  cutoff=params.velocity_cutoff, skew=params.skew)
        self.rows = np.zeros((4, n))  # of the last state, as `measured` names them
        self.measured = SimpleNamespace(**dict(zip(
            ('q_link', 'dq_link', 'q_motor', 'dq_motor'), self.rows, strict=True)))
        self.applied = np.zeros(n)  # torque of the last sample, as measured, else as given [N m]
        self.stamp = 0              # of the last state [ns]
        self.published = {}         # stamp -> when the state was published
        self.arrived = None         # when the last state came
        self.violation = self.refused = ''
        self.worst_age = 0          # of a state as it came [ns]

    def take(self, joint_map, given, now) -> float:
        """Take the state that the merger has completed; return the time since the last [s]."""
        merger = self.merger
        elapsed = (merger.time - self.stamp) / NANOSECONDS
        sort(merger.state, merger.effort, given, *joint_map.arrays[:3], self.rows, self.applied)
        self.worst_age = max(self.worst_age, now - merger.time)
        return elapsed

    def publish(self, now) -> None:
        """Note that the state is published."""
        self.stamp, self.arrived, self.refused = self.merger.time, now, ''
        self.published[self.stamp] = now
        if len(self.published) > _KEPT_STATES:
            del self.published[next(iter(self.published))]

    def silent(self, now, params) -> str:
        """Return a sentence if joint states have stopped coming; else ''."""
        if self.arrived is None:
            return f"no joint states from {', '.join(params.sources)} yet"
        if now - self.arrived <= params.state_timeout * NANOSECONDS:
            return ''
        return self.silence(now, params)

    def silence(self, now, params) -> str:
        """Return in words for how long nothing has come, and what is known of it."""
        sentence = f'no new joint states for {(now - self.arrived) / 1e6:.0f} ms'
        absent = self.merger.absent()
        if self.refused:
            return f'{sentence}: {self.refused}'
        if len(absent) < len(params.joint_map.names):
            return f"{sentence}: nothing of {', '.join(absent) or 'all at one time'}"
        return sentence


class ControllerSide:
    """What the controller is given and asks for: how much of it acts, and how late it is."""

    def __init__(self, params):
        self.watch = supervision.CommandWatch()
        self.torque = np.zeros(len(params.joint_map.joints))  # given to the robot last [N m]
        self.given = 0           # when that was [ns]
        self.answered = None     # stamp of the newest state a command answered
        self.held_back = [0.0] * len(self.torque)  # share of recent time, by the rate limit
        self.lateness = supervision.Lateness()
        self.refused = ''
        self.worst_answer = 0    # [ns]

    def silent(self, now, timeout) -> int:
        """Return for how long nobody has commanded if that is too long [ns]; else 0."""
        silence = now - max(self.watch.last or 0, self.given)
        return silence if silence > timeout * NANOSECONDS else 0

    def sentence(self, silence) -> str:
        """Return in words that nobody commands for ``silence`` [ns]."""
        return f'{_NO_COMMAND} {self.watch.name} for {silence / 1e6:.0f} ms'


class Bridge:
    """
    One robot between its joint states and its efforts.

    All times are integer nanoseconds of one steady clock. Not safe against threads: hold a lock.
    """

    def __init__(self, params):
        self.params, self.supervisor, self.counters = params, supervision.Supervisor(), Counter()
        self.robot, self.controller = RobotSide(params), ControllerSide(params)
        self._watched = np.inf     # when the bridge last looked after both sides; not yet
        self._enabled = 0          # stamp of the state at which torque was enabled
        self._silent_for = ''      # the fault of a silent controller, while it lasts
        self._warm_up()

    def _warm_up(self):
        """Compile before the first state comes."""
        names, robot = list(self.params.joint_map.names), RobotSide(self.params)
        robot.merger.take(0, names, [0.0] * len(names), (), (), 1, 1)
        robot.take(self.params.joint_map, robot.applied, 1)
        limiting.is_within(robot.rows, robot.rows, 0.0, *self.params.limits.within)
        limiting.limited(robot.applied, robot.applied, 0.0, *robot.rows[:2], self.params.limits)

    @property
    def torque(self) -> np.ndarray:
        """Return what the robot was given last, shape (n_joints,) [N m]."""
        return self.controller.torque

    # states --------------------------------------------------------------------------------

    def take_state(self, source, names, position, velocity, effort, stamp, now) -> bool:
        """Take a message as `StateMerger.take`; return whether a new state is to be published."""
        self.counters['states in'] += 1
        robot, joint_map = self.robot, self.params.joint_map
        if not robot.merger.take(source, names, position, velocity, effort, stamp, now):
            return False
        before = robot.rows.copy()
        elapsed = robot.take(joint_map, self.torque, now)
        self._note_late(elapsed)
        robot.violation = ''
        if not limiting.is_within(robot.rows, before, elapsed, *self.params.limits.within):
            self._judge(before, elapsed)
        robot.publish(now)
        self.counters[supervision.BRIDGED[0]] += 1
        return True

    def _judge(self, before, elapsed):
        """Find out what is wrong with the state that has come, or with the way to it."""
        robot, joints, limits = self.robot, self.params.joint_map.joints, self.params.limits
        robot.violation = limiting.violation(joints, robot.measured, limits)
        if not robot.violation and robot.stamp:
            robot.violation = limiting.jump(joints, robot.measured, before[::2], elapsed, limits)
        if robot.violation:
            self.fault(robot.violation + self._of_late_torque())

    def _note_late(self, elapsed):
        """Note whether the state that another follows now was answered."""
        controller = self.controller
        if not self.supervisor.active or controller.answered is None:
            controller.lateness.restart()  # plain commands answer no state
            return
        missed = controller.answered < self.robot.stamp
        self.counters[supervision.BRIDGED[1]] += missed
        controller.lateness.note(missed, elapsed)

    def refuse_state(self, sentence) -> None:
        """Note that joint states were refused, for the sentence of a fault."""
        self.counters['states refused'] += 1
        self.robot.refused = sentence

    # commands ------------------------------------------------------------------------------

    def take_command(self, command, stamp, source, now, sent=None) -> bool:
        """Take a command (n_joints,) [N m]; return whether ``torque`` is to be sent."""
        controller, limits = self.controller, self.params.limits
        self.counters['commands in'] += 1
        if self.watch(now):  # the process stood still: a command that waited ends no silence
            return True
        conflict = controller.watch.hear(source, now)
        if conflict:
            return self.fault(conflict)
        if not self._is_fresh(stamp, now):
            self.counters['commands stale'] += 1
            return False
        controller.answered = stamp
        self._end_silence(now)
        controller.watch.take(source, now)
        controller.refused = ''
        if not self.supervisor.active or (stamp is not None and stamp <= self._enabled):
            return False
        sent = now if sent is None else sent
        elapsed = min((sent - controller.given) / NANOSECONDS, LONGEST_RAMP)
        command, measured = np.array(command, dtype=float), self.robot.measured
        held = np.zeros(len(command), dtype=bool)
        controller.torque = limiting.limited(command, controller.torque, elapsed,
                                             measured.q_link, measured.dq_link, limits, held)
        held = held.tolist()
        controller.held_back = [supervision.recently(share, one, elapsed) for share, one in zip(
            controller.held_back, held, strict=True)]
        self.counters['commands held back by torque_rate'] += any(held)
        controller.given = sent
        self.counters['commands acted on'] += 1
        return True

    def _of_late_torque(self):
        """Return what a fault of the motion adds where torque often came late; '' else."""
        controller = self.controller
        if not self.supervisor.active:
            return ''
        if controller.lateness.share >= _OFTEN:
            return f'; {controller.lateness}: the controller is late'
        j = int(np.argmax(controller.held_back))
        if controller.held_back[j] < _OFTEN:
            return ''
        return (f'; torque_rate ({self.params.limits.torque_rate[j]:.4g} N m/s) held back the '
                f'torque of {self.params.joint_map.joints[j]} for '
                f'{controller.held_back[j]:.0%} of the last second: raise it, or take gentler '
                'gains')

    def _is_fresh(self, stamp, now):
        if stamp is None:
            return True
        published = self.robot.published.get(stamp)
        if published is None or now - published > self.params.silence_timeout * NANOSECONDS:
            return False
        self.controller.worst_answer = max(self.controller.worst_answer, now - published)
        return True

    def refuse_command(self, sentence) -> None:
        """Note that a command was refused, for the sentence of a fault."""
        self.counters['commands refused'] += 1
        self.controller.refused = sentence

    # faults --------------------------------------------------------------------------------

    def fault(self, sentence) -> bool:
        """Take all torque away; return whether zero is to be sent at once."""
        if not self.supervisor.trip(sentence):
            return False
        self.take_torque_away()
        return True

    def take_torque_away(self) -> None:
        """Forget the torque given; what is reported to the supervisor beside this says why."""
        self.controller.torque = np.zeros_like(self.torque)

    def watch(self, now) -> bool:
        """Look every ms or two whether both sides speak; return whether to send zero at once."""
        stood, self._watched = now - self._watched, now
        if not self.supervisor.active:
            return False
        # torque went to zero
        if self.params.guarded and stood > supervision.STOOD_STILL * NANOSECONDS:
            return self.fault(f'the bridge stood still for {stood / 1e6:.0f} ms')
        sentence = self.robot.silent(now, self.params) or self._silent_controller(now)
        self._silent_for = sentence if sentence.startswith(_NO_COMMAND) else ''
        return bool(sentence) and self.fault(sentence)

    def looked(self, now) -> int:
        """Return the time since both sides were last checked [ns]."""
        return now - self._watched

    def _silent_controller(self, now):
        controller = self.controller
        silence = controller.silent(now, self.params.silence_timeout)
        if not silence:
            return ''
        if now - self.robot.arrived > 0.5 * silence:  # nothing to be answered
            return self.robot.silence(now, self.params)
        said = f'; refused last: {controller.refused}' if controller.refused else ''
        return controller.sentence(silence) + said

    def _end_silence(self, now):
        """Say how long the silence was that was the fault, once it is over."""
        if self._silent_for and self.supervisor.reason == self._silent_for:
            silence = self.controller.watch.silence(now)
            self.supervisor.amend(f'{self.controller.sentence(silence or 0)}; they come again')
        self._silent_for = ''

    # requests ------------------------------------------------------------------------------

    def obstacle(self, now) -> str:
        """Return what stands against torque now; '' if nothing does."""
        sentence = self.robot.silent(now, self.params) or self.robot.violation
        if sentence:
            return sentence
        silence = self.controller.watch.silence(now)
        if silence is None:
            return 'no controller commands yet'
        if silence > self.params.silence_timeout * NANOSECONDS:
            return self.controller.sentence(silence)
        return ''

    def enable(self, now) -> supervision.Outcome:
        """Let torque flow, from zero on and for states from now on; return an Outcome."""
        if self.supervisor.active:  # and goes on as it does: nothing begins anew
            return self.supervisor.enable()
        outcome = self.supervisor.enable(self.obstacle(now))
        if outcome.success:
            self.take_torque_away()
            self.controller.held_back = [0.0] * len(self.torque)
            self._enabled, self.controller.given = self.robot.stamp, now
        return outcome
