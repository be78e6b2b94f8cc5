# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""As much of the command ``ros2`` as the tutorials use: it is on no registry."""

from importlib import import_module, util
import signal
import subprocess
import sys

from gms_flex_control.experiment.driven import module_of
import launch_stand_in

PACKAGE = 'gms_flex_control'


def run(package, executable, *words):
    """Do ``ros2 run``: return the exit code of the node."""
    assert package == PACKAGE
    return ended([subprocess.Popen([*module_of(executable), *words])])


def ended(processes):
    """Wait for processes, which a Ctrl-C reaches as well; return the first bad exit code, or 0."""
    signal.signal(signal.SIGINT, lambda *_: None)
    return next((code for code in [process.wait() for process in processes] if code), 0)


def launch(package, file, *given):
    """Do ``ros2 launch``: start what the launch file says with its arguments, wait for all."""
    assert package == PACKAGE
    sys.modules.update(launch_stand_in.modules())
    spec = util.spec_from_file_location('launched', launch_stand_in.ROOT / 'launch' / file)
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = launch_stand_in.started(module.generate_launch_description(),
                                    dict(word.split(':=', 1) for word in given))
    return ended([subprocess.Popen([*module_of(one.executable), *one.words, *_ros_words(one)])
                  for one in found])


def _ros_words(started):
    if not started.parameters:  # no node
        return []
    words = ['--ros-args', '-r', f'__ns:=/{started.namespace}'] if started.namespace else [
        '--ros-args']
    for file in started.files:
        words += ['--params-file', file]
    return [*words, *(word for name, value in started.parameters.items()
                      for word in ('-p', f'{name}:={value}'))]


def call_service(name, kind):
    """Do ``ros2 service call`` with an empty request."""
    import rclpy
    package, _, kind = kind.split('/')
    service = getattr(import_module(f'{package}.srv'), kind)
    node = rclpy.create_node('_ros2cli_requester')
    client = node.create_client(service, name)
    if not client.service_is_ready():
        print('waiting for service to become available...')
        client.wait_for_service()
    print(f'requester: making request: {service.Request()!r}\n')
    future = client.call_async(service.Request())
    rclpy.spin_until_future_complete(node, future)
    print(f'response:\n{future.result()!r}\n')
    return 0


def set_parameter(name, parameter, value):
    """Do ``ros2 param set``; a refusal is reported, and no error of the command."""
    from rcl_interfaces.msg import Parameter
    import rclpy
    from rclpy.parameter import get_parameter_value
    from rclpy.parameter_client import AsyncParameterClient
    node = rclpy.create_node('_ros2cli_param')
    client = AsyncParameterClient(node, name)
    if not client.wait_for_services(timeout_sec=1.0):
        print('Node not found', file=sys.stderr)
        return 1
    future = client.set_parameters([Parameter(name=parameter, value=get_parameter_value(value))])
    rclpy.spin_until_future_complete(node, future)
    result, = future.result().results
    begin = 'Set parameter successful' if result.successful else 'Setting parameter failed'
    print(f'{begin}: {result.reason}' if result.reason else begin,
          file=sys.stdout if result.successful else sys.stderr)
    return 0


def main(words):
    """Do what the words say and return the exit code."""
    if words == ['daemon', 'stop']:
        print('The daemon is not running')
        return 0
    if words[0] in ('run', 'launch'):
        return {'run': run, 'launch': launch}[words[0]](*words[1:])
    import rclpy
    verbs = {('service', 'call'): call_service, ('param', 'set'): set_parameter}
    rclpy.init()
    try:
        return verbs[tuple(words[:2])](*words[2:])
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
