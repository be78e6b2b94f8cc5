# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The parameters and services of another node: futures, or answers waited for in a thread."""

from functools import partial
import math
import threading

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.task import Future
from std_srvs.srv import Trigger

_BOUND = 3.0  # of waiting for an answer [s]
_SERVICES = {ListParameters: 'list_parameters', GetParameters: 'get_parameters',
             DescribeParameters: 'describe_parameters',
             SetParametersAtomically: 'set_parameters_atomically'}


class RemoteNode:
    """Clients of another node, whose ``name`` without a '/' in front is in the same namespace."""

    def __init__(self, node, name, triggers=(), do=None):
        self.name = name = node.resolve_service_name(name)
        self._do = do
        kinds = _SERVICES if do else (GetParameters, SetParametersAtomically)
        self._clients = {kind: node.create_client(kind, f'{name}/{_SERVICES[kind]}')
                         for kind in kinds}
        self._triggers = {service: node.create_client(Trigger, f'{name}/{service}')
                          for service in triggers}

    def is_ready(self) -> bool:
        """Return whether all services are there."""
        return all(client.service_is_ready()
                   for client in (*self._clients.values(), *self._triggers.values()))

    def trigger(self, service) -> Future:
        """Call a Trigger service; return the future of its response."""
        return self._triggers[service].call_async(Trigger.Request())

    def set_parameters(self, values) -> Future:
        """Set all of ``values`` (dict) or none; return the future of the response."""
        return self._clients[SetParametersAtomically].call_async(_setting(values))

    def get_parameters(self, names) -> Future:
        """Return the future of the values of parameters, as `values_of` reads them."""
        return self._clients[GetParameters].call_async(GetParameters.Request(names=list(names)))

    def ask_all(self, then) -> None:
        """Call ``then`` with all values by name once they are there; only while spinning."""
        def with_names(future):
            names = list(future.result().result.names)
            self.get_parameters(names).add_done_callback(partial(with_values, names))

        def with_values(names, future):
            then(dict(zip(names, values_of(future.result()), strict=True)))

        self._clients[ListParameters].call_async(
            ListParameters.Request()).add_done_callback(with_names)

    def describe(self, prefixes) -> list | None:
        """Return parameters below some ``prefixes``, dicts, None if there is no answer."""
        listed = self._call(ListParameters, ListParameters.Request())
        if listed is None:
            return None
        names = [name for name in listed.result.names if name.split('.')[0] in prefixes]
        values = self._call(GetParameters, GetParameters.Request(names=names))
        described = self._call(DescribeParameters, DescribeParameters.Request(names=names))
        if values is None or described is None:
            return None
        return [_described(name, value, descriptor) for name, value, descriptor in zip(
            names, values_of(values), described.descriptors, strict=True)]

    def change(self, name, value) -> dict | None:
        """Set one parameter; return accepted, reason and value then, None without an answer."""
        answer = self._call(SetParametersAtomically, _setting({name: value}))
        now = self._call(GetParameters, GetParameters.Request(names=[name]))
        if answer is None or now is None:
            return None
        return {'accepted': answer.result.successful, 'reason': answer.result.reason,
                'value': next(iter(values_of(now)), None)}

    def _call(self, kind, request):
        return answer_of(self._clients[kind], request, self._do)


def answer_of(client, request, do) -> object:
    """Wait for the response to a request; None if it does not come in time."""
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


def values_of(response) -> list:
    """Return what a GetParameters response holds; None for what is not set."""
    return [parameter_value_to_python(value) for value in response.values]


def _setting(values):
    return SetParametersAtomically.Request(parameters=[
        Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])


def _described(name, value, descriptor):
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    bounds = (ranges[0].from_value, ranges[0].to_value) if ranges else (math.inf, math.inf)
    lower, upper = (bound if math.isfinite(bound) else None for bound in bounds)
    choices = []
    if value is not None and descriptor.type == ParameterType.PARAMETER_STRING and \
            descriptor.additional_constraints.startswith('one of '):
        choices = descriptor.additional_constraints.removeprefix('one of ').split(', ')
    return {'name': name, 'value': value, 'description': descriptor.description,
            'lower': lower, 'upper': upper, 'choices': choices, 'read_only': descriptor.read_only}
