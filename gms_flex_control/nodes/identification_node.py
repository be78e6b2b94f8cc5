# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The identification experiment as a ROS 2 node: it drives trajectory and controller."""

from pathlib import Path
import subprocess
from tempfile import TemporaryFile
import time

from gms_flex_control.data.recording import Phase
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.experiment.driven import executable
from gms_flex_control.experiment.identification_plan import (
    ExperimentError,
    plan_identification,
    require_space,
)
from gms_flex_control.nodes import messages, process
from gms_flex_control.nodes.health import trigger
from gms_flex_control.nodes.parameters import ConfiguredNode, NodeParameters
from gms_flex_control.nodes.recorder import ExperimentBag, STATES
from gms_flex_control.nodes.remote import RemoteNode
from gms_flex_control.nodes.step_runner import StepRunner, Watch
from gms_flex_control.schema.build import controller_from_values, robot_from_values
from gms_flex_control.schema.files import save_robot
from gms_flex_control.schema.keys import (
    controller_keys,
    identification_keys,
    IDENTIFICATION_NODE,
    robot_keys,
)
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

_BYTES_PER_SAMPLE = 1000  # state, command and reference with their frames, generously
_RATE_SAMPLES = 20        # joint states that give the rate
_GOODBYE = 1.0            # for a last call to be answered [s]
_LATCHED = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)
_DEPTH = 5000  # it reads each state, however far it falls behind a plant in lockstep


class StoppedError(Exception):
    """Somebody called ~/stop, or the process is to end."""


class _Fit:
    """The fit of the recording in a process of its own; the node answers meanwhile."""

    def __init__(self, node, robot, bag):
        self._node, self._robot, self._bag = node, robot, Path(bag)
        self._pause = node.create_client(
            SetBool, node.resolve_service_name(f"{node['plant_node']}/pause"))

    def run(self, spinner) -> None:
        """Identify the friction from the bag."""
        left_out = set(self._robot.joints) - {step.joint for step in self._node.plan.experiments}
        if left_out:
            self._node.say(
                f'no fit: the plan leaves out {", ".join(sorted(left_out))}, whose friction '
                "moves the others; 'gms_flex identify' takes several bags")
            return
        out = self._bag.with_name(f'{self._bag.name}_identified')
        believed = out / 'believed_robot.yaml'
        command = [*executable('gms_flex'), 'identify', str(self._bag), '--robot', str(believed),
                   '--out', str(out)]
        try:
            save_robot(self._robot, believed)
            self._node.say(f'identify: {self._bag}')
            self.set_pause(True)  # a loop in lockstep would run as fast as it can beside it
            with TemporaryFile('w+', encoding='utf-8', errors='replace') as printed:
                code = _ended(command, printed, spinner)
                printed.seek(0)
                text = printed.read().strip()
        except OSError as error:
            raise ExperimentError(f'identify cannot be run with its results in {out}: {error}; '
                                  'the bag is whole') from error
        finally:
            self.set_pause(False)
        if code:
            raise ExperimentError(f'the bag is whole, but its fit failed: {text}')
        self._node.say(text)

    def set_pause(self, on) -> None:
        """Let the plant pause or go on, if it can: one in lockstep alone has the service."""
        if self._pause.service_is_ready():
            self._node.see_out(self._pause.call_async(SetBool.Request(data=on)))


def _ended(command, printed, spinner):
    """Return the exit code of a command that prints into a file."""
    run = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=printed,
                           stderr=subprocess.STDOUT)
    while run.poll() is None:
        spinner.spin_once(0.1)
        if not spinner.goes_on():
            run.terminate()
            raise StoppedError
    return run.returncode


