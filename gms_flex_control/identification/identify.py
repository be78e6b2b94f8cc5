# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""From recordings to friction parameters, their intervals and errors: the whole way."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
import time
import warnings

from gms_flex_control.errors import IdentificationError, own_warnings
from gms_flex_control.friction.stribeck import steady_friction
from gms_flex_control.identification import default_method
from gms_flex_control.identification import held_out as errors
from gms_flex_control.identification.arm_estimates import arm_estimates
from gms_flex_control.identification.arm_fit import estimate_arm, folded
from gms_flex_control.identification.axis_ripple import ripple_sentences
from gms_flex_control.identification.checks import require
from gms_flex_control.identification.coordinates import friction_record, MOST_BLOCKS
from gms_flex_control.identification.coupling import coupling_sentences
from gms_flex_control.identification.fit_choice import choose_fit, simple_theta
from gms_flex_control.identification.known_effects import believed_model, cleared
from gms_flex_control.identification.loops import loops_of, presliding_reach
from gms_flex_control.identification.objective import Bundle, Objective, observer_bandwidth
from gms_flex_control.identification.paper_fit import NOT_HELD_OUT, paper_fits
from gms_flex_control.identification.result import Candidate, Identification, JointResult
from gms_flex_control.identification.start import start_of
from gms_flex_control.identification.steady import friction_map, repeatability
from gms_flex_control.identification.stretches import (
    drive_sides,
    half_count,
    one_by_one,
    rigid_where,
    stretches_of,
)
from gms_flex_control.identification.uncertainty import (
    curve_of,
    estimates_of,
    shown_displacements,
    spread_of,
)
from gms_flex_control.params.friction import FrictionParams, StribeckParams
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.simulation.predictor import PER_DIRECTION, STATIC
import numpy as np

_SAME_PERIOD = 0.01   # relative difference of sample periods of recordings fitted together
_CURVE_POINTS = 80
_VELOCITIES = 200


@dataclass(frozen=True, kw_only=True)
class Options:
    """
    How to identify.

    Parameters
    ----------
    method : {'default', 'paper'}
        All parameters together through the predictor, or as in section 4 of the paper.
    estimate : {'friction', 'all'}
        Whether inertia, gravity, stiffness and motor inertia are estimated as well.
    blocks : tuple of int
        Numbers of blocks to try.
    force : bool
        Go on in spite of faults in the data.

    """

    method: str = 'default'
    estimate: str = 'friction'
    blocks: tuple = default_method.CANDIDATES
    force: bool = False


def identify(takes: Sequence, robot: RobotParams, *, holdouts: Sequence = (),
             options: Options | None = None,
             say: Callable[[str], object] | None = None) -> Identification:
    """
    Identify the friction of a robot.

    Parameters
    ----------
    takes : sequence of Recording or (Recording, sequence of Phase)
        What was recorded, and what the experiment was doing if that is known.
    robot : RobotParams
        The robot as described; its inertia, stiffness and gravity are relied on, its friction
        is not.
    holdouts : sequence of Recording or (Recording, sequence of Phase)
        Recordings to predict only; by default blocks of time are held out.
    options : Options, optional
        How.
    say : callable, optional
        Told what is being done.

    Returns
    -------
    Identification

    Raises
    ------
    IdentificationError
        If the data cannot tell the friction, or would tell it wrongly; the sentence says why.

    """
    begin, options, say = time.monotonic(), options or Options(), say or (lambda text: None)
    takes, holdouts = ([one if isinstance(one, tuple) else (one, ()) for one in several]
                       for several in (takes, holdouts))
    with own_warnings() as caught:
        say('checking the data')
        whole = options.estimate == 'all'
        if whole and robot.arm.frames:
            raise IdentificationError(
                '--estimate all knows planar chains and single axes; of arm.kind urdf friction is '
                'identified, its links as the URDF has them: leave --estimate all out')
        model = believed_model(robot, whole, options.force)
        for recording, _ in (*takes, *holdouts):
            for finding in require(recording, model, force=options.force, rough=whole):
                if finding.kind != 'torque_scale' or not whole:
                    warnings.warn(finding.text, stacklevel=2)
        data = Data(takes, holdouts, model, whole)
        fits = data.fit(options, say)
        say('intervals and errors on data held out')
        joints, arm = data.results(fits)
    thetas = [fit.coordinates.unpack(fit.free)[0] for fit in fits]
    return Identification(
        method=options.method,
        robot=replace(arm if whole else robot, friction=friction_params(thetas, fits)),
        believed=robot,
        joints=joints, sources=tuple(take.source for take, _ in takes),
        holdouts=tuple(take.source for take, _ in holdouts),
        duration=float(sum(take.time[-1] - take.time[0] for take, _ in takes)),
        period=data.bundle.period,
        warnings=tuple(dict.fromkeys(str(item.message) for item in caught)),
        seconds=time.monotonic() - begin)


