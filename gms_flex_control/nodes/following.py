# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What torque answers a joint state: the law, the reference it follows, and what forbids it."""

import time
from typing import NamedTuple

from gms_flex_control.control.cascade import SteppedController
from gms_flex_control.control.frozen_encoders import EncoderWatch
from gms_flex_control.hardware.supervision import SourceWatch
from gms_flex_control.nodes.health import OK, WARN
from gms_flex_control.nodes.messages import all_finite, EFFORT, NANOSECONDS
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.polynomials import extrapolate
import numpy as np

_LONGEST_TICK = 0.5  # a longer gap between states starts the observer anew [s]
_KEPT = 4            # references
_BRAKE_TIME = 0.5    # from a lost reference to rest [s]
_AVERAGE = 0.1       # time constant of the torque that is let down [s]
# A reference nearer to the robot is followed at once: the law's step is then small.
_NEAR, _NEAR_SPEED = 0.01, 0.2  # [rad], [rad/s]
_FADE = round(0.1 * NANOSECONDS)  # in which the torque becomes the law's where a motion begins
_RISE = 0.1          # the most it rises in one sample, of all: a loop may stall as it begins
FOLLOWING, HOLDING, RELAXING = 'following', 'holding', 'relaxing'
_PHASES = {FOLLOWING: (OK, 'following'), HOLDING: (WARN, 'reference lost: holding'),
           RELAXING: (WARN, 'reference lost: letting the torque down to zero')}


class Reference(NamedTuple):
    """One reference as received or made up."""

    quantity: str        # 'motion' or 'effort'
    value: np.ndarray    # (5, n) or (1, n)


class References:
    """
    References by the stamp of the joint state they are for.

    A motion whose references stop coming is brought to rest and held; then the torque of the
    hold is let down to zero without feedback.

    ``timeout`` is the age of one that is still followed, ``hold`` how long a lost one is held,
    ``relax`` how long the torque then takes to zero [s].
    """

    def __init__(self, timeout, hold, relax):
        self._timeout = round(NANOSECONDS * timeout)
        self._hold, self._relax = hold, relax
        self._kept = {}
        self.phase = None     # None where there is nothing to follow
        self._last = None     # (stamp, Reference) followed last
        self._rest = None     # (stamp, Trajectory) of the way to rest
        self._torque = None   # mean of the last commands

    def keep(self, stamp, reference, last=None) -> None:
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

    def motions(self) -> tuple:
        """Return stamps (k,), values (k, 5, n) and their longest use [ns]; () for other ones."""
        kept = self._kept.values()
        if not kept or any(reference.quantity == EFFORT for reference in kept):
            return ()
        return (np.array(list(self._kept)), np.array([reference.value for reference in kept]),
                self._timeout)

    def has(self, stamp) -> bool:
        """Return whether there is one for exactly this joint state."""
        return stamp in self._kept

    def forget(self) -> None:
        """Follow nothing that has been received."""
        self._kept.clear()
        self.forget_motion()

    def forget_motion(self) -> None:
        """Hold nothing from before: the robot is elsewhere, or its clock is."""
        self.phase = self._last = self._rest = self._torque = None

    def is_fresh(self, stamp, now) -> bool:
        """Return whether one for ``stamp`` would be followed by the state of ``now`` [ns]."""
        return abs(stamp - now) <= self._timeout

    def nearest(self, stamp) -> int | None:
        """Return how far the nearest stamp is [ns]; None without any reference."""
        return min((abs(known - stamp) for known in self._kept), default=None)

    def at(self, stamp) -> Reference | None:
        """Return the Reference for a joint state, moved to its time; None without a reference."""
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

    def answered(self, torque, elapsed) -> None:
        """Note the command (n,) [N m] that the law gave, ``elapsed`` [s] after the one before."""
        if self.phase != HOLDING or self._torque is None:
            self._torque = np.array(torque)
        else:
            self._torque += min(1.0, elapsed / _AVERAGE) * (torque - self._torque)


