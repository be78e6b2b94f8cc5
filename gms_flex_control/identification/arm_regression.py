# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Base parameters of an arm from recordings, by weighted least squares on the regressor.

    torque = scale (known + regressor parameters + tip load + slope zero) + friction + offset

``scale`` is what is recorded of a torque, ``known`` that of known loads, ``load`` the ten numbers
of one that is unknown, ``zero`` by how much link encoders read more than in the first recording.
Friction of each direction and temperature, and an offset by recording, are eliminated joint by
joint; every joint counts by its own noise, robustly. Regressor and torque pass through one
low-pass. Of links that are relied on the same fit gives what differs between recordings.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

from gms_flex_control.data.recording import Recording
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification import robust_regression
from gms_flex_control.identification.arm_differences import (
    BaseFit,
    Coupled,
    Differences,
    found_load,
    layout_of,
    relative_change,
    Unknowns,
)
from gms_flex_control.identification.arm_samples import arm_samples, described_scales, SLIPS
from gms_flex_control.identification.axis_fit import alike, COULOMB
from gms_flex_control.identification.inertial_parameters import (
    all_parameters,
    Base,
    base_of,
    IN_PLANE,
    meaning_of,
    names_of,
    nearest_arm,
    OF_BODY,
    sizes_of_body,
    ten_numbers,
    UNITS,
)
from gms_flex_control.identification.segments import drive_sides, rigid_where
from gms_flex_control.identification.uncertainty import clustered, inverse_of, memory_of
from gms_flex_control.params.arm import ArmParams, at_last_link, carrying, in_space
from gms_flex_control.params.robot import RobotParams
import numpy as np

_MEMORY = 2.1       # samples that the low-pass makes alike: 1 / B(0) of the 8th order B-spline
_ZERO_SD = 0.02     # of an encoder's zero between recordings [rad]
_LOAD_SD = 1.0      # of an unknown load, as bodies of the mass of the whole arm
_WEIGHED = 1e-3     # standard deviation of a load's mass where that alone is known, relative
_VAGUE_SD = 1e3     # the same of base parameters: those of a joint that stands have a variance
_DRIVE_SD = 0.1     # of the logarithm of a torque's scale, where a known load identifies it
_ASYMMETRY_SD = 0.1  # half of what friction differs by between the directions, of the rms torque
_ROUNDS = 50        # of Gauss and Newton at most: scales multiply parameters
_LEAST_SHARE = 0.1  # of a step that is taken where steps go to and fro
_SETTLED = 1e-5     # change of a logarithm of a scale that ends them
_LOADED = 5.0       # standard errors beyond which friction grows with the load
_ADDS = 0.005       # and at least so much of the torque carried
FRICTION, LOAD, DELAY = 'friction', 'load', 'delay'  # parts of what is eliminated for a joint


def fit_base_parameters(recordings: Sequence[Recording], robot: RobotParams) -> BaseFit:
    """Estimate the base parameters of a chain in space or in a plane, joints in its order."""
    arm, sides = driven_arm(recordings, robot)
    if all(_whole_load_unknown(one) for one in recordings):
        raise IdentificationError(
            f'{recordings[0].source}: the load of every recording is unknown, which cannot be '
            'separated from the last link: add a recording without a load or with a known one, or '
            'rely on the links of the URDF (without --estimate all)')
    base = (base_of(arm, numbers=IN_PLANE) if robot.arm.frames is None
            else base_of(arm, recordings[0].coupling))
    fit = ArmRegression(recordings, robot, sides, arm, base)
    fit.solve()
    if len(recordings) > 1:  # slopes by zeros are of the arm found
        loads = {r: one.body for r, one in fit.loads().items()}
        fit = ArmRegression(recordings, robot, sides, arm, base,
                            slopes_of=in_space(fit.nearest[0]), loads=loads)
        fit.solve()
    return fit.result(robot)


