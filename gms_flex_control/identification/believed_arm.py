# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The arm that friction is fitted beside: as described, but for what recordings show of it.

A link that is 2 % heavier than described weighs more than a good joint rubs; friction that is
fitted as if links and springs were exact takes the difference for its own.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data.recording import later, Recording
from gms_flex_control.data.signal_analysis import rms
from gms_flex_control.effects.catalogue.reading import RecordingDelay
from gms_flex_control.identification.arm_regression import ArmRegression, DELAY, driven_arm
from gms_flex_control.identification.arm_samples import SLIPS, SPRINGY
from gms_flex_control.identification.assumed_robot import only_joints
from gms_flex_control.identification.inertial_parameters import (
    all_parameters,
    base_of,
    IN_PLANE,
    sizes_of_body,
)
from gms_flex_control.identification.motor_equation import motor_equation_of
from gms_flex_control.identification.objective import friction_along
from gms_flex_control.identification.robust_regression import heavy_tailed
from gms_flex_control.identification.segments import driven
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import known_to, RobotParams
import numpy as np

_DIFFERENT = 12.0   # independent errors along recordings: motion repeats, and what a model lacks
_TORQUE_SD = 0.01   # of the scale of torques that are given in N m
_LEAST_SD = 1e-4    # of a base parameter, as of a body of the whole mass: one of 0 has none
_SHOWN = 0.9        # of the torque that links and friction leave, where links are as described:
#                     described rightly they leave 0.97 and more, 1 % off 0.85 and less
_CUSTOM_SHOWN = 0.97  # likewise, of all joints together, where half of all machines are so
_AGREE = 3.0        # standard deviations between two sources of one number
_ALIKE = 0.5        # of what friction differs by both ways: an offset of a spring explains more
_OF_LINKS = ('mass', 'com', 'inertia', 'motor_inertia')
_NUMBERS = (*_OF_LINKS, 'stiffness')
_WORTH_WORDS = 0.005  # of a stiffness


class Believed(NamedTuple):
    """What friction is fitted beside."""

    arm: ArmParams
    delay: np.ndarray  # (n,) by which torques act later than they are stamped [s], as a rule 0
    zero: np.ndarray   # (n,) torsion that is read where a spring gives no torque [rad], likewise

    def cleared(self, recording: Recording) -> Recording:
        """Return a recording whose torques, of samples that ended, and torsions are as acted."""
        torque, time = recording.tau_motor.copy(), recording.time
        for j in np.flatnonzero(self.delay):
            known = np.flatnonzero(np.isfinite(torque[:, j]))
            begin = time[known[0]] - recording.period
            torque[known, j] = later(torque[known, j], np.append(begin, time[known]),
                                     self.delay[j])
        return replace(recording, tau_motor=torque, q_motor=recording.q_motor - self.zero)

    def words(self, robot: RobotParams) -> str:
        """Return a sentence that says what is other than described, '' where nothing is."""
        shown, arm = [], robot.arm
        for j, joint in enumerate(robot.joints):
            stiffer = 0.0 if arm.rigid[j] else self.arm.stiffness[j] / arm.stiffness[j] - 1.0
            if abs(stiffer) > _WORTH_WORDS:
                shown.append(f'a spring of {joint} that is {abs(100 * stiffer):.2g} % '
                             f'{"stiffer" if stiffer > 0.0 else "softer"}')
            if self.zero[j]:
                shown.append(f'encoders of {joint} that read {1e3 * abs(self.zero[j]):.2g} mrad '
                             'of torsion where its spring gives no torque')
            if self.delay[j]:
                shown.append(f'torques of {joint} that act {abs(1e3 * self.delay[j]):.2g} ms '
                             f'{"later" if self.delay[j] > 0.0 else "earlier"} than they are '
                             'stamped')
        if any(np.any(getattr(self.arm, name) != getattr(arm, name)) for name in _OF_LINKS):
            shown.append('links other than described')
        return (f'these recordings show {" and ".join(shown)}: friction is fitted beside that, '
                'the robot file stays as it is (--estimate all finds the arm, discrepancy names '
                'the cause)') if shown else ''


