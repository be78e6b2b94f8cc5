# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The motion that determines what an identification left open.

D-optimality for some of the parameters (D_s; Atkinson and Donev, Optimum Experimental Designs,
1992): the logarithm of the determinant of the information about those not identified, all others
eliminated with what is known of them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

from gms_flex_control.data.recording import Operation, Recording
from gms_flex_control.design.motions import below_break_away, Candidate, candidates, QUICK
from gms_flex_control.design.plan import clipped, PACES
from gms_flex_control.design.separation import DRAWS, PlannedLoop, stops_within, two_sigma
from gms_flex_control.discrepancy.fitting import informative
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.nuisance import OfRecording, with_nuisances
from gms_flex_control.errors import ConfigError
from gms_flex_control.experiment.identification_plan import plan_identification
from gms_flex_control.experiment.simulated import to_recording
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams, UNCERTAIN
import numpy as np

_OPEN = 'not identifiable', 'doubtful'  # standings of estimates
_DIRECTIONS = 'forward', 'backward'  # rows of friction parameters
_SOFTER = tuple(1.25 ** k for k in range(16))  # parts of the quickest acceleration that are tried
_DETERMINED = 0.3  # relative standard deviation of a parameter that a motion determines
_NOTHING_KNOWN = 1e-4  # prior information, relative, about what was not identified
# experiments of identification_node that measure a kind by itself, in its order
_MEASURED_BY = {'constant_velocity': ('level', 'velocity', 'viscous'), 'break_away': ('static',),
                'presliding': ('blocks',), 'sliding': ('attraction',)}


class MotionWorth(NamedTuple):
    """What one motion is expected to determine."""

    candidate: Candidate | None  # None is the recordings so far
    information: float    # log det of it about the parameters not identified
    sd: np.ndarray        # (K,) relative standard deviations that it leaves


class Experiments(NamedTuple):
    """What identification_node measures of it."""

    values: dict      # its parameters
    duration: float   # about [s]
    measured: tuple   # of (kind, joint)
    refused: str      # why others that would measure more are left out

    def sentence(self) -> str:
        """Return what it does."""
        left_out = self.refused and f'Left out within these limits: {self.refused}.'
        if not self.measured:
            return left_out
        names = [one.replace('_', ' ') for one in self.values['identification.experiments']]
        return (f'{" and ".join(names)} of '
                f'{" and ".join(self.values["identification.joints"])}, about '
                f'{self.duration:.0f} s by identification_node, measure '
                f'{", ".join(in_words(" of ".join(key)) for key in self.measured)}. '
                f'{left_out}'.rstrip())


@dataclass(frozen=True, kw_only=True, eq=False)
class Determination:
    """The motion to be recorded for an identification."""

    missing: tuple        # of str: what was not identified
    experiments: Experiments | None  # that measure some of it, if there are any within limits
    before: MotionWorth         # with the recordings so far
    compared: tuple       # of MotionWorth, the best first
    duration: float       # [s]

    @property
    def best(self) -> MotionWorth:
        """Return the motion chosen."""
        return self.compared[0]

    @property
    def helps(self) -> bool:
        """Return whether motion or experiments determine anything of what is missing."""
        return bool((self.best.sd < _DETERMINED).any()
                    or self.experiments and self.experiments.measured)

    def sentence(self) -> str:
        """Return what to record and what it will determine."""
        known, still_open = [], []
        for name, sd in zip(map(in_words, self.missing), self.best.sd, strict=True):
            if sd < _DETERMINED:
                known.append(f'{name} to {100.0 * sd:.2g} %')
            else:
                still_open.append(name)
        both = [f'determines {", ".join(known)} (standard deviations)'] * bool(known)
        both += [f'leaves {", ".join(still_open)} open'] * bool(still_open)
        return (f'Record {self.duration:.0f} s of {self.best.candidate.words}: it '
                f'{" and ".join(both)}, as far as the model is right.')