class Handover:
    """The way, in ``duration`` [s], from one reference to another and one torque to another."""

    def __init__(self, duration):
        self._duration = duration
        self._way = self.left = None
        self._share, self._seen = 1.0, 0  # of the law's torque, and stamp it was given at
        self._torque = 0.0                # before [N m]

    def begin(self, stamp, motion, reference, torque=0.0) -> None:
        """Go to ``reference`` (5, n) from ``motion`` (2, n) and ``torque``, at once if near."""
        self._way = self.left = None
        self._share, self._seen, self._torque = 0.0, stamp, torque
        offset = -reference
        offset[:2] += motion
        if (np.abs(offset[0]).max() > _NEAR or np.abs(offset[1]).max() > _NEAR_SPEED):
            self._way = (stamp, builders.approach(
                offset, builders.hold(np.zeros(offset.shape[1])), 0.0, duration=self._duration))

    @property
    def is_over(self) -> bool:
        """Return whether the reference is followed as it is, with all of the torque."""
        return self._way is None and self._share >= 1.0

    def applied(self, stamp, reference) -> np.ndarray:
        """Return ``reference`` (5, n) with what is left of the way added."""
        if self._way is None:
            return reference
        since = (stamp - self._way[0]) / NANOSECONDS
        if since >= self._duration:
            self._way = self.left = None
            return reference
        self.left = self._way[1].sample(since)
        return reference + self.left

    def fade(self, stamp, torque) -> None:
        """Let ``torque`` (n,) begin with the one before, where a motion begins; in place."""
        if self._share < 1.0:
            self._share = min(self._share + min((stamp - self._seen) / _FADE, _RISE), 1.0)
            self._seen = stamp
            torque *= self._share
            torque += (1.0 - self._share) * self._torque