def fit_differences(recordings: Sequence[Recording], robot: RobotParams) -> Differences | None:
    """Return what differs between recordings of known links; None of one of known torques."""
    arm, sides = driven_arm(recordings, robot)
    if len(recordings) == 1 and not (np.any(recordings[0].scale_sd)
                                     or recordings[0].operation.load_unknown
                                     or recordings[0].coupling is not None):
        return None
    none = Base(np.zeros(0, dtype=int), np.zeros((0, len(all_parameters(arm)))))
    fit = ArmRegression(recordings, robot, sides, arm, none)
    fit.solve()
    return fit.differences()


def _whole_load_unknown(recording):
    return recording.operation.load_unknown and recording.operation.load is None


def driven_arm(recordings: Sequence[Recording], robot: RobotParams) -> tuple:
    """Return the arm in space, rigid where motors drive its links, and what drives them."""
    sides = drive_sides(recordings[0], robot)
    return in_space(rigid_where(robot, sides).arm), sides


class _Regression(NamedTuple):
    """The last step of Gauss and Newton."""

    step: np.ndarray    # (P,)
    normal: np.ndarray  # (P, P)
    pieces: list        # of `regress`
    moving: list        # which samples of each joint count, bool (S,)


class ArmRegression:
    """
    Least squares of one set of samples; a ``base`` without parameters relies on the links.

    ``friction`` is that of `arm_samples`, ``spring_sd`` (n,) of scales of a spring's torque.
    """

    _settles = True   # scales have to
    _slips = SLIPS

    def __init__(self, recordings, robot, sides, arm, base, slopes_of=None, loads=None,
                 friction=None, spring_sd=0.0):
        self._robot, self._arm, self._base = robot, arm, base
        self._sources, self._sides = [one.source for one in recordings], sides
        temperatures = [one.operation.temperature for one in recordings]
        self._labels = tuple(dict.fromkeys(temperatures))  # those alike have the same friction
        self._label = np.array([self._labels.index(one) for one in temperatures])
        self._samples, self._usual = arm_samples(recordings, robot, sides, arm, base.lead, [
            carrying(slopes_of or arm, (loads or {}).get(r, one.operation.load))
            for r, one in enumerate(recordings)], friction, self._slips)
        n, scale_sd = arm.n_joints, np.max([one.scale_sd for one in recordings], axis=0)
        known = [one.operation.load for one in recordings if not _whole_load_unknown(one)]
        loads = {load and (load.mass, *load.com) for load in known}
        self._prior_sd = np.maximum(np.maximum(scale_sd, spring_sd),
                                    _DRIVE_SD if len(loads) > 1 else 0.0)
        self._coupling = recordings[0].coupling
        self._layout = layout_of(len(base.lead), recordings, self._prior_sd)
        self._links = base.combination @ all_parameters(arm)
        self._at = Unknowns(self._links, np.zeros((len(recordings), n)), np.ones(n),
                            np.zeros((len(recordings), 10)),
                            np.zeros(2 * len(self._layout.shared)))
        self._known_loads = [recordings[r].operation.load for r in self._layout.unknown]
        self._loaded = np.zeros(n, dtype=bool)
        self._guess, unknown = np.ones(n), np.flatnonzero(np.isinf(scale_sd))
        if len(unknown):
            self._guess[unknown], self._prior_sd[unknown] = described_scales(
                self._samples, self._torque(), self._own, unknown,
                [f'{recordings[0].source}: the torque of {joint}' for joint in robot.joints])
        self._at.scale[:] = self._guess
        self._memory = 1.0
        self._last = None  # the _Regression of the last step

    def _parts(self, j, chosen):
        """Return what is eliminated for a joint: dict of str to regressors (S', F)."""
        samples, recording = self._samples, self._samples.recording[chosen]
        friction = samples.friction[chosen, j]
        change = [alike(friction) * (self._label[recording] == k)[:, None]  # no offset
                  for k in range(1, len(self._labels))]
        parts = {FRICTION: friction, 'change': np.concatenate([friction[:, :0], *change], axis=1),
                 'offset': (recording[:, None] == np.arange(1, len(self._at.zeros))).astype(float),
                 'turning': samples.turning[chosen, j]}
        if self._loaded[j]:
            parts[LOAD] = self._load_column(j)[chosen, None]
        if self._sides[j] == 'motor':  # by how much later its torque is recorded than angles
            parts[DELAY] = samples.change[chosen, j:j + 1]
        return parts

    def _own(self, j, chosen):
        """Return all that is eliminated for a joint (S', F)."""
        return np.concatenate(list(self._parts(j, chosen).values()), axis=1)

    def _expected(self, j):
        """
        Return half of what friction differs by between the directions, in deviations (1, F).

        Without that a motion of all joints at once leaves open whether a constant torque or the
        links' weight is in it. ``_memory`` samples count as one, and this one as many.
        """
        row = np.zeros((1, self._own(j, slice(0, 1)).shape[1]))
        sd = max(_ASYMMETRY_SD * np.sqrt(np.mean(self._samples.torque[:, j] ** 2)), 1e-12)
        row[0, COULOMB] = np.array([0.5, -0.5]) * np.sqrt(self._memory) / sd  # friction is first
        return row

    def _load_column(self, j):
        """Return the size of the torque that moves a link, against the motion (S,)."""
        return np.sign(self._samples.rate[:, j]) * np.abs(self._at.scale[j] * self._torque()[:, j])

    def _torque(self):
        """Return the torque of the links at the present values (S, n) [N m]."""
        samples = self._samples
        moved = np.einsum('sji,si->sj', samples.slope, self._at.zeros[samples.recording])
        carried = np.einsum('sjk,sk->sj', samples.tip, self._at.loads[samples.recording])
        return (samples.known + samples.regressor @ self._at.links + carried + moved
                + samples.coupled @ self._at.coupled)

    def solve(self) -> None:
        """Find parameters, zeros and scales; then once more where friction grows with load."""
        self._iterate()
        if len(self._base.lead):
            self._memory = max(self._scatter()[2], self._memory)
            self._iterate()
        self._loaded = np.array([value > max(_LOADED * error, _ADDS) for value, error in map(
            self._tried_load, range(len(self._at.scale)))])
        if self._loaded.any():
            self._iterate()

    def _tried_load(self, j):
        """Return what friction adds per torque carried at one joint, and its standard error."""
        left, moving = self._left(j)
        others = [part for name, part in self._parts(j, moving).items() if name != LOAD]
        regressors = np.concatenate([self._load_column(j)[moving, None], *others], axis=1)
        return robust_regression.first_coefficient(
            regressors, left, self._samples.block[moving], _MEMORY)

    def _left(self, j):
        """Return the torque that links do not explain where a joint moves, and where that is."""
        moving = self._last.moving[j]
        left = self._samples.torque[:, j] - self._at.scale[j] * self._torque()[:, j]
        return left[moving], moving

    def _coefficients(self, j, without=(), **beside):
        """
        Return coefficients (F,) of a joint's own regressors, dict by name, and what these leave.

        Parts ``without`` are left away, ``beside`` are further ones (S, n, F).
        """
        left, moving = self._left(j)
        parts = {name: part for name, part in self._parts(j, moving).items()
                 if name not in without}
        parts |= {name: part[moving, j] for name, part in beside.items()}
        own = np.concatenate(list(parts.values()), axis=1)
        values = np.linalg.lstsq(own, left, rcond=1e-10)[0]
        ends = np.cumsum([part.shape[1] for part in parts.values()])
        return dict(zip(parts, np.split(values, ends[:-1]), strict=True)), left - own @ values

    def asymmetries(self) -> np.ndarray:
        """Return by how much friction forward exceeds the mean of both ways, (n,) [N m]."""
        return np.array([0.5 * np.subtract(*self._coefficients(j)[0][FRICTION][COULOMB])
                         for j in range(len(self._sides))])

    def _iterate(self):
        samples, layout, at = self._samples, self._layout, self._at
        weighting, before, share = None, np.zeros(layout.coupled.stop), 1.0
        for _ in range(_ROUNDS):
            precision, model = self._precision(), self._torque()
            derivatives = self._derivatives(model)
            pull = np.zeros(len(precision))
            pull[layout.links] = self._links - at.links
            pull[layout.zeros] = -at.zeros[1:].ravel()
            pull[layout.scales] = np.log(self._guess / at.scale)[layout.free]
            pull[layout.loads] = -at.loads[layout.unknown].ravel()
            pull[layout.coupled] = -at.coupled
            left = samples.torque - at.scale * model
            weighting = weighting or robust_regression.weighting_of(
                derivatives, left, samples.rate, self._own, samples.recording)
            self._last = _Regression(*robust_regression.regress(
                derivatives, left, samples.block, self._own, weighting, precision, pull,
                self._expected if len(self._base.lead) else None),
                [moving for moving, _ in weighting])
            turned = self._last.step @ self._last.normal @ before < 0.0
            share = max(0.5 * share, _LEAST_SHARE) if turned else min(1.5 * share, 1.0)
            before = self._last.step
            links, zeros, scales, loads, coupled = (share * before[part] for part in layout[:5])
            at.links = at.links + links
            at.zeros[1:] += zeros.reshape(at.zeros[1:].shape)
            at.scale[layout.free] *= np.exp(np.clip(scales, -1.0, 1.0))
            at.loads[layout.unknown] += loads.reshape(-1, 10)
            at.coupled = at.coupled + coupled
            if np.all(np.abs(scales) < _SETTLED):
                return
        if not self._settles:
            return
        worst = layout.free[np.argmax(np.abs(scales))]
        raise IdentificationError(
            f'{self._sources[0]}: the scale of the torque of {self._robot.joints[worst]} does not '
            f'settle within {_ROUNDS} rounds (at last {at.scale[worst]:.3g}, still changing by '
            f'{np.abs(scales).max():.1%}): state its torque_constant in recording.yaml, or add a '
            'recording with a known load')

    def _precision(self):
        """Return the inverse prior variances (P,) of the unknowns."""
        samples, layout = self._samples, self._layout
        precision = np.zeros(layout.coupled.stop)
        precision[layout.zeros] = _ZERO_SD ** -2
        precision[layout.scales] = robust_regression.heavy_tailed(
            np.log(self._guess / self._at.scale)[layout.free], self._prior_sd[layout.free])
        body = self._arm.mass.sum() * OF_BODY
        precision[layout.loads] = np.concatenate([np.zeros(0), *(
            _LOAD_SD * (body if load is None else load.mass * OF_BODY * np.append(
                _WEIGHED, np.ones(9))) for load in self._known_loads)]) ** -2.0
        precision[layout.links] = (_VAGUE_SD * sizes_of_body(self._arm)[self._base.lead]) ** -2.0
        precision[layout.coupled] = np.sum(samples.coupled ** 2, axis=(0, 1)) / np.sum(
            samples.torque[:, layout.shared] ** 2)
        return precision

    def _derivatives(self, model):
        """Return derivatives (S, n, P) by parameters, zeros, logarithms of scales and loads."""
        samples, (count, n) = self._samples, model.shape
        zeros = np.zeros((count, n, len(self._at.zeros), n))
        zeros[np.arange(count), :, samples.recording] = samples.slope
        scales = (model[:, :, None] * np.eye(n))[:, :, self._layout.free]
        loads = [samples.tip * (samples.recording == r)[:, None, None]
                 for r in self._layout.unknown]
        whole = np.concatenate([samples.regressor, zeros[:, :, 1:].reshape(count, n, -1), scales,
                                *loads, samples.coupled], axis=2)
        return self._at.scale[:, None] * whole

    def _scatter(self):
        """
        Return the inverse normal matrix (P, P) of the last step, scores, and `memory_of` these.

        How many samples count as one is measured by all base parameters together that are
        determined: noise of encoders counts less than white one, what the model lacks counts
        more. No parameter is said to be better known than that, since few blocks agree by chance.
        """
        inverse = inverse_of(self._last.normal)
        scores = robust_regression.block_scores(
            self._last.pieces, self._last.step, self._last.normal)
        links = self._layout.links if len(self._base.lead) else slice(None)
        return inverse, scores, memory_of(inverse, self._precision(), scores, links)

    @cached_property
    def _covariance(self):
        """Return the covariance (P, P) of the last step, and how many samples count as one."""
        scatter = self._scatter()
        return clustered(*scatter), scatter[2]

    def _found_coupled(self):
        """Return the Coupled or None."""
        if self._coupling is None:
            return None
        n, part, shared = len(self._at.scale), self._layout.coupled, self._layout.shared
        friction, spread = np.zeros((2, n, 2))
        friction[shared] = self._at.coupled.reshape(-1, 2)
        spread[shared] = np.sqrt(np.diag(self._covariance[0])[part]).reshape(-1, 2)
        arm = self._arm if not len(self._base.lead) else self.nearest[0]
        return Coupled(self._coupling, friction, spread,
                       np.where(self._arm.rigid, arm.motor_inertia, 0.0))

    def loads(self) -> dict:
        """Return the FoundLoads by recording."""
        covariance, found = self._covariance[0][self._layout.loads, self._layout.loads], {}
        for k, r in enumerate(self._layout.unknown):
            own, known = slice(10 * k, 10 * k + 4), self._known_loads[k]
            found[r] = found_load(self._at.loads[r] + (
                0.0 if known is None else ten_numbers(at_last_link(known, self._arm))),
                covariance[own, own], self._arm, self._sources[r])
        return found

    @cached_property
    def nearest(self) -> tuple[ArmParams, np.ndarray]:
        """
        `nearest_arm` to the described one that has the base parameters.

        Beside the scales, zeros and loads found: torques and angles are corrected by these.
        """
        links = self._layout.links
        covariance, memory = self._covariance
        return nearest_arm(self._robot.arm, self._arm, self._base.combination, self._at.links,
                           self._last.normal[links, links] / memory, covariance[links, links])

    def result(self, robot) -> BaseFit:
        """Return the BaseFit."""
        rigid, n, links = self._arm.rigid, len(self._at.scale), self._layout.links
        names, own = names_of(robot.joints, rigid), self._last.normal[links, links]
        size = 1.0 / np.sqrt(np.diag(own))
        return BaseFit(
            tuple(names[k] for k in self._base.lead),
            tuple((UNITS * n)[k] if k < 10 * n else 'kg m^2' for k in self._base.lead),
            tuple(meaning_of(row, names) for row in self._base.combination), self._at.links,
            self._base.combination @ all_parameters(self._arm),
            self._covariance[0][links, links],
            float(np.sqrt(np.linalg.cond(own * np.outer(size, size)))),
            self.asymmetries() / self._at.scale, *self.nearest, self.differences())

    def differences(self) -> Differences:
        """Return the Differences of the recordings."""
        n, error = len(self._at.scale), np.sqrt(np.diag(self._covariance[0]))
        samples = self._samples
        scale_sd, zero_sd = np.zeros(n), np.zeros(self._at.zeros.shape)
        scale_sd[self._layout.free] = error[self._layout.scales]
        zero_sd[1:] = error[self._layout.zeros].reshape(zero_sd[1:].shape)
        offset, loaded = np.zeros(self._at.zeros.shape), np.zeros((2, n))
        labels = self._labels
        level, change = np.ones((len(labels), n)), np.zeros((len(labels), n, 4))
        for j in range(n):
            values, _ = self._coefficients(j)
            offset[1:, j] = values['offset']
            change[1:, j] = values['change'].reshape(-1, 4)
            level[1:, j] = 1.0 + relative_change(
                samples.friction[:, j], samples.rate[:, j], self._label[samples.recording],
                values[FRICTION], change[1:, j])
            if self._loaded[j]:
                loaded[:, j] = self._tried_load(j)
        return Differences(self._at.scale, scale_sd, self._prior_sd, self._at.zeros, zero_sd,
                           offset, labels, level, change[self._label], self._usual,
                           *loaded, self.loads(), self._found_coupled())