def believed(recordings: Sequence[Recording], robot: RobotParams, thetas: dict | None = None,
             beside: Believed | None = None) -> Believed:
    """
    Return the arm that recordings show, hardly farther from the described one than it is known.

    That is the described one unless another explains the torque far better, and so are times of
    torques. Base parameters and springs have priors by the `uncertainty` of the robot. ``thetas``
    are parameters of friction by joint, where it was fitted, beside what was believed before:
    asymmetry of that says no more of a spring's zero.
    """
    known = {joint: (theta, beside.arm.stiffness[robot.joints.index(joint)])
             for joint, theta in (thetas or {}).items()}
    found = _of_all(recordings, robot, known)
    return found._replace(zero=beside.zero) if beside else found


def _of_all(recordings, robot, known):
    if robot.arm.kind != 'decoupled':
        return _within_belief(recordings, robot, known)
    alone = [_within_belief([one.of_joints([joint]) for one in recordings],
                            only_joints(robot, [joint]), known) for joint in robot.joints]
    return Believed(replace(robot.arm, **{
        name: np.concatenate([getattr(one.arm, name) for one in alone]) for name in _NUMBERS}),
        *(np.concatenate([getattr(one, name) for one in alone]) for name in ('delay', 'zero')))


def _within_belief(recordings, robot, known):
    arm, sides = driven_arm(recordings, robot)
    if not all(driven(one, sides).all() for one in recordings):
        return Believed(robot.arm, *np.zeros((2, robot.n_joints)))
    springs = np.array(sides) == 'spring'
    base = (base_of(arm, numbers=IN_PLANE) if robot.arm.frames is None
            else base_of(arm, recordings[0].coupling))
    fits = _spring_fits(recordings, robot, springs)
    stiffness, sd, agreed = _stiffnesses(robot, fits)
    robot = replace(robot, arm=replace(robot.arm, stiffness=stiffness))

    def friction(segment, joints, period):
        torque = np.zeros(segment.torque.shape)
        for j, joint in enumerate(joints):
            if joint in known:
                theta, fitted_with = known[joint]
                scale = stiffness[j] / fitted_with if springs[j] else 1.0
                torque[:, j] = scale * friction_along(segment, j, period)(theta)
        return torque
    fit = _WithinBelief(recordings, robot, sides, arm, base, agreed, spring_sd=sd * springs,
                        friction=friction if known else None)
    fit.solve()
    if known:  # of a spring's zero they say no more
        return fit.believed()
    asymmetry, found = fit.asymmetries(), fit.believed()
    return found._replace(zero=_zeros(fits, asymmetry, found.arm.stiffness))


def _spring_fits(recordings, robot, springs):
    """Return SpringFits by joint; a joint with effects has none, the equation may have any."""
    inertia, sd = robot.arm.motor_inertia, known_to(robot, 'motor_inertia')
    plain = [all(spec.joint != joint for spec in robot.effects) for joint in robot.joints]
    equations = {j: motor_equation_of(recordings, j) for j in np.flatnonzero(springs & plain)}
    fits = {j: one and one.fit_spring(inertia[j], sd[j] * inertia[j])
            for j, one in equations.items()}
    return {j: fit for j, fit in fits.items() if fit}


def _stiffnesses(robot, fits):
    """
    Return stiffnesses [N m/rad], their relative standard deviations, and which agree, (n,) each.

    As described, unless the torque of the motor shows another: the spring's own torque determines
    links and friction but for a factor, that of its stiffness. Where both agree, neither is far
    off.
    """
    stiffness, sd = robot.arm.stiffness.copy(), known_to(robot, 'stiffness')
    agreed = np.zeros(robot.n_joints, dtype=bool)
    for j, fit in fits.items():
        measured = fit.stiffness
        if measured <= 0.0:
            continue
        precision = np.array([
            sd[j] ** -2.0, ((fit.error / measured) ** 2 + _TORQUE_SD ** 2) ** -1.0])
        agreed[j] = np.log(measured / stiffness[j]) ** 2 < _AGREE ** 2 * np.sum(1.0 / precision)
        likely = stiffness[j] ** (precision[0] / precision.sum()) * measured ** (
            precision[1] / precision.sum())
        if fit.left(likely) < _SHOWN * fit.left(stiffness[j]):
            stiffness[j], sd[j] = likely, precision.sum() ** -0.5
    return stiffness, sd, agreed