class Follower:
    """The answer to each joint state: the law, its references and what stands against them."""

    def __init__(self, robot, gains, values, health):
        self._health, self._lockstep = health, values['mode'] == 'lockstep'
        self.controller = SteppedController(gains, robot)
        self.references = References(*(values[f'reference_{what}']
                                       for what in ('timeout', 'hold', 'relax')))
        self.handover = Handover(values['resume_time'])
        self.encoders = EncoderWatch(robot, gains.torque_limit, self.controller.measured)
        self._sources = SourceWatch('nodes send references')
        self._zero = np.zeros(robot.n_joints)
        self.last = None         # stamp of the state answered last
        self.follows = False     # whether its answer was that of the law
        self._obstacle = ''      # why it was answered with zero, though it was sound
        self._begins = True      # the next state with a motion reference begins a motion
        self._asked = None       # (5, n_joints), what the law followed last
        self.changes = 0         # of what the next answer depends on
        self.counts = {'observer begun anew': 0, 'two trajectories': 0}
        self._warm_up()

    def _warm_up(self):
        """Compile before the first state comes, with a motion from the robot to elsewhere."""
        away = np.ones((5, len(self._zero)))
        handover = Handover(1.0)
        handover.begin(0, self._measured(), away)
        self.controller.tick(handover.applied(0, extrapolate(away, 0.0)), 0.0)
        self.controller.reset()

    def use(self, gains) -> None:
        """Take other gains."""
        self.changes += 1
        self.controller.use(gains)
        self.encoders.use(gains.torque_limit)

    def reset(self) -> None:
        """Begin anew from the measured state."""
        self.changes += 1
        self.controller.reset()
        self.references.forget_motion()
        self.encoders.reset()
        self._begins = True

    def is_fresh(self, stamp) -> bool:
        """Return whether a reference for ``stamp`` [ns] is of this time."""
        return self.last is None or self.references.is_fresh(stamp, self.last)

    def keep(self, stamp, reference, source) -> None:
        """Take a Reference, unless another source's come as well; then nobody's are kept."""
        self.changes += 1
        if not self._lockstep and self.is_fresh(stamp):
            now = time.monotonic_ns()
            before, rivals = self._sources.conflict(now), self._sources.hear(source, now)
            if rivals:
                self.references.forget()
                if not before:
                    self.counts['two trajectories'] += 1
                    self._health.warn('rivals', f'{rivals}: zero torque; end one of them')
                return
        self.references.keep(stamp, reference, self.last)

    def answer(self, stamp, silent) -> np.ndarray:
        """Return the torque (n,) [N m] for a state of ``stamp``; ``silent``: after zeros."""
        self.changes += 1
        elapsed = 0.0 if self.last is None else (stamp - self.last) / NANOSECONDS
        jumped = self.last is not None and not 0.0 < elapsed <= _LONGEST_TICK
        self.last, self.follows = stamp, False
        idle, self._obstacle = bool(self._obstacle), self._find_obstacle(elapsed)
        if jumped:
            self._begin_anew(elapsed)
            elapsed = 0.0
        elif silent or idle:
            self._begins = True
            self.controller.state.started[0] = 0.0  # nobody knows the way since
            elapsed = 0.0
        if self._obstacle:  # the observer stays as it is, as in a silence
            self.references.forget_motion()
            self._health.report(WARN, self._obstacle)
            return self._zero
        if jumped and not self._lockstep:  # the next state shows whether this clock goes on
            return self._zero
        before = None if silent or idle or jumped else self.references.phase
        reference = self.references.at(stamp)
        if reference is None:
            self._say_no_reference(stamp)
            return self._nothing()
        if before == HOLDING and self.references.phase == FOLLOWING:  # it has come back
            self._begins = True
        return self._follow(stamp, reference, elapsed, before)

    def outlook(self, sent) -> tuple:
        """Return what the next answer depends on, after a command ``sent``; () without law."""
        motions = self.references.motions()
        if (not motions or not self.follows or self._begins or not self.handover.is_over
                or self.references.phase != FOLLOWING):
            return ()
        return *self.law(sent), motions

    def law(self, sent) -> tuple:
        """Return of an `outlook` what it has without references."""
        judge = self.encoders.judge
        return ((sent, self.encoders.nothing, judge.memory, *judge.expected),
                self.controller.boxes)

    def _nothing(self):
        """Forget the motion so far; return zero torque."""
        self.controller.reset()
        self._begins = True
        return self._zero

    def _begin_anew(self, elapsed):
        self.counts['observer begun anew'] += 1
        self._health.report(WARN, f'joint states jumped by {elapsed:.3f} s: zero torque')
        self._health.warn('jump', f'joint states jumped by {elapsed:.3f} s: observer begins anew')
        self.references.forget_motion()
        self._nothing()

    def _find_obstacle(self, elapsed):
        """Return why no reference may be followed (str); '' if any may."""
        frozen = self.encoders.look(elapsed)
        if not frozen:
            rivals = self._sources.conflict(time.monotonic_ns())
            return rivals and f'{rivals}: zero torque'
        sentence = f'{frozen}: zero torque until it changes, or ~/reset'
        if self.encoders.began:
            self._health.warn(  # of its own kind: another encoder is another warning
                f'encoder {frozen.split()[0]}', f'{sentence}; turn the joint by hand, or once the '
                f'cause is found call {self._health.name}/reset')
        return sentence

    def _measured(self):
        """Return the measured angles and rates of the links (2, n_joints)."""
        return np.array([self.controller.measured.q_link, self.controller.measured.dq_link])

    def _follow(self, stamp, reference, elapsed, before):
        """Return the torque that follows a reference, after the phase of the state before."""
        if reference.quantity == EFFORT:
            command = self.controller.pass_on(reference.value[0])
            self._begins = True
        else:
            command = self.controller.state.command
            if self._begins:
                self._begins = False
                self.handover.begin(
                    stamp, self._asked[:2] if before == HOLDING else self._measured(),
                    reference.value, command.copy() if before in (HOLDING, RELAXING) else 0.0)
            self._asked = self.handover.applied(stamp, reference.value)
            self.controller.tick(self._asked, elapsed)
            if not self._lockstep:
                self.handover.fade(stamp, command)
            self.references.answered(command, elapsed)
        if not all_finite(command.tolist()):
            self._health.report(WARN, 'the law gave no finite torque: zero torque')
            self._health.warn('law', 'the law gave no finite torque: zero torque; are state or '
                                     'reference plausible?')
            return self._nothing()
        self._health.report(*_PHASES[self.references.phase])
        self.follows = True
        return command

    def _say_no_reference(self, stamp):
        away = self.references.nearest(stamp)
        why = ('is trajectory_node running?' if away is None else
               f'the nearest is {away / NANOSECONDS:.3g} s away from the joint states; '
               'has trajectory_node ended, or is its clock another one?')
        self._health.report(WARN, 'no reference: zero torque')
        self._health.warn('no reference', f'no reference: zero torque; {why}', skip_first=True)