class Data:
    """
    Recordings of one robot, cut into stretches.

    Parameters
    ----------
    takes, holdouts
        As `identify`.
    robot : RobotParams
        From known_effects.believed_model.
    whole : bool
        Whether inertia, gravity, stiffness and motor inertia are estimated as well.

    """

    def __init__(self, takes, holdouts, robot, whole=False):
        half = half_count(takes[0][0].of_joints(robot.joints), robot)  # of readings as they are
        ordered = [[cleared(take.of_joints(robot.joints), robot), phases]
                   for take, phases in (*takes, *holdouts)]
        period = common_period([take for take, _ in ordered])
        first = ordered[0][0]
        self.arm_fit = estimate_arm([take for take, _ in ordered[:len(takes)]],
                                    robot) if whole else None
        robot = self.arm_fit.robot if whole else robot
        self.described, self.sides = robot, drive_sides(first, robot)
        self.robot = rigid_where(robot, self.sides)
        pieces = [stretches_of(take, robot, self.sides, phases, period)
                  for take, phases in ordered]
        pieces, self.robot = one_by_one(pieces, self.robot)
        if whole:
            pieces = [[without(piece, self.arm_fit.constant) for piece in part]
                      for part in pieces]
        self._fitted = default_method.numbered(
            [piece for part in pieces[:len(takes)] for piece in part], period)
        self._apart = [piece for part in pieces[len(takes):] for piece in part]
        self._phases = [phase for _, phase in takes]
        self.step = np.array([resolution(self._fitted, j, 2.0 * half[j])
                              for j in range(robot.n_joints)])
        self.maps = [friction_map(self._fitted, self.robot.arm, j, period, half[j])
                     for j in range(robot.n_joints)]
        self.starts = [start_of(self.maps[j], travel(self._fitted, j), self.step[j],
                                robot.joints[j], first.source,
                                self.arm_fit.friction[j] if whole else None)
                       for j in range(robot.n_joints)]
        coulomb = np.array([start.forward.coulomb for start in self.starts])
        self.bundle = Bundle(
            tuple(self._fitted), self.robot.arm, period, half,
            observer_bandwidth(self.robot.arm, coulomb, half, self.step / 3.0, period),
            self.arm_fit.extras() if whole else (None,) * robot.n_joints)
        self.paper_spreads = None  # where the method of the paper is used
        self.choices = ()

    def fit(self, options, say):
        """Return a JointFit per joint."""
        if options.method == 'paper':
            fits, self.paper_spreads = paper_fits(self.bundle, self.bundle.half)
            return fits
        extras = [np.zeros(len(self.arm_fit.units[j]) if self.arm_fit else 0)
                  for j in range(self.robot.n_joints)]
        fits = default_method.fit_all(self.bundle, self.starts, extras, blocks=options.blocks,
                                      say=say)
        say('comparing with a fit of the torque')
        self.choices = per_joint(len(fits), lambda j: choose_fit(
            self.bundle, j, fits, self.step[j]))
        return [choice.fit for choice in self.choices]

    def results(self, fits):
        """Return a JointResult per joint, and the robot with the arm found."""
        thetas = [fit.coordinates.unpack(fit.free)[0] for fit in fits]
        spreads = self.paper_spreads or self._spreads(fits, thetas)
        further, robot = [()] * len(fits), self.described
        if self.arm_fit:
            further = arm_estimates(self.robot, self.arm_fit, thetas, spreads)
            found = folded(self.robot, self.arm_fit, thetas, spreads)
            robot = replace(robot, effects=found.effects, arm=replace(
                found.arm, stiffness=robot.arm.stiffness))
        return tuple(per_joint(len(fits), lambda j: self.result(
            j, fits, spreads[j], further[j]))), robot

    def _spreads(self, fits, thetas):
        """Return the Spread of each joint; that of the torque's fit is made already."""
        def spread(j):
            fit = fits[j]
            return self.choices[j].spread or spread_of(
                Objective(self.bundle, j, thetas), fit.coordinates, fit.free, fit.evaluation,
                fit.prior, fit.sampling)
        return per_joint(len(fits), spread)

    def result(self, joint, fits, spread, further=()):
        """Return the JointResult of one joint; ``further`` are Estimates beyond friction."""
        fit, bundle = fits[joint], self.bundle
        thetas = [other.coordinates.unpack(other.free)[0] for other in fits]
        theta, objective = thetas[joint], Objective(bundle, joint, thetas)
        reach = presliding_reach(bundle, joint, theta)
        top = np.abs(self.maps[joint].velocity).max()
        velocity = np.concatenate([-np.geomspace(top, 1e-4 * top, _VELOCITIES),
                                   np.geomspace(1e-4 * top, top, _VELOCITIES)])
        alone = friction_params([theta], [fit])
        estimates = estimates_of(self.robot.joints[joint], fit.coordinates, fit.free, spread,
                                 reach, travel(self._fitted, joint), fit.rivals, top=top)
        curve = curve_of(fit.coordinates, fit.free, spread, shown_displacements(
            estimates, theta[[STATIC, PER_DIRECTION + STATIC]].mean(), self.step[joint],
            _CURVE_POINTS), fit.rivals)
        return JointResult(
            joint=self.robot.joints[joint], side=self.sides[joint],
            estimates=estimates + further,
            curve=curve, friction_map=self.maps[joint], steady_velocity=velocity,
            steady_torque=steady_friction(velocity[:, None], alone)[:, 0],
            loops=loops_of(objective, bundle, theta),
            traces=errors.traces_of(objective, bundle, theta,
                                    default_method.held_out(bundle.period)),
            candidates=tuple(Candidate(one.n_blocks, one.cost, one.error,
                                       one.n_blocks == fit.coordinates.n_blocks)
                             for one in fit.candidates),
            held_out=self._errors(joint, fits, thetas),
            warnings=self._sentences(joint, fit, objective, theta))

    def _sentences(self, joint, fit, objective, theta):
        chosen = default_method.held_out(self.bundle.period)
        coupled = coupling_sentences(objective, self.bundle, theta, self.robot.joints, chosen,
                                     self._apart)
        if self.paper_spreads:
            return coupled if self._apart else (NOT_HELD_OUT, *coupled)
        rippled = ripple_sentences(objective, self.bundle, theta, self.robot.joints[joint])
        return (*self.choices[joint].sentences, *few_blocks(fit), *rippled, *coupled)

    def _errors(self, joint, fits, thetas):
        fit, bundle = fits[joint], self.bundle
        chosen = default_method.held_out(bundle.period)
        theta, _ = fit.coordinates.unpack(fit.held_out.free)
        if self._apart:
            bundle = bundle._replace(stretches=tuple(self._apart))
            theta, chosen = thetas[joint], everything
        objective = Objective(bundle, joint, thetas)
        simple = simple_theta(self.bundle, joint, fits, self.step[joint], bool(self._apart))
        return errors.held_out_errors(
            objective, bundle, theta, simple, chosen, self.step[joint],
            repeatability(self._fitted, self._phases, self.robot.arm, joint))


