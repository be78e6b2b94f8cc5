# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Run a plan as ROS 2 nodes over DDS, recorded into a bag."""

from dataclasses import dataclass
import os
from pathlib import Path
import random
import re

from gms_flex_control.bags.reader import read_recording
from gms_flex_control.experiment.processes import executable, Processes, ros_arguments

TOPICS = ('/joint_states', '/effort_controller/commands', '/reference',
          '/cascade_controller/state')
_LISTENERS = 3        # controller, trajectory and recorder or identification
_SLOWEST_STEPS = 100  # simulated samples per second on the slowest machine we wait for
_PROGRESS = re.compile(r'\[identification\]: +(\d+ %, .*)')
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
    plant : Path, optional
        Robot file of the plant alone; default the robot of ``files``.

    """

    files: tuple
    model: Path
    compensation: str
    duration: float
    rate: float
    plant: Path = None


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
    plant_files = plan.files if plan.plant is None else [*plan.files, plan.plant]
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
                                  *ros_arguments(plant_files, timing)])
        processes.wait('plant', bound)
        for name in ('trajectory', 'controller', 'recorder'):
            processes.stop(name)


def drive_recorded(plan, bag, *, log):
    """
    Run a plan as `drive` does and read what it recorded.

    Parameters
    ----------
    plan, bag, log
        As of `drive`; the folder of ``bag`` is made, and what the processes print goes to a
        folder of its name in ``log``.

    Returns
    -------
    Recording

    """
    bag.parent.mkdir(parents=True, exist_ok=True)
    drive(plan, bag, log=log / bag.name)
    return read_recording(bag)


@dataclass(frozen=True, kw_only=True)
class DrivenIdentification:
    """
    One identification experiment over DDS in lockstep.

    Parameters
    ----------
    files : tuple of Path
        Robot as it is, and controller parameters.
    model : Path
        Robot file that controller and experiment believe in.
    plan : Path
        Parameters of the experiment, such as ``config/identification.yaml``.
    duration : float
        Expected simulated length [s].
    rate : float
        Joint states per simulated second [Hz].

    """

    files: tuple
    model: Path
    plan: Path
    duration: float
    rate: float


def drive_identification(experiment, bag, *, log, say=print):
    """
    Run plant, controller, trajectory and identification node until the experiment is over.

    Parameters
    ----------
    experiment : DrivenIdentification
        What to run.
    bag : Path
        Where the recording goes.
    log : Path
        Folder for what the processes print.
    say : callable, optional
        Called with a line of progress for each step.

    Raises
    ------
    ProcessError
        If a process fails or does not end in time.

    """
    mode = {'mode': 'lockstep'}
    believed = [*experiment.files, experiment.model]
    bound = _START_BOUND + experiment.duration * experiment.rate / _SLOWEST_STEPS
    said = 0
    with Processes(private_environment(), log) as processes:
        def tell():
            nonlocal said
            lines = _PROGRESS.findall(processes.printed('identification'))
            for line in lines[said:]:
                say(line)
            said = len(lines)

        processes.start('controller', [*executable('controller_node'),
                                       *ros_arguments(believed, mode)])
        processes.start('trajectory', [*executable('trajectory_node'),
                                       *ros_arguments(experiment.files, mode)])
        processes.start('identification', [
            *executable('identification_node'), *ros_arguments(
                [*believed, experiment.plan],
                {**mode, 'identification.bag': bag, 'identification.fit': False})])
        processes.start('plant', [*executable('plant_node'), *ros_arguments(
            experiment.files, {**mode, 'rate': experiment.rate,
                               'wait_for_subscribers': _LISTENERS})])
        processes.wait('identification', bound, tell)
        for name in ('plant', 'trajectory', 'controller'):
            processes.stop(name)
