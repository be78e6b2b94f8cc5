# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Motions by the parameters of the other nodes: the steps of an experiment, or one recorded."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
import time

from gms_flex_control.data.writer import BagWriter
from gms_flex_control.design.motions import APPROACH
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.experiment.driven import TOPICS
from gms_flex_control.experiment.identification_plan import Adaptation, ExperimentError, LEAVING
from gms_flex_control.experiment.identification_steps import BRAKING_TIME
from gms_flex_control.nodes import messages
from gms_flex_control.nodes.messages import NANOSECONDS, to_nanoseconds
from gms_flex_control.nodes.process import hidden_node, NO_EVENTS
from gms_flex_control.nodes.recorder import Recorder
from gms_flex_control.nodes.remote import RemoteNode, values_of
import numpy as np
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

_LATENESS = 0.05  # a step may begin that much after the state at which its call was answered [s]

# of the travel at which the trajectory node ends a torque: it may count from another state
_GONE = 0.9
_WINDOW = 50_000_000   # over which speed is measured [ns]
_OVERSPEED = 1.25      # of the limit that steps are planned for
_BOUND = 10.0    # for an answer [s]
_SILENCE = 5.0   # without a joint state: the robot has stopped talking [s]


class Watch:
    """Follows joint states and limits of a plan: ``stamp``, ``samples``, ``q_link``, ``fault``."""

    def __init__(self, plan):
        self._plan = plan
        self.stamp, self.samples, self.fault = 0, 0, None
        self.q_link = np.full(len(plan.joints), np.nan)
        self._links = messages.JointNumbers(plan.joints)
        self._first = self._window = None
        self.guarded, self._origin = False, None  # whether the limits are watched

    @property
    def period(self) -> float:
        """Return the mean sample [s]."""
        return max(self.stamp - self._first, 1) / (NANOSECONDS * max(self.samples - 1, 1))

    def mark(self) -> None:
        """Measure travel from here."""
        self._origin = self.q_link.copy()

    def travel(self, j) -> float:
        """Return how far link ``j`` has moved since `mark` [rad]."""
        return float(abs(self.q_link[j] - self._origin[j]))

    def take(self, message) -> None:
        """Read a JointState; raises RefusedError if it lacks a joint or a finite angle."""
        q_link = self._links.read(message, 'position')
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
        if not self.guarded or self.fault is not None:
            return
        plan, limits = self._plan, self._plan.limits
        for j, joint in enumerate(plan.joints):
            if not limits.lower[j] <= q_link[j] <= limits.upper[j]:
                self.fault = (f'{joint} is at {q_link[j]:.4g} rad, outside its range '
                              f'{limits.lower[j]:g} to {limits.upper[j]:g} rad: zero torque')
        elapsed = self.stamp - self._window[0]
        if elapsed < _WINDOW:
            return
        for j, joint in enumerate(plan.joints):
            speed = abs(q_link[j] - self._window[1][j]) * NANOSECONDS / elapsed
            if speed > _OVERSPEED * limits.velocity[j]:
                self.fault = (f'{joint} moves at {speed:.3g} rad/s, the limit is '
                              f'{limits.velocity[j]:g} rad/s: zero torque')
        self._window = (self.stamp, list(q_link))


