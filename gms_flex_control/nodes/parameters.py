# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Node parameters from the schema: declared, coerced, judged, applied."""

from array import array
import atexit
from itertools import pairwise
import math
from pathlib import Path
from shutil import rmtree
import sys
from tempfile import mkdtemp
import time

from gms_flex_control.errors import ConfigError, GmsFlexError
from gms_flex_control.nodes.health import Namesakes, trigger
from gms_flex_control.nodes.process import NO_EVENTS
from gms_flex_control.nodes.topics import Direct
from gms_flex_control.params.key import checked, range_in_words, REQUIRED
from gms_flex_control.schema import build
from gms_flex_control.schema.keys import known_keys
import numpy as np
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

_PATIENCE = 5.0  # with a topic that has the URDF [s]
_LOOK_PERIOD = 0.02  # between looks whether recorders are there [s]
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_BUILT_IN = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
_TYPES = {kind: getattr(ParameterType, f'PARAMETER_{kind.upper()}')
          for kind in ('double', 'integer', 'string', 'double_array', 'string_array')} | {
              'boolean': ParameterType.PARAMETER_BOOL}


def _descriptor(key):
    """Return what ROS says of a parameter."""
    choices = f"one of {', '.join(key.choices)}" if key.choices else ''
    unit = f' [{key.unit}]' if key.unit else ''
    descriptor = ParameterDescriptor(  # rqt_reconfigure shows the description alone
        description=f'{key.description}{unit}{f": {choices}" if choices else ""}',
        type=_TYPES[key.kind], additional_constraints=choices, read_only=not key.live)
    if key.kind == 'double' and key.live and math.isfinite(key.lower):
        # no range: from finger to crane it is useless for a slider; `checked` judges the value
        descriptor.additional_constraints = range_in_words(key)
    elif math.isinf(key.lower) or math.isinf(key.upper):
        return descriptor
    elif key.kind == 'double':  # no step: ROS refuses what is not on its grid
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=key.lower, to_value=key.upper)]
    elif key.kind == 'integer':
        descriptor.integer_range = [
            IntegerRange(from_value=int(key.lower), to_value=int(key.upper), step=1)]
    return descriptor


class ConfiguredNode(Node):
    """A node that declares all parameters it is given, for `NodeParameters` to check."""

    def __init__(self, name, direct=None, **kwargs):
        self.direct, self.inboxes, begin = direct or Direct(), [], time.monotonic()
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **kwargs)
        self.namesakes = Namesakes(self, time.monotonic() - begin)

    def declare_parameters(self, namespace, parameters, ignore_override=False) -> list:
        """Declare parameters; an empty list of a file, which rclpy is given as None, is one."""
        return super().declare_parameters(namespace, [
            (name, [] if value is None else value, descriptor)
            for name, value, descriptor in parameters], ignore_override=ignore_override)

    def resolve_topic_name(self, topic, *, only_expand=False) -> str:
        """Return the full name of a topic; ConfigError names one that cannot be."""
        return _resolved(super().resolve_topic_name, topic, only_expand)

    def resolve_service_name(self, service, *, only_expand=False) -> str:
        """Return the full name of a service; ConfigError names one that cannot be."""
        return _resolved(super().resolve_service_name, service, only_expand)

    def serve(self, name, act) -> None:
        """Offer a Trigger ``~/<name>``, also within this process; ``act()`` as of `trigger`."""
        handler = self.health.guard(trigger(name, act))
        self.create_service(Trigger, f'~/{name}', handler)
        self.direct.services[self.resolve_service_name(f'~/{name}')] = handler

    def wait_for_recorders(self, spinner, recorders, are_heard) -> None:
        """Hear nothing before ``are_heard(recorders)``, if there are to be any."""
        while recorders and spinner.goes_on() and not are_heard(recorders):
            time.sleep(_LOOK_PERIOD)

    def finish(self) -> None:
        """Leave zero torque on the wire, where this node gives torque."""

    def set_parameters_atomically(self, parameter_list) -> SetParametersResult:
        """
        Set all or none, as services ask; a refusal says the way out, as those of rclpy do not.

        One that cannot change and has the value already is left as it is: 'ros2 param load' takes
        what 'ros2 param dump' has written.
        """
        changed = []
        for parameter in parameter_list:
            name, value = parameter.name, _plain(parameter.value)
            if not self.has_parameter(name):
                return SetParametersResult(reason=self._unknown(name))
            if value is None or not self.describe_parameter(name).read_only:
                changed.append(parameter)
                continue
            now = _plain(self.get_parameter(name).value)
            if value != now:
                return SetParametersResult(reason=(
                    f'{name} is {now} as long as the node runs: start it anew with '
                    f'-p {name}:={value}'))
        if parameter_list and not changed:
            return SetParametersResult(successful=True)
        return super().set_parameters_atomically(changed)

    def _unknown(self, name):
        try:
            known_keys([name], self.get_parameter('joints').value)
        except GmsFlexError as error:
            return str(error)
        return (f'{name} is not a parameter of {self.get_fully_qualified_name()}, or was not '
                'given when it started')


def _resolved(resolve, name, only_expand):
    try:
        return resolve(name, only_expand=only_expand)
    except (RuntimeError, ValueError) as error:  # of rcl, without the name
        reason = str(error).rsplit(': ', 1)[-1].split(', at /')[0]
        raise ConfigError(f'{name!r} is not the name of a topic or service: {reason}') from error