def per_joint(count, task):
    """Return what ``task`` returns for each of ``count`` joints, done in as many threads."""
    with ThreadPoolExecutor(max_workers=count) as pool:
        return list(pool.map(task, range(count)))


def few_blocks(fit):
    """Return a sentence where a JointFit has as many blocks as were tried and more can be."""
    most = max(candidate.n_blocks for candidate in fit.candidates)
    if fit.coordinates.n_blocks < most or most == MOST_BLOCKS:
        return ()
    return (f'N = {most} is the largest number of blocks that may be chosen. Where presliding '
            'needs more, other parameters take part of its place: allow more '
            f'(--blocks, up to {MOST_BLOCKS})',)


def without(stretch, constant):
    """Return a stretch with a constant torque (n,) taken off the drive's."""
    return replace(stretch, torque=stretch.torque - constant, constant=constant)


def everything(stretch):
    """Return that all samples (T,) are chosen."""
    return np.ones(len(stretch.angle), dtype=bool)


def common_period(recordings):
    """
    Return the sample period of recordings fitted together [s], the longest of theirs.

    A warning says so if they differ.
    """
    periods = [recording.period for recording in recordings]
    if max(periods) / min(periods) > 1.0 + _SAME_PERIOD:
        warnings.warn(f'the recordings are sampled every {1e3 * min(periods):.4g} to '
                      f'{1e3 * max(periods):.4g} ms; all are taken every '
                      f'{1e3 * max(periods):.4g} ms', stacklevel=2)
    return max(periods)


def resolution(stretches, joint, count):
    """Return the encoder step, or three times the noise where there is no step [rad]."""
    if count > 0.0:
        return count
    noise = [np.median(np.abs(np.diff(stretch.angle[:, joint], 3))) / np.sqrt(20.0) / 0.6745
             for stretch in stretches]
    return max(3.0 * float(np.nanmedian(noise)), 1e-9)


def travel(stretches, joint):
    """Return the range of a joint's angle [rad]."""
    return float(max(np.nanmax(stretch.angle[:, joint]) for stretch in stretches)
                 - min(np.nanmin(stretch.angle[:, joint]) for stretch in stretches))


def friction_params(thetas, fits):
    """Return FrictionParams of fitted joints, blocks from soft to stiff."""
    record = friction_record(thetas)
    most = max(fit.coordinates.n_blocks for fit in fits)
    blocks = np.zeros((2, len(fits), most))
    for j, fit in enumerate(fits):
        n = fit.coordinates.n_blocks
        order = np.argsort(record.stiffness[j, :n], kind='stable')
        blocks[0, j, :n] = record.stiffness[j, :n][order]
        blocks[1, j, :n] = record.weight[j, :n][order]
    sides = [StribeckParams(**{name: getattr(record, name)[row].copy() for name in (
        'static', 'coulomb', 'velocity', 'viscous')}) for row in range(2)]
    return FrictionParams(forward=sides[0], backward=sides[1], stiffness=blocks[0],
                          weight=blocks[1] / blocks[1].sum(axis=1, keepdims=True),
                          attraction=record.attraction.copy())