class StepRunner:
    """Carries out what is unfinished of the plan of an IdentificationNode, which can wait."""

    def __init__(self, node):
        self._node, self._plan, self._finished = node, node.plan, []
        self._compensation = self._before = None
        self._adaptation = Adaptation(self._plan)

    def run(self) -> None:
        """Carry out all unfinished steps; the controller then is as it was."""
        node, plan = self._node, self._plan
        self._take_over()
        steps = plan.steps(self._finished, node.watch.q_link)
        begin, expected, passed = node.watch.stamp, sum(s.duration_estimate for s in steps), 0.0
        node.watch.guarded = True
        for step in steps:
            if step in plan.experiments:
                node.say(f'{100.0 * passed / expected:3.0f} %, {expected - passed:.0f} s to go: '
                         f'{step.name}')
            adapted = self._adaptation.applied_to(step)
            node.phase(step.phase, adapted)
            {'approach': self._approach, 'relax': self._relax, 'motion': self._move,
             'torque': self._push}[step.kind](adapted)
            passed += step.duration_estimate
            if step in plan.experiments:
                self._finished.append(step.name)
        node.watch.guarded = False
        node.phase('idle')
        self._set(node.controller, self._before)
        taken = (node.watch.stamp - begin) / NANOSECONDS
        node.say(f'100 %, done in {taken:.1f} s, estimated {expected:.1f} s')

    def _take_over(self):
        """Limit the controller's torque; note the parameters to leave it with."""
        limits = {f'gains.{joint}.torque_limit': float(limit) for joint, limit in zip(
            self._plan.joints, self._plan.limits.torque, strict=True)}
        names = ['compensation', *limits]
        remote = self._node.controller
        answer = self._node.answer(remote.get_parameters(names), remote.name)
        before = dict(zip(names, values_of(answer), strict=False))
        if len(before) != len(names) or None in before.values():
            raise ExperimentError(f'{remote.name} lacks one of the parameters '
                                  f'{", ".join(names)}; is it the controller node, and of this '
                                  'robot?')
        self._before, self._compensation = self._before or before, None
        self._set(remote, {name: min(limit, before[name]) for name, limit in limits.items()})

    def give_back(self) -> None:
        """Leave the controller as it was, without waiting for its answer."""
        if self._before is not None:
            self._node.controller.set_parameters(self._before)

    def _set(self, remote, values):
        answer = self._node.answer(remote.set_parameters(values), remote.name)
        if not answer.result.successful:
            raise ExperimentError(f'{remote.name} refused {", ".join(values)}: '
                                  f'{answer.result.reason}')

    def _trigger(self, service):
        remote = self._node.trajectory
        answer = self._node.answer(remote.trigger(service), remote.name)
        if not answer.success:
            raise ExperimentError(f'{remote.name}/{service} refused: {answer.message}')

    def _pass(self, seconds):
        """Let simulated or real time pass, by the stamps of the joint states."""
        end = self._node.watch.stamp + round(NANOSECONDS * seconds)
        self._node.until(lambda: self._node.watch.stamp >= end)

    def _compensate(self, compensation):
        if compensation != self._compensation:
            self._set(self._node.controller, {'compensation': compensation})
            self._compensation = compensation

    def _approach(self, step):
        time = self._plan.approach_time(self._node.watch.q_link, step.end)
        self._compensate(self._plan.compensation)
        self._begin(step.trajectory_parameters | {'trajectory.approach_time': time})
        self._pass(time + _LATENESS + self._plan.rest_time)

    def _move(self, step):
        self._compensate(self._plan.compensation)
        self._begin(step.trajectory_parameters)
        self._pass(self._plan.trajectory(step).end + _LATENESS + self._plan.rest_time)

    def _relax(self, step):
        """Unload the springs: no compensation, and the reference where the links come to rest."""
        self._compensate('none')
        self._set(self._node.trajectory, step.trajectory_parameters)
        for _ in range(2):
            self._trigger('reset')
            self._pass(self._plan.relax_time)

    def _push(self, step):
        node, j = self._node, self._plan.joints.index(step.joint)
        node.watch.mark()
        self._begin(step.trajectory_parameters)
        begin = node.watch.stamp
        end = begin + round(NANOSECONDS * (self._plan.trajectory(step).end + _LATENESS))
        gone = _GONE * step.travel
        still = begin  # the last stamp before it began to break away

        def is_over():
            nonlocal still
            travel = node.watch.travel(j)
            if travel <= LEAVING * step.travel:
                still = node.watch.stamp
            return node.watch.stamp >= end or travel > gone > 0.0

        node.until(is_over)
        moved = node.watch.travel(j) > gone > 0.0
        self._trigger('reset')
        if step.phase == 'break_away':
            self._note_break_away(step, moved, (still - begin) / NANOSECONDS)
        elif moved:
            node.say(f'{step.joint} broke away below {step.value:.4g} N m: the step ends early')
        self._pass(BRAKING_TIME + self._plan.rest_time)

    def _note_break_away(self, step, moved, time):
        torque = self._adaptation.broke_away(step, time)
        if moved:
            self._node.say(f'{step.joint} broke away at about {torque:.3g} N m')
        else:
            self._node.say(f'{step.joint} did not break away at {torque:.4g} N m: its F_s is '
                           f'above that; raise identification.{step.joint}.static')

    def _begin(self, values):
        self._set(self._node.trajectory, values)
        self._trigger('start')