def _plain(value):
    return value.tolist() if isinstance(value, array) else value


class NodeParameters:
    """
    The parameters of one ConfiguredNode ``node``.

    ``own_keys`` takes joint names and returns the keys this node uses; those of the other nodes
    may stand in the same file. Raises ConfigError if a file gave an unknown key, a wrong type or
    range, or lacks a required key.
    """

    def __init__(self, node, own_keys):
        self._node = node
        given = {name: parameter.value
                 for name, parameter in node.get_parameters_by_prefix('').items()
                 if not name.startswith(_BUILT_IN)}
        if 'joints' not in given:
            raise ConfigError('joints is missing: no robot file was read; is the path of its '
                              '--params-file right? ros2 launch leaves out a file that is not '
                              'there')
        self.joints = build.joint_names(given)
        known = known_keys(given, self.joints)
        self._keys = {key.name: key for key in own_keys(self.joints)}
        if given.get('arm.urdf') and 'arm.urdf' in self._keys:
            given['arm.urdf'] = (_beside_parameters(given['arm.urdf'])
                                 or _of_topic(node, str(given['arm.urdf'])))
        if 'motors' in self._keys:
            self._keys |= {name: key for name, key in known.items()
                           if name.startswith(('effects.', 'uncertainty.'))}
        self.values = {name: self._value(key, given) for name, key in self._keys.items()}
        for name in given:
            node.undeclare_parameter(name)
        for name, key in self._keys.items():
            value = self.values[name]
            node.declare_parameter(name, list(value) if key.kind.endswith('_array') else value,
                                   _descriptor(key), ignore_override=True)

    @staticmethod
    def _value(key, given):
        if key.name in given:
            return checked(key, given[key.name])
        if key.default_beside(given) is REQUIRED:
            raise ConfigError(f'parameter {key.name} is missing ({key.description}); give it in '
                              'a file after --ros-args --params-file')
        return key.default_beside(given)

    def watch(self, judge, apply, guard=lambda callback: callback) -> None:
        """
        Let live parameters change while the node runs.

        ``judge`` takes flat values and raises GmsFlexError with the reason to refuse; ``apply``
        gets what it returned once the change is accepted; ``guard`` wraps the callbacks, see
        Health.guard: one that raises would kill the executor.
        """
        self._judge, self._apply = judge, apply
        self._node.add_pre_set_parameters_callback(guard(self._coerce))
        self._node.add_on_set_parameters_callback(self._on_set)
        self._node.add_post_set_parameters_callback(guard(self._on_changed))

    def _coerce(self, parameters):
        """Return parameters with whole numbers as doubles where doubles are meant."""
        return [self._as_double(parameter) for parameter in parameters]

    def _as_double(self, parameter):
        name, kinds = parameter.name, Parameter.Type
        if name in self._keys and (parameter.type_, self._keys[name].kind) in (
                (kinds.INTEGER, 'double'), (kinds.INTEGER_ARRAY, 'double_array')):
            return Parameter(name, value=np.asarray(parameter.value, dtype=float).tolist())
        return parameter

    def _candidate(self, parameters):
        values = dict(self.values)
        for parameter in parameters:
            if parameter.name in self._keys:
                values[parameter.name] = checked(self._keys[parameter.name], parameter.value)
        return values

    def _on_set(self, parameters):
        try:
            self._judge(self._candidate(parameters))
        except GmsFlexError as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:  # noqa: B902  anything raised here would kill the executor
            self._node.get_logger().error(f'parameters could not be judged: {error!r}')
            return SetParametersResult(successful=False, reason=f'internal error: {error!r}')
        return SetParametersResult(successful=True)

    def _on_changed(self, parameters):
        values = self._candidate(parameters)
        if values != self.values:
            judged = self._judge(values)
            self.values = values
            self._apply(judged)


def _beside_parameters(name):
    """Return the path of a file that a parameter file names relative to itself, '' without."""
    files = [file for flag, file in pairwise(sys.argv) if flag == '--params-file']
    return next((str(path) for file in reversed(files)
                 if (path := Path(file).absolute().parent / str(name)).is_file()), '')


def _of_topic(node, name):
    """
    Return the path of a copy of the URDF on a topic, which is there while this process lives.

    What does not look like a topic, such as ``/robot_description``, is returned as it is.
    """
    if not name.startswith('/') or Path(name).suffix:
        return name
    subscription = node.create_subscription(String, name, lambda _: None, _LATCHED,
                                            event_callbacks=NO_EVENTS)
    topic, end = subscription.topic_name, time.monotonic() + _PATIENCE
    while (taken := subscription.handle.take_message(String, False)) is None:
        if time.monotonic() > end:
            raise ConfigError(f'arm.urdf: no URDF came on the topic {topic} in {_PATIENCE:g} s; '
                              'start robot_state_publisher, or name a URDF file')
        time.sleep(0.02)
    node.destroy_subscription(subscription)
    folder = Path(mkdtemp(prefix='gms_flex_'))
    atexit.register(rmtree, folder, ignore_errors=True)
    path = folder / f'{Path(topic).name}.urdf'
    path.write_text(taken[0].data, encoding='utf-8')
    node.get_logger().info(f'the URDF of {topic} is taken')
    return str(path)
