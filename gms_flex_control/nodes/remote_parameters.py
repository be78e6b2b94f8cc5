# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Another node's parameters and Trigger services, without blocking what spins."""

from functools import partial
import math
import threading

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import Trigger

_BOUND = 3.0  # of waiting for an answer [s]
_SERVICES = {ListParameters: 'list_parameters', GetParameters: 'get_parameters',
             DescribeParameters: 'describe_parameters', SetParameters: 'set_parameters'}


class RemoteParameters:
    """
    Clients of the parameter services of one node.

    Parameters
    ----------
    node : rclpy.node.Node
        Which calls.
    name : str
        Full name of the other.
    do : callable
        Takes a callable that the spinning thread is to call soon.

    """

    def __init__(self, node, name, do):
        self._do = do
        self._clients = {kind: node.create_client(kind, f'{name}/{service}')
                         for kind, service in _SERVICES.items()}

    def is_ready(self):
        """Return whether the node answers."""
        return all(client.service_is_ready() for client in self._clients.values())

    def ask_all(self, then):
        """Call ``then`` with all values by name once they are there; only while spinning."""
        if not self.is_ready():
            return

        def with_names(future):
            names = list(future.result().result.names)
            values = self._clients[GetParameters].call_async(GetParameters.Request(names=names))
            values.add_done_callback(partial(with_values, names))

        def with_values(names, future):
            then({name: parameter_value_to_python(value)
                  for name, value in zip(names, future.result().values, strict=True)})

        self._clients[ListParameters].call_async(
            ListParameters.Request()).add_done_callback(with_names)

    def describe(self, prefixes):
        """
        Return the parameters below some prefixes.

        Parameters
        ----------
        prefixes : sequence of str
            Such as ``gains``; a whole name as well.

        Returns
        -------
        list of dict or None
            Name, value, description, lower and upper (None where there is no such end), choices
            and read_only of each, in the order of the node; None if it does not answer in time.

        """
        listed = self._call(ListParameters, ListParameters.Request())
        if listed is None:
            return None
        names = [name for name in listed.result.names if name.split('.')[0] in prefixes]
        values = self._call(GetParameters, GetParameters.Request(names=names))
        described = self._call(DescribeParameters, DescribeParameters.Request(names=names))
        if values is None or described is None:
            return None
        return [_described(name, parameter_value_to_python(value), descriptor)
                for name, value, descriptor in zip(
                    names, values.values, described.descriptors, strict=True)]

    def change(self, name, value):
        """Set one parameter; return accepted, reason and value then, None without an answer."""
        message = Parameter(name, value=value).to_parameter_msg()
        answer = self._call(SetParameters, SetParameters.Request(parameters=[message]))
        now = self._call(GetParameters, GetParameters.Request(names=[name]))
        if answer is None or now is None:
            return None
        result = answer.results[0]
        return {'accepted': result.successful, 'reason': result.reason,
                'value': parameter_value_to_python(now.values[0]) if now.values else None}

    def _call(self, kind, request):
        return _answer(self._clients[kind], request, self._do)


class RemoteTriggers:
    """
    Clients of Trigger services.

    Parameters
    ----------
    node : rclpy.node.Node
        Which calls.
    services : sequence of str
        Their full names.
    do : callable
        As of RemoteParameters.

    """

    def __init__(self, node, services, do):
        self._do = do
        self._clients = {name: node.create_client(Trigger, name) for name in services}

    def call(self, name):
        """Return ``success`` and ``message`` of a service, as a dict; None without an answer."""
        answer = _answer(self._clients[name], Trigger.Request(), self._do)
        return answer and {'success': answer.success, 'message': answer.message}


def _answer(client, request, do):
    """Return the response to a request, None if there is none in time."""
    done, answers = threading.Event(), []

    def finish(future):
        answers.append(future.result())
        done.set()

    def begin():
        if client.service_is_ready():
            client.call_async(request).add_done_callback(finish)
        else:
            done.set()
    do(begin)
    done.wait(_BOUND)
    return answers[0] if answers else None


def _described(name, value, descriptor):
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    lower, upper = (ranges[0].from_value, ranges[0].to_value) if ranges else (None, None)
    choices = []
    if value is not None and descriptor.type == ParameterType.PARAMETER_STRING and \
            descriptor.additional_constraints.startswith('one of '):
        choices = descriptor.additional_constraints.removeprefix('one of ').split(', ')
    return {'name': name, 'value': value, 'description': descriptor.description,
            'lower': _finite(lower), 'upper': _finite(upper), 'choices': choices,
            'read_only': descriptor.read_only}


def _finite(number):
    return number if number is not None and math.isfinite(number) else None


class RemoteNode:
    """
    Clients of one other node.

    Parameters
    ----------
    node : rclpy.node.Node
        Which calls.
    name : str
        Of the other; one without a '/' in front is in the same namespace.
    services : sequence of str
        Its private Trigger services.

    """

    def __init__(self, node, name, services=()):
        self.name = name = node.resolve_service_name(name)
        self._set = node.create_client(SetParametersAtomically,
                                       f'{name}/set_parameters_atomically')
        self._get = node.create_client(GetParameters, f'{name}/get_parameters')
        self._triggers = {service: node.create_client(Trigger, f'{name}/{service}')
                          for service in services}

    def is_ready(self):
        """Return whether all services are there."""
        clients = (self._set, self._get, *self._triggers.values())
        return all(client.service_is_ready() for client in clients)

    def trigger(self, service):
        """Call a Trigger service; return the future of its response."""
        return self._triggers[service].call_async(Trigger.Request())

    def set_parameters(self, values):
        """Set all of ``values`` (dict) or none; return the future of the response."""
        return self._set.call_async(SetParametersAtomically.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]))

    def get_parameters(self, names):
        """Return the future of the values of parameters."""
        return self._get.call_async(GetParameters.Request(names=list(names)))


def value_of(message):
    """Return a ParameterValue as str or float; None for other types."""
    return {ParameterType.PARAMETER_STRING: message.string_value,
            ParameterType.PARAMETER_DOUBLE: message.double_value}.get(message.type)