class RunError(GmsFlexError):
    """A motion could not be driven; the sentence says why, and what to look at."""


def drive_motion(parameters: dict, duration: float, bag: str | Path, *, patience: float = 20.0,
                 say: Callable[[str], object] = lambda text: None) -> None:
    """
    Set the motion of the running node ``/trajectory``, start it, record it, bring it to rest.

    ``parameters`` are ``trajectory.*``; ``duration`` [s] is from its beginning by the stamps of
    the joint states, `APPROACH` is added; ``patience`` [s] is for nodes and topics to be there.
    RunError if the nodes are missing, refuse the motion, or fall silent, after ``~/stop`` has been
    called; BagError if the bag cannot be written.
    """
    with (hidden_node('next') as (node, executor), BagWriter(bag) as writer,
          closing(Recorder(node, writer, list(TOPICS), say)) as recorder):
        _Runner(node, executor, recorder, patience).run(
            parameters | {'trajectory.approach_time': APPROACH}, duration)


class _Runner:
    """Commands the trajectory node while a Recorder records."""

    def __init__(self, node, executor, recorder, patience):
        self._executor, self._recorder, self._patience = executor, recorder, patience
        self._trajectory = RemoteNode(node, 'trajectory', ('start', 'stop'))
        self._stamp, self._heard = None, time.monotonic()
        node.create_subscription(JointState, 'joint_states', self._on_state,
                                 qos_profile_sensor_data, event_callbacks=NO_EVENTS)

    def _on_state(self, message):
        self._stamp, self._heard = to_nanoseconds(message.header.stamp), time.monotonic()

    def run(self, parameters, duration) -> None:
        """Drive the motion and bring it to rest."""
        self._until(self._trajectory.is_ready, 'the services of /trajectory are not there: start '
                    'plant_node or the bridge, controller_node and trajectory_node first',
                    self._patience)
        self._until(lambda: not self._unheard() and self._stamp is not None,
                    'not all nodes publish', self._patience, self._unheard)
        answer = self._answer(self._trajectory.set_parameters(parameters)).result
        if not answer.successful:
            raise RunError(f'/trajectory refuses the motion: {answer.reason}')
        self._trigger('start')
        try:
            self._pass(duration + APPROACH)
        finally:
            self._trigger('stop')
        self._pass(APPROACH)

    def _trigger(self, service):
        response = self._answer(self._trajectory.trigger(service))
        if not response.success:
            raise RunError(f'/trajectory/{service}: {response.message}')

    def _answer(self, future):
        self._until(future.done, '/trajectory does not answer', _BOUND)
        return future.result()

    def _unheard(self):
        """Return what is not recorded yet; a controller has a state only while it follows."""
        missing, unheard = self._recorder.missing, self._recorder.unheard
        return [name for name in unheard if name in missing or name in TOPICS[:3]]

    def _until(self, done, otherwise, bound, unheard=None):
        """Spin until something is done; raise RunError, with what is missing, after a while."""
        end = time.monotonic() + bound
        while not done():
            self._spin()
            if time.monotonic() > end:
                missing = f' ({", ".join(unheard())} missing)' if unheard else ''
                raise RunError(f'{otherwise}{missing}; same ROS_DOMAIN_ID?')

    def _pass(self, duration):
        """Spin for so long by the stamps of the joint states [s]."""
        end = self._stamp + round(duration * NANOSECONDS)
        while self._stamp < end:
            self._spin()
            if time.monotonic() - self._heard > _SILENCE:
                raise RunError(f'no joint state for {_SILENCE:g} s: the robot has stopped; look '
                               'at /diagnostics')

    def _spin(self):
        self._recorder.poll()
        self._executor.spin_once(timeout_sec=0.02)
