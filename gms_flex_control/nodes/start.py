# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The nodes as executables: quiet at Ctrl-C while they are imported, and --help."""

from functools import partial
import gc
from importlib import import_module
import os
import signal
import sys

from gms_flex_control.errors import GmsFlexError

_HELP = """{summary}

usage: ros2 run gms_flex_control {name} --ros-args --params-file ROBOT.yaml [ARGUMENT ...]

The joints, and all else that this node needs to know, are parameters. Examples are in
$(ros2 pkg prefix --share gms_flex_control)/config; every --params-file may add to those before,
-p NAME:=VALUE sets one. 'ros2 param describe' says what a parameter means once the node runs,
'ros2 launch gms_flex_control closed_loop.launch.py --show-args' how to start all nodes at once."""


# the class of each node; one module a node, of the same name as its executable
_CLASSES = {'controller_node': 'ControllerNode', 'identification_node': 'IdentificationNode',
            'loop_node': 'LoopNode', 'plant_node': 'PlantNode',
            'trajectory_node': 'TrajectoryNode'}
# one works a whole sample ahead: the answer to the state goes first; the other works through most
# of a sample, and hands over to whoever waits where a slice is used up
_LATER = ('trajectory_node', 'loop_node')


def run(name) -> int:
    """Run a node until a signal comes; return its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):  # `run_node` has handlers of its own later
        signal.signal(number, lambda *_: os._exit(0))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])  # as launch_parts starts it
    gc.disable()  # of what libraries make on import nothing goes
    try:
        module = import_module(f'gms_flex_control.nodes.{name}')
        process, scheduling = (import_module(f'gms_flex_control.nodes.{part}')
                               for part in ('process', 'scheduling'))
    except GmsFlexError as error:  # of what is not installed
        print(f'{name}: {error}', file=sys.stderr)
        return 2
    gc.freeze()
    gc.enable()
    if sys.argv[1:2] in (['-h'], ['--help']):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `head` takes no more
        print(_HELP.format(name=name, summary=module.__doc__.strip()))
        return 0
    return process.run_node(getattr(module, _CLASSES[name]),
                            scheduling.LATER if name in _LATER else scheduling.SHORT)


# the entry points of setup.py: without arguments each returns its exit code
controller_node, identification_node, loop_node, plant_node, trajectory_node = (
    partial(run, name) for name in _CLASSES)

if __name__ == '__main__':
    del sys.argv[0]
    sys.exit(run(sys.argv[0]))