def in_words(missing: str) -> str:
    """Return a parameter, such as 'forward level of joint1', as a reader would call it."""
    what, _, joint = missing.partition(' of ')
    *direction, kind = what.split()
    return f'{" ".join([*direction, UNCERTAIN[kind].called])} of {joint}'


def missing_of(report: Mapping) -> list[tuple[str, str]]:
    """Return (kind, joint) that a report.json of ``identify`` calls not identified."""
    found = {}
    estimates = [(one, joint['joint']) for joint in report['joints'] for one in joint['estimates']]
    estimates += [(one, one['name'].split('.')[1]) for one in report.get('others', ())]
    for one, joint in estimates:
        part, *_, last = one['name'].split('.')
        if one['standing'] in _OPEN:
            found |= {(name, joint): None for name, kind in UNCERTAIN.items()
                      if kind.is_left_open(part, last.partition('[')[0])}
    return list(found)


def plan_determination(robot: RobotParams, recordings: Sequence[Recording],
                       missing: Sequence[tuple[str, str]], gains: ControllerParams,
                       limits: Limits, *, period: float, duration: float = 20.0,
                       say: Callable[[str], object] = lambda text: None) -> Determination:
    """
    Choose the motion with most information about what ``identify`` left open.

    ``missing`` is from `missing_of`, ``recordings`` are those so far; ``duration`` is of the
    motion [s], the rest as of `plan_next`. The robot keeps the limits as it is, and two standard
    deviations of the posterior away. ConfigError if nothing is missing that a motion could
    determine, or every motion would cross a limit.
    """
    say('information in the recordings so far')
    so_far = _information(recordings, robot, missing)
    loop = PlannedLoop(clipped(gains, limits), limits, period, (), (robot, *so_far.drawn(robot)),
                       recordings[-1].operation.load)
    experiments = experiments_for(missing, loop.kept, loop.gains, limits)
    found, stuck = [], below_break_away(robot)
    for kind in zip(*(candidates(limits, robot.joints, pace, stuck=stuck) for pace in PACES),
                    strict=True):
        say(kind[0].words)
        one = next((one for one in kind if stops_within(one, robot.joints, duration, limits)
                    and all(loop.keeps(each, robot, one, duration) for each in loop.kept)), None)
        if one is None:
            continue
        plan, run = loop.run(robot, robot, one, duration)
        gained = _information([replace(to_recording(run, plan), operation=Operation(loop.load))],
                              robot, missing)
        found.append(gained._replace(matrix=gained.matrix + so_far.matrix).worth(one))
    if not found:
        raise ConfigError('every motion would cross a limit; widen the limits, or look at gains '
                          'with gms_flex tune')
    found.sort(key=lambda one: -one.information)
    return Determination(missing=tuple(_words(robot, so_far.nuisances[i]) for i in so_far.wanted),
                         experiments=experiments, before=so_far.worth(), compared=tuple(found),
                         duration=duration)


def experiments_for(missing: Sequence[tuple[str, str]], robots: Sequence[RobotParams],
                    gains: ControllerParams, limits: Limits) -> Experiments | None:
    """Return the Experiments that measure what is missing of the first of ``robots``, or None."""
    joints = robots[0].joints

    def measured_by(names):
        kinds = [kind for name in names for kind in _MEASURED_BY[name]]
        return tuple((kind, joint) for kind, joint in missing if joint in joints and kind in kinds)

    wanted = [name for name in _MEASURED_BY if measured_by([name])]
    if not wanted:
        return None
    values = {'identification.joints': [one for one in joints if one in {
        joint for _, joint in measured_by(wanted)}]}
    for j, joint in enumerate(joints):
        values |= {f'identification.{joint}.{name}': float(getattr(limits, name)[j])
                   for name in ('lower', 'upper', 'torque')}
    kept, found = [], None
    # there is no limit of acceleration, but one of torque, and of the room that a speed needs
    for slower, softer in product(PACES, _SOFTER):
        for joint, velocity in zip(joints, limits.velocity, strict=True):
            values |= {f'identification.{joint}.velocity': float(velocity / slower),
                       f'identification.{joint}.acceleration': float(QUICK * velocity / softer)}
        lacking = [name for name in wanted if name not in kept]
        if found and not _within_limits(values, lacking, robots, gains)[0]:
            continue  # no more than before
        plans, refusals = _within_limits(values, wanted, robots, gains)
        if found is None or len(plans) > len(kept):
            kept = list(plans)
            found = Experiments(
                values | {'identification.experiments': kept},
                sum(one.duration() for one in plans.values()), measured_by(kept), refusals)
        if not refusals:
            break
    return found


