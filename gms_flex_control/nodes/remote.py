# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Another node's parameters and services, called without blocking the executor."""

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger


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
