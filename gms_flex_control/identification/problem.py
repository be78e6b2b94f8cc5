# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What is fitted: recordings of one robot cut into segments, from starts to results."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Self
import warnings

from gms_flex_control.errors import IdentificationError
from gms_flex_control.friction import steady_friction
from gms_flex_control.identification import assumed_robot, prediction_error, uncertainty
from gms_flex_control.identification.arm_differences import difference_estimates
from gms_flex_control.identification.arm_fit import arm_estimates, estimate_arm, folded
from gms_flex_control.identification.arm_regression import fit_differences
from gms_flex_control.identification.believed_arm import believed
from gms_flex_control.identification.coordinates import (
    friction_record,
    MOST_BLOCKS,
    STATICS,
    theta_of,
)
from gms_flex_control.identification.criterion import choose_fit, left_of_torque, simple_theta
from gms_flex_control.identification.friction_fit import fit_all
from gms_flex_control.identification.friction_map import (
    fitted_thinning,
    friction_map,
    moves,
    repeatability,
    start_of,
    thinned_friction,
    thinning_estimate,
    thinning_of,
)
from gms_flex_control.identification.objective import (
    Bundle,
    everything,
    held_out,
    numbered,
    observer_bandwidth,
)
from gms_flex_control.identification.outcome import JointResult, OtherJoints
from gms_flex_control.identification.segments import (
    drive_sides,
    driven,
    half_count,
    one_by_one,
    resolution,
    rigid_where,
    segments_of,
    travel,
    while_moved,
)
from gms_flex_control.identification.selection import few_blocks, objectives_of
from gms_flex_control.params.robot import (
    EffectSpec,
    FrictionParams,
    RobotParams,
    StribeckParams,
    with_effects,
)
from gms_flex_control.simulation.predictor import parameter_rows
import numpy as np

_SAME_PERIOD = 0.01   # relative difference of sample periods of recordings fitted together
_CURVE_POINTS = 80
_VELOCITIES = 200


