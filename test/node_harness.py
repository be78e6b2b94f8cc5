# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Real node processes on a ROS domain of their own, and a node in the test that talks to them."""

from functools import cache
from pathlib import Path
import signal

from gms_flex_control.control.cascade import SteppedController
from gms_flex_control.schema.files import load_controller, load_robot
from gms_flex_control.simulation.loop import SteppedPlant
from gms_flex_control.trajectory import builders
import numpy as np
from processes import environment_of
import pytest

rclpy = pytest.importorskip('rclpy')
EventsExecutor = pytest.importorskip('rclpy.experimental').EventsExecutor
interfaces = pytest.importorskip('rcl_interfaces.msg')
services = pytest.importorskip('rcl_interfaces.srv')
JointState = pytest.importorskip('sensor_msgs.msg').JointState
Float64MultiArray = pytest.importorskip('std_msgs.msg').Float64MultiArray
Trigger = pytest.importorskip('std_srvs.srv').Trigger
bench = pytest.importorskip('bench.faults.node_bench')
wire = pytest.importorskip('bench.faults.wire')
JOINTS, NAMES = wire.JOINTS, wire.NAMES
array_message, joint_state, stamp_of = wire.array_message, wire.joint_state, wire.stamp_of
COMMANDS, STATES, REFERENCE = bench.COMMANDS, bench.STATES, bench.REFERENCE
PATIENCE, DISCOVERY, take_domain = bench.PATIENCE, bench.DISCOVERY, bench.take_domain

CONFIG = Path(__file__).parents[1] / 'config'
FILES = (CONFIG / 'robot.yaml', CONFIG / 'controller.yaml')
MOTION = [*FILES, CONFIG / 'sinusoid.yaml']
TOPICS = {'states': (JointState, STATES), 'commands': (Float64MultiArray, COMMANDS),
          'references': (Float64MultiArray, REFERENCE)}
PARAMETER = interfaces.ParameterType
INT, TERM = signal.SIGINT, signal.SIGTERM


def write_parameters(path, text):
    """Write YAML ``text`` as the parameters of all nodes; return the path."""
    indented = ''.join(f'    {line}\n' for line in text.splitlines())
    path.write_text(f'/**:\n  ros__parameters:\n{indented}')
    return path


@cache
def compile_the_loop(robot_file=FILES[0], gains_file=FILES[1]):
    """Compile in this process what the nodes run, so that no test waits for that in vain."""
    robot = load_robot(robot_file)
    plant = SteppedPlant(robot, period=2e-3, substeps=20)
    plant.measure()
    plant.advance(SteppedController(load_controller(gains_file, robot), robot).tick(
        builders.sinusoid(np.ones(robot.n_joints), 6.0).sample(0.0), 2e-3))


class Lab(bench.Bench):
    """A bench whose processes take the package from this source tree."""

    executor_class = staticmethod(EventsExecutor)
    tracebacks = 0  # that a process may print, at most

    def __enter__(self):
        compile_the_loop()
        super().__enter__()
        self.environment['PYTHONPATH'] = environment_of()['PYTHONPATH']
        return self

    def __exit__(self, kind, *rest):
        super().__exit__(kind, *rest)
        if kind is None:
            for process in self._processes:
                printed = process.printed()
                assert printed.count('Traceback') <= self.tracebacks, printed

    def hear(self, *names):
        """Return a list that takes the states, commands or references of the loop, of each."""
        heard = [self.listen(*TOPICS[name]) for name in names]
        return heard if len(names) > 1 else heard[0]

    def say(self, name):
        """Return a publisher of states, commands or references of the loop."""
        return self.speak(*TOPICS[name])

    def set_parameters(self, node, *, together=False, **parameters):
        """
        Set parameters as ``ros2 param set`` does, '__' in a name for '.'.

        Return a SetParametersResult for each; a single one if there is one or they are set
        ``together``.
        """
        messages = [wire.as_parameter(name, value) for name, value in parameters.items()]
        if together:
            kind = services.SetParametersAtomically
            return self.call(kind, f'{node}/set_parameters_atomically',
                             kind.Request(parameters=messages)).result
        kind = services.SetParameters
        results = self.call(kind, f'{node}/set_parameters', kind.Request(parameters=messages))
        return results.results[0] if len(messages) == 1 else results.results

    def get(self, node, name):
        """Return the value of one parameter; None if there is no such."""
        kind = services.GetParameters
        values = self.call(kind, f'{node}/get_parameters', kind.Request(names=[name])).values
        if not values:
            return None
        value = values[0]
        return {PARAMETER.PARAMETER_DOUBLE: value.double_value,
                PARAMETER.PARAMETER_STRING: value.string_value,
                PARAMETER.PARAMETER_INTEGER: value.integer_value}.get(value.type)