def _within_limits(values, names, robots, gains):
    """Return a plan of each of the experiments that keeps all limits, and why others do not."""
    plans, refusals = {}, []
    for name in names:
        alone = values | {'identification.experiments': [name]}
        try:
            plans[name] = [plan_identification(alone, one, gains) for one in robots][0]
        except ConfigError as error:
            refusals.append(str(error))
    return plans, '; '.join(refusals)


class _Information(NamedTuple):
    """Information of recordings on relative changes of P parameters, in units of priors."""

    matrix: np.ndarray    # (P, P), without the priors
    nuisances: list       # the parameters
    sd: np.ndarray        # (P,) of the priors
    wanted: dict          # (kind, joint) of those not identified, by index

    def drawn(self, robot) -> list:
        """Return robots two standard deviations away."""
        covariance, rng = np.linalg.inv(
            self.matrix + np.eye(len(self.matrix))), np.random.default_rng(0)
        return [with_nuisances(robot, self.nuisances, self.sd * two_sigma(covariance, rng))
                for _ in range(DRAWS)]

    def worth(self, candidate=None) -> MotionWorth:
        """Return the MotionWorth for what is not identified, others known within their priors."""
        at = list(self.wanted)
        prior = np.ones(len(self.matrix))
        prior[at] = _NOTHING_KNOWN
        covariance = np.linalg.inv(self.matrix + np.diag(prior))[np.ix_(at, at)]
        return MotionWorth(candidate, -float(np.linalg.slogdet(covariance)[1]),
                           np.sqrt(np.diag(covariance)) * self.sd[at])


def _information(recordings, robot, missing):
    """Return the _Information of recordings; ConfigError if of nothing that is missing."""
    likelihood = Likelihood([motion_of(one, robot) for one in recordings], robot)
    own = [k for k, one in enumerate(likelihood.nuisances) if not isinstance(one, OfRecording)]
    keys = [_key(robot, likelihood.nuisances[k]) for k in own]
    wanted = {i: key for i, key in enumerate(keys) if key in missing}
    if not wanted:
        raise ConfigError('no motion determines what was not identified: '
                          + (', '.join(f'{name} of {joint}' for name, joint in missing)
                             or 'all is identified'))
    model = likelihood.fitted(robot, np.zeros(len(likelihood.nuisances)))
    sd = likelihood.sd[own]
    scaled = informative(likelihood, model, likelihood.jacobian(model))[own] * sd[:, None]
    return _Information(scaled @ scaled.T, [likelihood.nuisances[k] for k in own], sd, wanted)


def _key(robot, nuisance):
    """Return (kind, joint) of a nuisance parameter."""
    return nuisance.name, 'arm' if nuisance.joint < 0 else robot.joints[nuisance.joint]


def _words(robot, nuisance):
    """Return a nuisance parameter in words, by direction where it is of one."""
    rows = {index[0] for _, _, index in getattr(nuisance, 'fields', ()) if np.ndim(index)}
    direction = f'{_DIRECTIONS[rows.pop()]} ' if len(rows) == 1 else ''
    return direction + ' of '.join(_key(robot, nuisance))
