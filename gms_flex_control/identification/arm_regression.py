# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Base parameters of an arm of a URDF from recordings, by weighted least squares on the regressor.

    torque = scale (known + regressor parameters + tip load + slope zero) + friction + offset

``scale`` is what is recorded of a torque, ``known`` that of known loads, ``load`` the ten numbers
of one that is unknown, ``zero`` by how much link encoders read more than in the first recording.
Friction of each direction and temperature, and an offset by recording, are eliminated joint by
joint; every joint counts by its own noise, robustly. Regressor and torque pass through one
low-pass. Of links that are relied on the same fit gives what differs between recordings.
"""

from collections.abc import Sequence
from typing import NamedTuple

from gms_flex_control.data.recording import Recording
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.arm_differences import (
    alike,
    Coupled,
    coupled_motors,
    Differences,
    FoundLoad,
)
from gms_flex_control.identification.arm_rows import rows_of
from gms_flex_control.identification.axis_fit import robust
from gms_flex_control.identification.base_parameters import regress, weighting_of
from gms_flex_control.identification.inertial_parameters import (
    all_parameters,
    base_of,
    body_of,
    meaning_of,
    names_of,
    nearest_arm,
    UNITS,
)
from gms_flex_control.identification.segments import drive_sides, rigid_where
from gms_flex_control.identification.uncertainty import (
    block_sums,
    clustered,
    inverse_of,
    memory_of,
)
from gms_flex_control.params.arm import ArmParams, at_end, carrying
from gms_flex_control.params.robot import RobotParams
import numpy as np

_MEMORY = 2.1       # samples that the low-pass makes alike: 1 / B(0) of the 8th order B-spline
_ZERO_SD = 0.02     # of an encoder's zero between recordings [rad]
_LOAD_SD = 1.0      # of an unknown load, as bodies of the mass of the whole arm
_LOAD_SIZE = 0.3    # and so large [m]
_VAGUE_SD = 1e3     # the same of base parameters: those of a joint that stands have a variance
_DRIVE_SD = 0.1     # of the logarithm of a torque's scale, where a known load identifies it
_UNKNOWN_SD = 0.5   # the same of currents, around what the URDF's masses give
_ROUNDS = 8         # of Gauss and Newton: scales multiply parameters
_SETTLED = 1e-5     # change of a logarithm of a scale that ends them
_LOADED = 5.0       # standard errors beyond which friction grows with the load
_SURE = 3.0         # standard deviations of its mass that an unknown load has at least
_TRIFLE = 5e-4      # and of the mass of the arm: links are not known better
_ADDS = 0.005       # and at least so much of the torque carried


class BaseFit(NamedTuple):
    """Base parameters of an arm from recordings."""

    names: tuple             # (B,), of the number that leads each, such as 'joint2.inertia_zz'
    units: tuple             # (B,)
    meanings: tuple          # (B,), the sum it stands for
    values: np.ndarray       # (B,)
    described: np.ndarray    # (B,), of the URDF
    covariance: np.ndarray   # (B, B)
    condition: float         # of the regressor, columns scaled
    offset: np.ndarray       # (n,), half of what forward and backward friction differ by [N m]
    arm: ArmParams           # nearest to the URDF
    differences: Differences

    @property
    def error(self) -> np.ndarray:
        """Return the standard deviations (B,)."""
        return np.sqrt(np.diag(self.covariance))


def fit_base_parameters(recordings: Sequence[Recording], robot: RobotParams) -> BaseFit:
    """Estimate the base parameters of a robot of kind urdf, joints in its order."""
    arm, sides = _driven(recordings, robot)
    if all(one.load_unknown for one in recordings):
        raise IdentificationError(
            f'{recordings[0].source}: the load of every recording is unknown, which cannot be '
            'told from the last link: add a recording without a load or with a known one, or '
            'rely on the links of the URDF (without --estimate all)')
    base = base_of(arm, recordings[0].coupling)
    fit = _Fit(recordings, robot, sides, arm, *base)
    fit.solve()
    found = fit.nearest()
    if len(recordings) > 1:  # slopes by zeros are of the arm found
        loads = {r: one.body for r, one in fit.loads().items()}
        fit = _Fit(recordings, robot, sides, arm, *base, slopes_of=found, loads=loads)
        fit.solve()
        found = fit.nearest()
    return fit.result(robot, found)


def fit_differences(recordings: Sequence[Recording], robot: RobotParams) -> Differences | None:
    """Return what differs between recordings of known links; None of one of known torques."""
    arm, sides = _driven(recordings, robot)
    if len(recordings) == 1 and not (np.any(recordings[0].scale_sd)
                                     or recordings[0].load_unknown
                                     or recordings[0].coupling is not None):
        return None
    fit = _Fit(recordings, robot, sides, arm, np.zeros(0, dtype=int), np.zeros((0, 0)))
    fit.solve()
    return fit.differences()


def _driven(recordings, robot):
    sides = drive_sides(recordings[0], robot)
    return rigid_where(robot, sides).arm, sides


class _Fit:
    """Least squares of one set of rows; ``lead`` and ``combination`` as of `base_of`."""

    def __init__(self, recordings, robot, sides, arm, lead, combination, slopes_of=None,
                 loads=None):
        self._robot, self._arm, self._lead, self._combination = robot, arm, lead, combination
        self._sources, self._sides = [one.source for one in recordings], sides
        self._labels = tuple(dict.fromkeys(one.temperature for one in recordings))
        self._label = np.array([self._labels.index(one.temperature) for one in recordings])
        self._rows, self._usual = rows_of(recordings, robot, sides, arm, lead, [
            carrying(slopes_of or arm, (loads or {}).get(r, one.load))
            for r, one in enumerate(recordings)])
        n, count = arm.n_joints, len(lead)
        doubt = np.max([one.scale_sd for one in recordings], axis=0)
        loads = {one.load and (one.load.mass, *one.load.com) for one in recordings
                 if not one.load_unknown}
        self._unknown = [r for r, one in enumerate(recordings) if one.load_unknown]
        self._prior_sd = np.where(np.isinf(doubt), _UNKNOWN_SD, np.maximum(
            doubt, _DRIVE_SD if len(loads) > 1 else 0.0))
        self._free = np.flatnonzero(self._prior_sd > 0.0)
        zeros = n * (len(recordings) - 1)
        self._parts = [slice(0, count), slice(count, count + zeros),
                       slice(count + zeros, count + zeros + len(self._free))]
        at = self._parts[2].stop
        self._parts.append(slice(at, at + 10 * len(self._unknown)))
        self._load_values = np.zeros((len(recordings), 10))
        self._coupling = recordings[0].coupling
        self._shared = coupled_motors(recordings)
        at = self._parts[3].stop
        self._parts.append(slice(at, at + 2 * len(self._shared)))
        self._coupled = np.zeros(2 * len(self._shared))
        self._values, self._zeros = np.zeros(count), np.zeros((len(recordings), n))
        self._scale, self._loaded = np.ones(n), np.zeros(n, dtype=bool)
        self._guess = self._guessed_scales(recordings, np.isinf(doubt))
        self._scale[:] = self._guess

    def _guessed_scales(self, recordings, unknown):
        """Return the scales (n,) to begin from: of unknown ones, as the URDF's masses have it."""
        guess, start = np.ones(len(unknown)), all_parameters(self._arm)
        described = self._rows.known + (self._rows.regressor @ (self._combination @ start)
                                        if len(self._lead) else 0.0)
        for j in np.flatnonzero(unknown):
            columns = np.concatenate([described[:, j:j + 1], self._own(j, slice(None))], axis=1)
            root = np.sqrt(robust(columns, self._rows.torque[:, j])[0])
            guess[j] = np.linalg.lstsq(columns * root[:, None], self._rows.torque[:, j] * root,
                                       rcond=1e-10)[0][0]
            if not guess[j] > 0.0:
                raise IdentificationError(
                    f'{recordings[0].source}: the torque of {self._robot.joints[j]} goes against '
                    f'what its links require ({guess[j]:.3g} per N m): its sign is reversed, or '
                    'its torque constant is negative; state it in recording.yaml')
        return guess

    def _own(self, j, chosen):
        """Return the columns that are eliminated for a joint: friction, offsets, delay (S', F)."""
        rows, columns = self._rows, []
        recording = rows.recording[chosen]
        friction = rows.friction[chosen, j]
        columns.append(friction)
        for k in range(1, len(self._labels)):  # alike in both directions: an offset is another
            columns.append(alike(friction) * (self._label[recording] == k)[:, None])
        for r in range(1, len(self._zeros)):
            columns.append((recording == r)[:, None].astype(float))
        if self._loaded[j]:
            columns.append(self._load_column(j)[chosen, None])
        columns.append(rows.turning[chosen, j])  # at last: others are found by place
        if self._sides[j] == 'motor':  # by how much later its torque is recorded than angles
            columns.append(rows.change[chosen, j:j + 1])
        return np.concatenate(columns, axis=1)

    def _load_column(self, j):
        """Return the size of the torque that moves a link, against the motion (S,)."""
        return np.sign(self._rows.rate[:, j]) * np.abs(self._scale[j] * self._torque()[:, j])

    def _torque(self):
        """Return the torque of the links at the present values (S, n) [N m]."""
        rows = self._rows
        moved = np.einsum('sji,si->sj', rows.slope, self._zeros[rows.recording])
        carried = np.einsum('sjk,sk->sj', rows.tip, self._load_values[rows.recording])
        return (rows.known + rows.regressor @ self._values + carried + moved
                + rows.coupled @ self._coupled)

    def solve(self) -> None:
        """Find parameters, zeros and scales; then once more where friction grows with load."""
        self._iterate()
        left = [self._left(j) for j in range(len(self._scale))]
        self._loaded = np.array([
            value > max(_LOADED * error, _ADDS) for value, error in map(self._tried_load, left)])
        if self._loaded.any():
            self._iterate()

    def _tried_load(self, left):
        """Return what friction adds per torque carried at one joint, and its standard error."""
        j, torque, rows = left
        columns = np.concatenate([self._load_column(j)[rows, None], self._own(j, rows)], axis=1)
        weights, scale = robust(columns, torque)
        root = np.sqrt(weights)
        scaled = columns * root[:, None]
        values = np.linalg.lstsq(scaled, torque * root, rcond=1e-10)[0]
        inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
        scores = block_sums(scaled * (torque * root - scaled @ values)[:, None],
                            self._rows.block[rows])
        return values[0], float(np.sqrt(clustered(scale ** 2 * inverse, scores / scale ** 2,
                                                  _MEMORY)[0, 0]))

    def _left(self, j):
        """Return a joint, where it moves the torque its links do not explain, and these rows."""
        rows = self._moving[j]
        return j, (self._rows.torque[:, j] - self._scale[j] * self._torque()[:, j])[rows], rows

    def _iterate(self):
        rows, count = self._rows, self._parts[4].stop
        precision = np.zeros(count)
        precision[self._parts[1]] = _ZERO_SD ** -2
        precision[self._parts[2]] = self._prior_sd[self._free] ** -2
        size, mass = _LOAD_SIZE, self._arm.mass.sum()
        body = mass * np.repeat([1.0, size, size ** 2], [1, 3, 6])
        precision[self._parts[3]] = np.tile(_LOAD_SD * body, len(self._unknown)) ** -2.0
        own = np.append(np.tile(body, len(self._scale)), np.full(len(self._scale), body[-1]))
        precision[self._parts[0]] = (_VAGUE_SD * own[self._lead]) ** -2.0
        precision[self._parts[4]] = np.sum(rows.coupled ** 2, axis=(0, 1)) / np.sum(
            rows.torque[:, self._shared] ** 2)
        self._precision, weighting = precision, None
        for k in range(_ROUNDS if len(self._free) else 1):
            model = self._torque()
            columns = self._columns(model)
            pull = np.zeros(count)
            pull[self._parts[0]] = -self._values
            pull[self._parts[1]] = -self._zeros[1:].ravel()
            pull[self._parts[4]] = -self._coupled
            pull[self._parts[3]] = -self._load_values[self._unknown].ravel()
            pull[self._parts[2]] = np.log(self._guess / self._scale)[self._free]
            left = rows.torque - self._scale * model
            weighting = weighting or weighting_of(columns, left, rows.rate, self._own,
                                                  rows.recording)
            self._step, self._normal, self._pieces = regress(
                columns, left, rows.rate, rows.block, self._own, precision, pull, weighting)
            step, self._moving = self._step, [rows for rows, _ in weighting]
            values, zeros, scales, loads, coupled = (step[part] for part in self._parts)
            self._coupled = self._coupled + coupled
            self._load_values[self._unknown] += loads.reshape(-1, 10)
            self._values = self._values + values
            self._zeros[1:] += zeros.reshape(self._zeros[1:].shape)
            self._scale[self._free] *= np.exp(np.clip(scales, -1.0, 1.0))
            if k and np.all(np.abs(scales) < _SETTLED):  # first, parameters of 0 leave scales be
                break

    def _columns(self, model):
        """Return derivatives (S, n, P) by parameters, zeros, logarithms of scales and loads."""
        rows, (samples, n) = self._rows, model.shape
        zeros = np.zeros((samples, n, len(self._zeros), n))
        zeros[np.arange(samples), :, rows.recording] = rows.slope
        scales = (model[:, :, None] * np.eye(n))[:, :, self._free]
        loads = [rows.tip * (rows.recording == r)[:, None, None] for r in self._unknown]
        whole = np.concatenate([rows.regressor, zeros[:, :, 1:].reshape(samples, n, -1), scales,
                                *loads, rows.coupled], axis=2)
        return self._scale[:, None] * whole

    def _covariance(self):
        """
        Return covariance and inverse of the normal matrix (P, P).

        How many samples count as one is measured by all base parameters together that are
        determined: noise of encoders counts less than white one, what the model lacks counts
        more. No parameter is said to be better known than that, since few blocks agree by chance.
        """
        count = int(self._rows.block.max()) + 1
        scores = np.zeros((count, len(self._step)))
        for scaled, target, block in self._pieces:
            sums = block_sums(scaled * (target - scaled @ self._step)[:, None], block)
            scores[:len(sums)] += sums
        inverse = inverse_of(self._normal)
        links = self._parts[0] if len(self._lead) else slice(None)
        memory = memory_of(inverse, self._precision, scores, links)
        return clustered(inverse, scores, memory), inverse

    def _found_coupled(self):
        """Return the Coupled, None where there is none."""
        if self._coupling is None:
            return None
        n, covariance = len(self._scale), self._covariance()[0][self._parts[4], self._parts[4]]
        friction, spread = np.zeros((2, n, 2))
        friction[self._shared] = self._coupled.reshape(-1, 2)
        spread[self._shared] = np.sqrt(np.diag(covariance)).reshape(-1, 2)
        arm = self._arm if not len(self._lead) else self.nearest()
        return Coupled(self._coupling, friction, spread,
                       np.where(self._arm.rigid, arm.motor_inertia, 0.0))

    def loads(self) -> dict:
        """Return the FoundLoads by recording."""
        covariance, found = self._covariance()[0][self._parts[3], self._parts[3]], {}
        for k, r in enumerate(self._unknown):
            own = covariance[10 * k:10 * k + 4, 10 * k:10 * k + 4]
            mass, *moment = self._load_values[r, :4]
            if not mass > max(_SURE * np.sqrt(own[0, 0]), _TRIFLE * self._arm.mass.sum()):
                raise IdentificationError(
                    f'{self._sources[r]}: the unknown load has a mass of {mass:.3g} kg within '
                    f'{np.sqrt(own[0, 0]):.2g} (standard deviation), which is none: leave load '
                    'away in recording.yaml, or move the arm more')
            com = np.array(moment) / mass
            slopes = np.concatenate([-com[:, None], np.eye(3)], axis=1) / mass
            turn = self._arm.frames.end_rotation.T
            spread = np.maximum(np.diag(turn @ slopes @ own @ slopes.T @ turn.T), 0.0)
            found[r] = FoundLoad(at_end(body_of(self._load_values[r]), self._arm.frames),
                                 float(np.sqrt(own[0, 0])), np.sqrt(spread))
        return found

    def nearest(self) -> ArmParams:
        """Return the arm nearest to the URDF that has the base parameters."""
        links = self._parts[0]
        covariance, inverse = (one[links, links] for one in self._covariance())
        normal = self._normal if links.stop == len(self._normal) else inverse_of(inverse)
        return nearest_arm(self._robot.arm, self._arm, self._combination, self._values, normal,
                           covariance)

    def result(self, robot, found) -> BaseFit:
        """Return the BaseFit, ``found`` the nearest arm."""
        rigid, n, links = self._arm.rigid, len(self._scale), self._parts[0]
        names, own = names_of(robot.joints, rigid), self._normal[links, links]
        size, offset = 1.0 / np.sqrt(np.diag(own)), np.empty(n)
        for j in range(n):
            _, left, rows = self._left(j)
            friction = np.linalg.lstsq(self._own(j, rows), left, rcond=1e-10)[0]
            offset[j] = 0.5 * (friction[0] - friction[4]) / self._scale[j]
        return BaseFit(
            tuple(names[k] for k in self._lead),
            tuple((UNITS * n)[k] if k < 10 * n else 'kg m^2' for k in self._lead),
            tuple(meaning_of(row, names) for row in self._combination), self._values,
            self._combination @ all_parameters(self._arm), self._covariance()[0][links, links],
            float(np.sqrt(np.linalg.cond(own * np.outer(size, size)))), offset, found,
            self.differences())

    def differences(self) -> Differences:
        """Return the Differences of the recordings."""
        n, error = len(self._scale), np.sqrt(np.diag(self._covariance()[0]))
        scale_sd, zero_sd = np.zeros(n), np.zeros(self._zeros.shape)
        scale_sd[self._free] = error[self._parts[2]]
        zero_sd[1:] = error[self._parts[1]].reshape(zero_sd[1:].shape)
        offset, loaded = np.zeros(self._zeros.shape), np.zeros((2, n))
        level, change = np.ones((len(self._labels), n)), np.zeros((len(self._labels), n, 4))
        for j in range(n):
            _, left, rows = self._left(j)
            own = self._own(j, rows)
            values = np.linalg.lstsq(own, left, rcond=1e-10)[0]
            at = 4 + 4 * len(self._labels)
            offset[1:, j] = values[at:at + len(offset) - 1]
            change[1:, j] = values[8:at].reshape(-1, 4)
            level[1:, j] = 1.0 + self._changes(j, values[:8], change[1:, j])
            if self._loaded[j]:
                self._loaded[j] = False
                loaded[:, j] = self._tried_load((j, left, rows))
                self._loaded[j] = True
        return Differences(self._scale, scale_sd, self._prior_sd, self._zeros, zero_sd, offset,
                           self._labels, level, change[self._label], self._usual, *loaded,
                           self.loads(), self._found_coupled())

    def _changes(self, j, curve, changes):
        """Return friction of ``changes`` (L - 1, 4) over that of the first temperature (8,)."""
        rows, label = self._rows, self._label[self._rows.recording]
        top = min(np.quantile(np.abs(rows.rate[label == k, j]), 0.9)
                  for k in range(len(self._labels)))
        seen = (np.abs(rows.rate[:, j]) < top) & (np.abs(rows.rate[:, j]) > 0.1 * top)
        friction = rows.friction[seen, j]
        usual = friction @ (0.5 * np.tile(curve[:4] + curve[4:], 2))
        return changes @ alike(friction).T @ usual / max(usual @ usual, 1e-300)
