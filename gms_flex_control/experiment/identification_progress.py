# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What an identification experiment keeps as it goes: finished steps, and torques found."""

import json
from pathlib import Path
import shutil

from gms_flex_control.errors import BagError, GmsFlexError
from gms_flex_control.experiment.identification_steps import Step
from gms_flex_control.file_io import write_text

_LEAST, _MOST = 0.2, 3.0  # of what was planned
LEAVING = 0.2  # of the travel that ends a break-away step: there it begins
_CAUTION = 0.85    # the torque found is late by what inertia takes, and differs each time


class ExperimentError(GmsFlexError):
    """An experiment cannot begin or go on."""


class Journal:
    """
    The finished steps of one plan and what later ones need of them, kept on disk.

    It is ``<bag>.journal.json`` beside the first bag of the experiment. ExperimentError if there
    is one and it is not to be resumed, none to resume, or one of another plan.
    """

    def __init__(self, bag, plan, *, resume=False):
        self._bag, self._plan = Path(bag), plan
        self.path = self._bag.with_name(f'{self._bag.name}.journal.json')
        self.finished, self.bags, self.found = [], [], {}
        if resume:
            self._read()
        elif self.path.exists() or self._bag.exists():
            raise ExperimentError(
                f'{self._bag}: has been recorded already; set identification.resume to true to '
                'go on with what is unfinished, or name another identification.bag')

    def _read(self):
        try:
            content = json.loads(self.path.read_text(encoding='utf-8'))
            fingerprint = content['plan']
            self.finished, self.bags = list(content['finished']), list(content['bags'])
            self.found = {joint: float(torque) for joint, torque in content['found'].items()}
        except OSError as error:
            raise ExperimentError(f'{self.path}: cannot be read ({error.strerror}), so there is '
                                  'nothing to resume; set identification.resume to false '
                                  'to begin') from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ExperimentError(f'{self.path}: is no journal of an experiment; name another '
                                  'identification.bag and begin anew') from error
        if fingerprint != self._plan.fingerprint():
            raise ExperimentError(f'{self.path}: belongs to another plan; resume with the '
                                  'parameters it began with, or name another identification.bag')

    def next_bag(self) -> Path:
        """Return the name of a bag that does not exist yet (Path), and note it."""
        number, path = 1, self._bag
        while path.exists():
            number += 1
            path = self._bag.with_name(f'{self._bag.name}_{number}')
        self.bags.append(path.name)
        self._write()
        return path

    def finish(self, step) -> None:
        """Note that ``step`` (str) is finished."""
        self.finished.append(step)
        self._write()

    def _write(self):
        try:
            write_text(self.path, json.dumps({
                'plan': self._plan.fingerprint(), 'bags': self.bags,
                'steps': len(self._plan.experiments), 'finished': self.finished,
                'found': self.found}, indent=1))
        except OSError as error:
            raise BagError(f'{self.path}: cannot be written ({error.strerror})') from error


def require_space(folder, needed) -> None:
    """Raise ExperimentError if the disk of ``folder`` has less than ``needed`` bytes and 10 %."""
    folder = Path(folder).resolve()
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free < 1.1 * needed:
        raise ExperimentError(f'{folder}: has {free / 1e6:.0f} MB free and the recording needs '
                              f'about {needed / 1e6:.0f} MB; make room or name another '
                              'identification.bag')


class Adaptation:
    """
    What the break-away steps have found, and what follows for presliding.

    ``found`` is the least torque at break-away by joint [N m]; changed in place.
    """

    def __init__(self, plan, found=None):
        self._plan, self.found = plan, {} if found is None else found

    def broke_away(self, step, time) -> float:
        """
        Note that a break-away step ended; return its torque then, without gravity's [N m].

        ``time`` from the step's beginning is when the joint had not yet moved by `LEAVING` of the
        step's travel [s].
        """
        j = self._plan.joints.index(step.joint)
        bias = step.trajectory_parameters[f'trajectory.{step.joint}.bias']
        trajectory = self._plan.trajectory(step)
        top_time = 0.5 * trajectory.end  # it rises, then falls
        torque = abs(trajectory.sample(min(time, top_time))[0, j] - bias)
        self.found[step.joint] = min(float(torque), self.found.get(step.joint, float(torque)))
        return torque

    def applied_to(self, step) -> Step:
        """
        Return a Step as it is to be carried out.

        Of presliding the levels are scaled by found over expected break-away torque, within the
        joint's torque limit; any other step is unchanged.
        """
        if step.phase != 'presliding' or step.joint not in self.found:
            return step
        j = self._plan.joints.index(step.joint)
        factor = _CAUTION * self.found[step.joint] / self._plan.static[j]
        factor = min(max(factor, _LEAST), _MOST)
        name = f'trajectory.{step.joint}.levels'
        bias = abs(step.trajectory_parameters[f'trajectory.{step.joint}.bias'])
        factor = min(factor, (self._plan.torque[j] - bias) / step.value)
        levels = [factor * level for level in step.trajectory_parameters[name]]
        return step._replace(trajectory_parameters=step.trajectory_parameters | {name: levels},
                             value=factor * step.value)