class IdentificationNode(ConfiguredNode):
    """Carry out the steps of an identification plan and record them."""

    def __init__(self, **kwargs):
        super().__init__('identification', **kwargs)
        parameters = NodeParameters(self, lambda joints: (
            *robot_keys(joints), *controller_keys(joints), *identification_keys(joints),
            *IDENTIFICATION_NODE))
        self._values = values = parameters.values
        joints = parameters.joints
        robot = robot_from_values(values)
        self.plan = plan_identification(values, robot, controller_from_values(values, joints))
        if Path(self['bag']).exists():
            raise ExperimentError(f"{self['bag']}: has been recorded already; name another "
                                  'identification.bag')
        self.trajectory = RemoteNode(self, self['trajectory_node'],
                                     ('start', 'stop', 'reset', 'release'))
        self.controller = RemoteNode(self, self['controller_node'])
        self._fit = _Fit(self, robot, self['bag'])
        self.watch = Watch(self.plan)
        self._bag = self._spinner = self._pending = None
        self._runner = StepRunner(self)
        self._ordered, self._stopped = self['autostart'], False
        self._phase_pub = self.create_publisher(Float64MultiArray, '~/phase', _LATCHED)
        self.create_subscription(JointState, STATES, self._on_joint_states,
                                 process.subscriber_qos(self._values['mode'], _DEPTH),
                                 event_callbacks=process.NO_EVENTS)
        for name, act in (('start', lambda: self._order('begins')), ('stop', self._stop),
                          ('resume', lambda: self._order('goes on'))):
            self.create_service(Trigger, f'~/{name}', trigger(name, act))
        self.say(f'{len(self.plan.experiments)} steps, about {self.plan.duration():.0f} s to go')

    def __getitem__(self, name):
        """Return the value of a parameter below ``identification``."""
        return self._values[f'identification.{name}']

    def say(self, sentence) -> None:
        """Log a sentence."""
        self.get_logger().info(sentence)

    # callbacks -----------------------------------------------------------------------------

    def _on_joint_states(self, message):
        try:
            self.watch.take(message)
        except messages.RefusedError as error:
            self.get_logger().warning(f'joint state refused: {error}', throttle_duration_sec=5.0)
        if self.watch.fault is not None and not self._stopped:
            self._release()

    def _order(self, words):
        """Let the steps be carried out; return success and message."""
        ordered, self._ordered = self._ordered, True
        return not ordered, 'runs already' if ordered else words

    def _stop(self):
        self._release()
        self._ordered = False
        return True, 'zero torque; ~/resume goes on'

    def _release(self):
        """Ask for zero torque at once; what waits for the robot gets a StoppedError."""
        self._stopped = True
        return self.trajectory.trigger('release')

    # waiting -------------------------------------------------------------------------------

    def spin(self) -> None:
        """Handle what has come; raise what ends the step that is waiting."""
        self._spinner.spin_once(0.02)
        if not self._spinner.goes_on():
            raise StoppedError
        if self._bag is None:
            return
        if self.watch.fault is not None:
            raise ExperimentError(self.watch.fault)
        self._bag.recorder.poll()
        if self._stopped:
            raise StoppedError

    def until(self, condition, otherwise=None) -> None:
        """Spin until ``condition()`` while the loop lives; ``otherwise()``: not in time."""
        end = time.monotonic() + self['patience']
        while not condition():
            self.spin()
            silent = self._bag and self._bag.silent(self['silence'])
            if silent:
                raise ExperimentError(
                    f'no {" and no ".join(silent)} for {self["silence"]:g} s: the robot is left '
                    'without torque; is every node running?')
            if otherwise and time.monotonic() > end:
                raise ExperimentError(f'{otherwise()} in {self["patience"]:g} s')

    def answer(self, future, who) -> object:
        """Return the answer of a call."""
        self._pending = future
        self.until(future.done, lambda: f'{who} did not answer')
        return future.result()

    def phase(self, name, step=None) -> None:
        """Publish what is done from the next joint state on."""
        phase = Phase(self.watch.stamp, name, step.joint if step else '',
                      step.name if step else '', step.value if step else 0.0)
        self._bag.say(messages.phase_message(phase))

    # run -----------------------------------------------------------------------------------

    def run(self, spinner) -> None:
        """Carry out what is unfinished; return when done or when a signal comes."""
        self._spinner = spinner
        try:
            self._prepare()
            self._record(self['bag'])
            if self['fit']:
                self._fit.run(spinner)
        except StoppedError:
            self.say('ended by a signal')

    def _prepare(self):
        for remote in (self.trajectory, self.controller):
            self.until(remote.is_ready, lambda remote=remote: (
                f'the services of {remote.name} did not appear'))
        self._fit.set_pause(False)  # of one that was killed while it computed
        self.until(lambda: self.watch.samples > _RATE_SAMPLES, lambda: f'no state on {STATES}')
        samples = self.plan.duration() / self.watch.period
        require_space(Path(self['bag']).parent, samples * _BYTES_PER_SAMPLE)

    def _record(self, path):
        with ExperimentBag(self, path, self._phase_pub, self.say) as bag:
            recorder = bag.recorder
            self.until(lambda: recorder.poll() or not recorder.unheard,
                       lambda: f'nobody publishes {", ".join(recorder.unheard)}')
            self._bag = bag
            try:
                self._carry_out()
            except (GmsFlexError, StoppedError):
                self._let_go()
                raise
            finally:
                self._bag = None
        self.say(f'recorded {path}')

    def _carry_out(self):
        """Run steps, again after each ~/stop, until all are finished."""
        while True:
            if not self._ordered:
                self.say('waiting for ~/start')
            while not self._ordered:
                self._stopped = False
                self.spin()
            self._stopped = False
            try:
                self._runner.run()
                return
            except StoppedError:
                if not self._spinner.goes_on():
                    raise
                self._let_go()
                self.say('stopped: zero torque; ~/resume goes on with the next unfinished step')

    def _let_go(self):
        """Ask for zero torque once more, after all calls before, and see it out."""
        self.phase('idle')
        self.get_logger().warning('zero torque')
        self.watch.guarded = False
        if self._pending is not None:
            self.see_out(self._pending)  # a ~/start that overtakes it would undo it
        if self.trajectory.is_ready():
            self.see_out(self._release())
        if self.controller.is_ready():
            self._runner.give_back()

    def see_out(self, future) -> None:
        """Spin until a last call is answered, for a while at most."""
        end = time.monotonic() + _GOODBYE
        while not future.done() and time.monotonic() < end:
            self._spinner.spin_once(0.02)
