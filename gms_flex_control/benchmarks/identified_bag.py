# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Time and memory of `gms_flex identify` on a bag of ten minutes at 1 kHz."""

from importlib.util import find_spec
import os
from pathlib import Path
import subprocess
import tempfile
from time import perf_counter

from gms_flex_control.bags.experiment import write_recording
from gms_flex_control.benchmarks.timing import Measurement
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.experiment.identification_plan import read_identification_plan
from gms_flex_control.experiment.identification_simulated import simulate_identification
from gms_flex_control.experiment.processes import executable
from gms_flex_control.resources import share_path
from gms_flex_control.schema.files import save_robot

_TEN_MINUTES = {'identification.speeds': 8, 'identification.repeats': 2,
                'identification.break_away_repeats': 2, 'identification.presliding_places': 2}
_SHORT = {'identification.speeds': 3, 'identification.repeats': 1,
          'identification.break_away_repeats': 1, 'identification.presliding_places': 1}
_TIME, _MEMORY = 60.0, 1.0  # targets [s, GB] for ten minutes


def measure(robot, gains, quick=False):
    """
    Identify a simulated bag by the command in a process of its own.

    Parameters
    ----------
    robot, gains : RobotParams, ControllerParams
        The robot and its controller.
    quick : bool
        A short bag, without targets.

    Returns
    -------
    list of Measurement
        Empty where the command does not exist.

    """
    if find_spec('gms_flex_control.cli.identify') is None:
        return []
    plan = read_identification_plan([share_path() / 'config' / 'identification.yaml'], robot,
                                    gains, overrides=_SHORT if quick else _TEN_MINUTES)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / 'bag'
        recording, phases = simulate_identification(plan, robot, gains, 1, rate=1000)
        write_recording(bag, recording, robot.motors, phases=phases)
        note = f'{recording.time[-1]:.0f} s at 1 kHz, {robot.n_joints} joints'
        del recording
        save_robot(robot, Path(folder) / 'robot.yaml')
        seconds, processor, memory = identified(bag, Path(folder))
    return [Measurement(suite='identify', name='identify a bag', value=seconds, unit='s',
                        target=None if quick else _TIME, at_least=False, note=note),
            Measurement(suite='identify', name='identify a bag, processor time of two cores',
                        value=0.5 * processor, unit='s', target=None if quick else _TIME,
                        at_least=False, note='what it takes where nothing else runs'),
            Measurement(suite='identify', name='identify a bag, peak memory',
                        value=memory / 1e9, unit='GB', target=_MEMORY, at_least=False)]


def identified(bag, folder):
    """
    Run the command on a bag.

    Parameters
    ----------
    bag : Path
        The bag.
    folder : Path
        With robot.yaml; results go to ``out`` in it.

    Returns
    -------
    seconds, processor, memory : float
        Wall time [s], processor time of all threads [s], and the largest resident memory [bytes]
        (Linux).

    Raises
    ------
    GmsFlexError
        If the command fails.

    """
    command = [*executable('gms_flex'), 'identify', str(bag), '--robot',
               str(folder / 'robot.yaml'), '--out', str(folder / 'out')]
    begin = perf_counter()
    with open(folder / 'log.txt', 'w', encoding='utf-8') as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)  # the usage of this child alone
        process.returncode = os.waitstatus_to_exitcode(status)
    seconds = perf_counter() - begin
    if process.returncode != 0:
        text = (folder / 'log.txt').read_text(encoding='utf-8').strip()
        raise GmsFlexError(f'gms_flex identify ended with {process.returncode}: '
                           f'{text.splitlines()[-1] if text else "no output"}')
    return seconds, usage.ru_utime + usage.ru_stime, 1024.0 * usage.ru_maxrss