def _zeros(fits, asymmetry, stiffness):
    """
    Return torsions that are read where springs give no torque (n,) [rad], 0 unless shown.

    Such a torque is missing from the motor's equation and is in friction of one direction, with
    an ``asymmetry`` (n,) [N m]. Both say the same where it is that.
    """
    zero = np.zeros(len(stiffness))
    for j, fit in fits.items():
        torque = -fit.constant
        if abs(torque) > _AGREE * fit.constant_error and abs(
                asymmetry[j] - torque) < _ALIKE * abs(asymmetry[j]):
            zero[j] = torque / stiffness[j]
    return zero


class _WithinBelief(ArmRegression):
    """
    The regression with links, and springs, that are known: each within heavy-tailed priors.

    Those of springs ``agreed`` (n,) of are normal. Soft blocks of friction swing along with a
    sinusoid as an inertia does, so that they are left out of what is fitted, and judge it.
    """

    _settles = False
    _slips = (*SLIPS, *SPRINGY)

    def __init__(self, recordings, robot, sides, arm, base, agreed, **options):
        super().__init__(recordings, robot, sides, arm, base, **options)
        self._agreed, self._period = agreed, recordings[0].period
        self._commanded = any(one.has_commands for one in recordings)
        samples, soft = self._samples, slice(len(SLIPS), len(self._slips))
        self._soft = samples.turning[:, :, soft]
        self._samples = samples._replace(turning=np.delete(samples.turning, soft, axis=2))
        self._memory = len(self._samples.block) / _DIFFERENT
        ten = np.where(np.arange(10) < 4, known_to(robot, 'gravity')[:, None],
                       known_to(robot, 'inertia')[:, None])
        known = np.append(ten.ravel(), known_to(robot, 'motor_inertia')[arm.rigid])
        self._sd = np.maximum(
            np.linalg.norm(base.combination * all_parameters(arm) * known, axis=1),
            _LEAST_SD * sizes_of_body(arm)[base.lead])

    def _precision(self):
        precision, layout = super()._precision(), self._layout
        precision[layout.links] = heavy_tailed(self._at.links - self._links, self._sd)
        precision[layout.scales] = np.where(
            self._agreed[layout.free], self._prior_sd[layout.free] ** -2.0,
            precision[layout.scales])
        for part in (layout.links, layout.scales):
            precision[part] *= self._memory
        return precision

    def believed(self) -> Believed:
        """Return the arm as described, unless some torque is explained far better by another."""
        arm, at, springs = self._robot.arm, self._at, np.array(self._sides) == 'spring'
        found = replace(self.nearest[0], stiffness=np.where(
            springs, arm.stiffness / at.scale, arm.stiffness))
        beside = self._unexplained()
        self._at = replace(at, links=self._links, scale=np.ones(len(at.scale)))
        if np.any(beside < _SHOWN * self._unexplained()):
            arm, self._at = found, at
        return Believed(arm, self._delays(~springs), np.zeros(len(springs)))

    def _delays(self, by_motors):
        """
        Return how much later than stamped torques of motors act (n,) [s], 0 unless shown.

        What is a custom of drives need not be shown as clearly, if all of them are taken together.
        """
        late, left = np.zeros(len(by_motors)), np.ones(len(by_motors))
        for j in np.flatnonzero(by_motors):
            values, rest = self._judged(j)
            late[j] = values[DELAY][0]
            left[j] = rms(rest) / rms(self._judged(j, without=(DELAY,))[1])
        usual = any(by_motors) and np.exp(np.mean(np.log(left[by_motors]))) < _CUSTOM_SHOWN
        custom = [bool(usual) and RecordingDelay.is_custom((one,), self._period, self._commanded)
                  for one in late]
        return np.where((left < _SHOWN) | custom, late, 0.0)

    def _unexplained(self):
        """Return rms torques (n,) that neither links nor friction explain [N m]."""
        return np.array([rms(self._judged(j)[1]) for j in range(len(self._sides))])

    def _judged(self, j, without=()):
        return self._coefficients(j, without, soft=self._soft)
