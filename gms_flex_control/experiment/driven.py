# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Run a plan as three ROS 2 nodes over DDS, recorded into a bag."""

from dataclasses import dataclass
import os
from pathlib import Path
import random

from gms_flex_control.experiment.processes import executable, Processes, ros_arguments

TOPICS = ('/joint_states', '/effort_controller/commands', '/reference',
          '/cascade_controller/state')
_LISTENERS = 3        # controller, trajectory and recorder
_SLOWEST_STEPS = 100  # simulated samples per second on the slowest machine we wait for
_START_BOUND = 120.0  # for processes to start, compiling included [s]


@dataclass(frozen=True, kw_only=True)
class DrivenPlan:
    """
    One experiment over DDS in lockstep.

    Parameters
    ----------
    files : tuple of Path
        Robot, controller and trajectory parameters.
    model : Path
        Robot file the controller believes in.
    compensation : str
        Mode of the controller.
    duration : float
        Simulated length [s].
    rate : float
        Joint states per simulated second [Hz].

    """

    files: tuple
    model: Path
    compensation: str
    duration: float
    rate: float


def private_environment():
    """Return this environment with a ROS domain of its own on this machine alone."""
    # ids up to 101 keep the ports below Linux's ephemeral range
    domain = os.environ.get('ROS_DOMAIN_ID') or str(random.SystemRandom().randint(1, 101))
    return {**os.environ, 'ROS_DOMAIN_ID': domain,
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'PYTHONUNBUFFERED': '1'}


def drive(plan, bag, *, log):
    """
    Run plant, controller, trajectory and recorder until the simulated time is over.

    Parameters
    ----------
    plan : DrivenPlan
        What to run.
    bag : Path
        Where the recording goes.
    log : Path
        Folder for what the processes print.

    Raises
    ------
    ProcessError
        If a process fails or does not end in time.

    """
    mode = {'mode': 'lockstep'}
    trajectory = {**mode, 'trajectory.autostart': True}
    controller_files = [*plan.files, plan.model]  # the model last: what the controller believes
    timing = {**mode, 'rate': plan.rate, 'duration': plan.duration,
              'wait_for_subscribers': _LISTENERS}
    bound = _START_BOUND + plan.duration * plan.rate / _SLOWEST_STEPS
    with Processes(private_environment(), log) as processes:
        processes.start('recorder', [*executable('gms_flex'), 'record', '--topics', *TOPICS,
                                     '--out', str(bag)])
        processes.start('controller', [*executable('controller_node'), *ros_arguments(
            controller_files, {**mode, 'compensation': plan.compensation})])
        processes.start('trajectory', [*executable('trajectory_node'),
                                       *ros_arguments(plan.files, trajectory)])
        # the recorder must hear the first answer, and that comes right after the first state
        processes.wait_for_text('recorder', [f'subscribed to {topic} ' for topic in TOPICS[1:]],
                                _START_BOUND)
        processes.start('plant', [*executable('plant_node'),
                                  *ros_arguments(plan.files, timing)])
        processes.wait('plant', bound)
        for name in ('trajectory', 'controller', 'recorder'):
            processes.stop(name)
