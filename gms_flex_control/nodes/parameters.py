# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Node parameters from the schema: declared, coerced, judged, applied."""

from gms_flex_control.errors import ConfigError, GmsFlexError
from gms_flex_control.schema import build
from gms_flex_control.schema.key import REQUIRED
from gms_flex_control.schema.values import checked, known_keys
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.parameter import Parameter

_BUILT_IN = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
_LARGEST_RANGE = 1e300


def _descriptor(key):
    choices = f"one of {', '.join(key.choices)}" if key.choices else ''
    unit = f' [{key.unit}]' if key.unit else ''
    descriptor = ParameterDescriptor(  # rqt_reconfigure shows the description alone
        description=f'{key.description}{unit}{f": {choices}" if choices else ""}',
        additional_constraints=choices, read_only=not key.live)
    if key.kind == 'double' and max(abs(key.lower), abs(key.upper)) < _LARGEST_RANGE:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=key.lower, to_value=key.upper)]
    if key.kind == 'integer' and max(abs(key.lower), abs(key.upper)) < _LARGEST_RANGE:
        descriptor.integer_range = [
            IntegerRange(from_value=int(key.lower), to_value=int(key.upper), step=1)]
    return descriptor


class NodeParameters:
    """
    The parameters of one node.

    Parameters
    ----------
    node : rclpy.node.Node
        Created with ``automatically_declare_parameters_from_overrides=True``.
    own_keys : callable
        Joint names -> keys this node uses; keys of the other nodes may stand in the same file.

    Raises
    ------
    ConfigError
        If a file gave an unknown key, a wrong type or range, or lacks a required key.

    """

    def __init__(self, node, own_keys):
        self._node = node
        given = {name: parameter.value
                 for name, parameter in node.get_parameters_by_prefix('').items()
                 if not name.startswith(_BUILT_IN)}
        self.joints = build.joint_names(given)
        known = known_keys(given, self.joints)
        self._keys = {key.name: key for key in own_keys(self.joints)}
        if 'motors' in self._keys:
            self._keys |= {name: key for name, key in known.items()
                           if name.startswith('effects.')}
        self.values = {name: self._value(key, given) for name, key in self._keys.items()}
        for name in given:
            node.undeclare_parameter(name)
        for name, key in self._keys.items():
            node.declare_parameter(name, _ros_value(key, self.values[name]), _descriptor(key),
                                   ignore_override=True)
        self._apply = None

    @staticmethod
    def _value(key, given):
        if key.name in given:
            return checked(key, given[key.name])
        if key.default is REQUIRED:
            raise ConfigError(f'parameter {key.name} is missing ({key.description}); give it in '
                              'a file after --ros-args --params-file')
        return key.default

    def watch(self, judge, apply, guard=lambda callback: callback):
        """
        Let live parameters change while the node runs.

        Parameters
        ----------
        judge : callable
            Flat values -> object; raises GmsFlexError with the reason to refuse.
        apply : callable
            Gets what ``judge`` returned once the change is accepted.
        guard : callable, optional
            Wraps the callbacks, see Health.guard; one that raises would kill the executor.

        """
        self._judge, self._apply = judge, apply
        self._node.add_pre_set_parameters_callback(guard(self._coerce))
        self._node.add_on_set_parameters_callback(self._on_set)
        self._node.add_post_set_parameters_callback(guard(self._on_changed))

    def _coerce(self, parameters):
        return [self._as_double(parameter) for parameter in parameters]

    def _as_double(self, parameter):
        key = self._keys.get(parameter.name)
        if key is not None and parameter.type_ == Parameter.Type.INTEGER and key.kind == 'double':
            return Parameter(parameter.name, Parameter.Type.DOUBLE, float(parameter.value))
        if (key is not None and parameter.type_ == Parameter.Type.INTEGER_ARRAY
                and key.kind == 'double_array'):
            return Parameter(parameter.name, Parameter.Type.DOUBLE_ARRAY,
                             [float(item) for item in parameter.value])
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


def _ros_value(key, value):
    return list(value) if key.kind.endswith('_array') else value