class Problem:
    """
    Recordings of one robot, cut into segments.

    ``given`` and ``holdouts`` are (Recording, phases), the robot is of
    assumed_robot.believed_model; ``whole`` says that the arm is estimated as well. Otherwise
    friction is fitted ``beside`` a Believed arm, by default what the recordings show. Joints are
    taken ``alone``, each with the motion of the others as measured; those of a planar chain may
    move together. Friction is fitted of joints ``only`` (str), () all; that of others is right.
    Of ``thinned`` (EffectSpec of ShearThinning, one a joint) the torques are fitted as well.
    """

    def __init__(self, given, holdouts, robot, *, whole=False, alone=True, beside=None, only=(),
                 thinned=()):
        self.whole, self._given, self._only = whole, (given, holdouts, robot), only
        half = half_count(given[0][0].of_joints(robot.joints), robot)  # of readings as they are
        recordings, believed_robot = self._settle_arm(
            [assumed_robot.cleared(one.of_joints(robot.joints), robot)
             for one, _ in (*given, *holdouts)], robot, beside)
        self._sources = [one.source for one, _ in given]
        period = _common_period(recordings)
        self._alone = alone and robot.arm.kind != 'decoupled'
        segments, self._apart = self._cut(recordings, believed_robot, period)
        self._steps = np.array([resolution(segments, j, 2.0 * one) for j, one in enumerate(half)])
        self.maps = [friction_map(segments, self.robot.arm, j, period, one)
                     for j, one in enumerate(half)]
        self._fit = self._joints_to_fit()  # all that follows is of ``only`` these joints
        self.fitted = [j for j in self._fit if not only or robot.joints[j] in only]
        if len(self.fitted) < robot.n_joints:
            self.robot = assumed_robot.only_joints(
                self.robot, [robot.joints[j] for j in self.fitted])
            self.sides, self.maps = ([one[j] for j in self.fitted] for one in (
                self.sides, self.maps))
            segments, self._apart = ([one.of_joints(self.fitted) for one in several]
                                     for several in (segments, self._apart))
        arm, half, self.step = self.robot.arm, half[self.fitted], self._steps[self.fitted]
        self.starts = [start_of(self.maps[k], travel(segments, k), self.step[k],
                                robot.joints[j], self._sources[0],
                                self.arm_fit.joints[j].friction if whole else None)
                       for k, j in enumerate(self.fitted)]
        coulomb = np.array([start.forward.coulomb for start in self.starts])
        by_joint = {one.joint: one for one in thinned}
        self._thinned = [by_joint.get(robot.joints[j]) for j in self.fitted]
        extras = self.arm_fit.extras() if whole else (None,) * robot.n_joints
        self._of_arm = tuple(extras[j] for j in self.fitted)
        self.bundle = Bundle(
            tuple(segments), arm, period, half,
            observer_bandwidth(arm, coulomb, half, self.step / 3.0, period),
            tuple(map(_with_thinning, range(len(self.fitted)), self._of_arm, self._thinned)))
        self.choices = ()

    def _settle_arm(self, recordings, robot, beside):
        """Set what friction is fitted beside; return recordings as acted, and the robot."""
        self._recordings = recordings[:len(self._given[0])]
        self.arm_fit = estimate_arm(self._recordings, robot) if self.whole else None
        robot = self.arm_fit.robot if self.whole else robot
        self.described, self.sides = robot, drive_sides(recordings[0], robot)
        if not self.whole:
            beside = beside or believed(self._recordings, robot)
            robot = replace(robot, arm=beside.arm)
            recordings = [beside.cleared(one) for one in recordings]
        self._beside = beside
        self.differences = None  # of an arm in space alone
        if robot.arm.frames is not None:
            self.differences = self.arm_fit.differences if self.whole else fit_differences(
                recordings[:len(self._given[0])], robot)
        return recordings, robot

    def _cut(self, recordings, robot, period):
        """Set the robot; return the segments that are fitted, and those of holdouts."""
        (given, holdouts, _), self.robot = self._given, rigid_where(robot, self.sides)
        parts = [segments_of(recording, robot, self.sides, phases, period) for recording,
                 (_, phases) in zip(recordings, (*given, *holdouts), strict=True)]
        if self.differences:
            parts = [[self.differences.cleared(one, r) for one in part]
                     for r, part in enumerate(parts)]
        found = self.differences.loads if self.differences else {}
        loads = [found[r].body if r in found else one.operation.load
                 for r, one in enumerate(recordings)]
        if self._alone:
            parts, self.robot = one_by_one(parts, self.robot, loads,
                                           self.differences and self.differences.loaded)
        if self.whole:
            parts = [[self.arm_fit.cleared(one) for one in part] for part in parts]
        fitted, apart = (while_moved([one for part in parts[rows] for one in part],
                                     recordings[rows]) for rows in (
            slice(len(given)), slice(len(given), None)))
        return numbered(fitted, period), apart

    def _joints_to_fit(self):
        """
        Return the numbers of the joints whose friction is fitted; a warning names the others.

        An arm in space is often recorded joint by joint, and drives exist that give no torque.
        Links of a planar chain are never left out, nor an axis that stands.
        """
        joints = range(self.described.n_joints)
        moved = [j for j in joints if moves(self.maps[j])]
        is_driven = np.any([driven(one, self.sides) for one in self._recordings], axis=0)
        fitted = [j for j in joints if is_driven[j] and (
            j in moved or self.described.arm.frames is None)]
        if not is_driven.any():
            raise IdentificationError(
                f'{", ".join(self._sources)}: no joint has a torque that ever changes, as where a '
                'driver reports none; record the efforts, or commands as efforts (import-csv)')
        if len(fitted) in (0, len(joints)) or not moved:
            return list(joints)
        for why, left_out in (
                ('hardly move in these recordings', is_driven),
                ('have no torque that was recorded, or one that never changes', ~is_driven)):
            others = [self.described.joints[j] for j in joints if left_out[j] and j not in fitted]
            if others:
                warnings.warn(
                    f'{", ".join(self._sources)}: {", ".join(others)} {why}: their friction stays '
                    'as described, a placeholder where nothing was stated', stacklevel=4)
        return fitted

    def thinned(self, fits) -> list[EffectSpec]:
        """Return the ShearThinning of each joint in whose torque JointFits leave one."""
        found = _per_joint(thinning_of, objectives_of(self.bundle, fits),
                           self.robot.joints, [fit.theta for fit in fits], self.step)
        return [one for one in found if one]

    def beside_thinned(self, thinned) -> Self:
        """Return the Problem in which viscous friction of some joints bends."""
        return Problem(*self._given, whole=self.whole, alone=self._alone, only=self._only,
                       thinned=thinned)

    def found_thinned(self, fits) -> list[EffectSpec]:
        """Return the ShearThinning of JointFits, of joints whose viscous friction bends."""
        return list(filter(None, (fitted_thinning(one, fit.theta) for one, fit in zip(
            self._thinned, fits, strict=True))))

    def with_friction(self, robot, fits) -> RobotParams:
        """Return a robot with the friction of JointFits, and what grows with the load."""
        per_load = self.arm_fit.loaded if self.arm_fit else np.zeros(robot.n_joints)
        return assumed_robot.with_load_friction(
            with_effects(replace(robot, friction=robot.friction.with_joints(
                self.fitted, _friction_params(fits))), *self.found_thinned(fits)),
            per_load + (self.differences.loaded if self.differences else 0.0), self._steps)

    def found_beside(self, joints) -> dict:
        """Return ``constants`` and ``loads`` of the Identification."""
        found = self.differences
        if not found:
            return {}
        return {'constants': {joints[j]: (1.0 / found.scale[j], found.scale_sd[j])
                              for j in np.flatnonzero(found.prior_sd > 0.0)},
                'loads': {r: one.body for r, one in found.loads.items()}}

    def beside(self, fits) -> Self:
        """Return the Problem beside what they show of the arm with the friction of JointFits."""
        joints, friction = self.described.joints, self.described.friction
        thetas = {joints[j]: theta_of(friction, j) for j in self._fit} if self._only else {}
        thetas |= {joints[j]: fit.theta for j, fit in zip(self.fitted, fits, strict=True)}
        return Problem(*self._given, alone=self._alone, only=self._only, beside=believed(
            self._recordings, self.described, thetas, self._beside))

    def each_alone(self) -> Self:
        """Return the Problem in which the others move as measured, beside the same arm."""
        return Problem(*self._given, beside=self._beside, only=self._only)

    def words(self) -> str:
        """Return a sentence of what is other than described, '' where nothing is."""
        return '' if self.whole else self._beside.words(self.described)

    def unexplained(self, fits) -> np.ndarray:
        """Return the parts (n,) of the friction torque held out that JointFits leave."""
        return np.array([left_of_torque(*each) for each in zip(
            objectives_of(self.bundle, fits), fits, self.step, strict=True)])

    def search(self, options, say) -> list:
        """Return the JointFit per joint that predicts motion best."""
        extras = [np.append(np.ones(int(one is not None)),
                            np.zeros(len(self.arm_fit.joints[j].units) if self.arm_fit else 0))
                  for one, j in zip(self._thinned, self.fitted, strict=True)]
        return fit_all(self.bundle, self.starts, extras, self.step, blocks=options.blocks, say=say)

    def choose(self, fits, say) -> list:
        """Return the JointFit per joint that is chosen of those that `search` found."""
        say('comparing with a fit of the torque')
        self.choices = _per_joint(choose_fit, objectives_of(self.bundle, fits), fits, self.step)
        return [choice.fit.alike_both_ways(start.unmoved) for choice, start in zip(
            self.choices, self.starts, strict=True)]

    def results(self, fits) -> tuple:
        """Return a JointResult per joint that was fitted, OtherJoints, the robot as found."""
        objectives, thetas = objectives_of(self.bundle, fits), [fit.theta for fit in fits]
        spreads = _per_joint(lambda choice, *found: choice.spread or uncertainty.spread_of(*found),
                             self.choices, objectives, fits)
        further, robot = [()] * self.described.n_joints, self.described
        if self.arm_fit and self.arm_fit.final:
            further = self.arm_fit.final
        elif self.arm_fit:
            further = arm_estimates(self.robot, self.arm_fit, thetas, spreads)
            found = folded(self.robot, self.arm_fit, thetas)
            robot = replace(robot, effects=found.effects, arm=replace(
                found.arm, stiffness=robot.arm.stiffness))
        if self.differences:
            further = [(*own, *rows) for own, rows in zip(further, difference_estimates(
                self.differences, robot.joints, self._sources), strict=True)]
        others = [row for j, rows in enumerate(further) if j not in self.fitted for row in rows]
        results = _per_joint(self._result, objectives, fits, spreads,
                             [further[j] for j in self.fitted], self._thinned)
        return tuple(results), OtherJoints(tuple(others)), robot

    def _result(self, objective, fit, spread, further, thinned):
        """Return the JointResult of one joint; ``further`` are Estimates beyond friction."""
        joint, bundle, theta = objective.joint, self.bundle, fit.theta
        top = np.abs(self.maps[joint].velocity).max()
        velocity = np.concatenate([-np.geomspace(top, 1e-4 * top, _VELOCITIES),
                                   np.geomspace(1e-4 * top, top, _VELOCITIES)])
        estimates = uncertainty.estimates_of(
            self.robot.joints[joint], fit.coordinates, fit.free, spread,
            prediction_error.presliding_reach(objective, theta),
            travel(bundle.segments, joint), fit.rivals, top)
        curve = uncertainty.curve_of(fit, spread, uncertainty.shown_displacements(
            estimates, theta[STATICS].mean(), self.step[joint], _CURVE_POINTS))
        steady = steady_friction(velocity[:, None], _friction_params([fit]))[:, 0]
        if found := fitted_thinning(thinned, theta):
            steady += thinned_friction(found, velocity)
            error = spread.covariance[-fit.coordinates.n_extra, -fit.coordinates.n_extra] ** 0.5
            further = (thinning_estimate(found, error * thinned.values[0]), *further)
        return JointResult(
            joint=self.robot.joints[joint], side=self.sides[joint], estimates=estimates + further,
            curve=curve, friction_map=self.maps[joint], steady_velocity=velocity,
            steady_torque=steady,
            loops=prediction_error.loops_of(objective, theta),
            traces=prediction_error.traces_of(objective, theta, held_out(bundle.period)),
            candidates=tuple(one._replace(chosen=one.n_blocks == fit.coordinates.n_blocks)
                             for one in fit.candidates),
            held_out=self._errors(objective, fit),
            warnings=(*self.choices[joint].sentences, *few_blocks(fit),
                      *prediction_error.coupling_sentences(
                          objective, theta, self.robot.joints, held_out(bundle.period),
                          self._apart, self._alone)))

    def _errors(self, objective, fit):
        joint, bundle, judged = objective.joint, self.bundle, objective
        chosen, theta = held_out(bundle.period), fit.coordinates.parameters(fit.held)
        if any(one.tested[:, joint].any() for one in self._apart):
            judged = objective.of(bundle=bundle._replace(segments=tuple(self._apart)))
            theta, chosen = fit.theta, everything
        straight = objective.of(bundle=bundle._replace(extras=self._of_arm))
        simple = simple_theta(straight, fit, self.step[joint], bool(self._apart))
        if self._thinned[joint]:
            simple = np.insert(simple, parameter_rows(MOST_BLOCKS, 0), 0.0)
        return prediction_error.held_out_errors(
            judged, theta, simple, chosen, self.step[joint], repeatability(
                bundle.segments, self.robot.arm, joint, bundle.period, bundle.half[joint]))


def _with_thinning(k, of_arm, thinned):
    """Return a function Segment -> further torques (T, R) of the k-th joint, or None."""
    if not thinned:
        return of_arm
    return lambda segment: np.column_stack([
        -segment.factor[:, k] * thinned_friction(thinned, segment.rate[:, k]),
        *([of_arm(segment)] if of_arm else [])])


def _per_joint(task, *given):
    """Return what ``task`` returns for what is ``given`` of each joint, in as many threads."""
    with ThreadPoolExecutor(max_workers=len(given[0])) as pool:
        return list(pool.map(task, *given))


def _common_period(recordings):
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


def _friction_params(fits):
    """Return FrictionParams of joints, one JointFit each, blocks from soft to stiff."""
    record = friction_record([fit.theta for fit in fits])
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
