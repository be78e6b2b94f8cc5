# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What recordings of an arm show: base parameters, what differs between them, and Estimates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.axis_fit import alike, friction_regressors
from gms_flex_control.identification.inertial_parameters import body_of
from gms_flex_control.identification.outcome import CONFIDENT, Estimate, estimated, WIDE
from gms_flex_control.identification.segments import Segment
from gms_flex_control.params.arm import ArmParams, at_end, Body
import numpy as np

_SURE = 3.0         # standard deviations of its mass that an unknown load has at least
_TRIFLE = 5e-4      # and of the mass of the arm: links are not known better
_LEARNT = 0.5       # of the prior standard deviation: the recordings identify a scale
_LARGE = 4.0        # standard errors: a zero is reported
_NOT_MOVED = 'this motion hardly moves it: faster motion of all joints together identifies it'
_NEEDS = ('the scale is the one that the masses of the URDF have: a recording with a known load '
          'and one without identify it')


class FoundLoad(NamedTuple):
    """An unknown load as it was found, in the frame at the end of the arm."""

    body: Body
    mass_sd: float     # [kg]
    com_sd: np.ndarray  # (3,) [m]


def found_load(numbers, covariance, arm: ArmParams, source: str) -> FoundLoad:
    """
    Return the FoundLoad of ten ``numbers`` in the frame of the last link.

    ``covariance`` (4, 4) is that of mass and first moment. IdentificationError if it has no mass.
    """
    (mass, *moment), sd = numbers[:4], float(np.sqrt(covariance[0, 0]))
    if not mass > max(_SURE * sd, _TRIFLE * arm.mass.sum()):
        raise IdentificationError(
            f'{source}: the unknown load has a mass of {mass:.3g} kg within {sd:.2g} (standard '
            'deviation), so that there is no load: leave load away in recording.yaml, or move the '
            'arm more')
    com = np.array(moment) / mass
    slopes = np.concatenate([-com[:, None], np.eye(3)], axis=1) / mass
    turn = arm.frames.end_rotation.T
    spread = np.maximum(np.diag(turn @ slopes @ covariance @ slopes.T @ turn.T), 0.0)
    return FoundLoad(at_end(body_of(numbers), arm.frames), sd, np.sqrt(spread))


class Coupled(NamedTuple):
    """Friction and inertia of motors that several joints turn, alike in all recordings."""

    coupling: np.ndarray    # (n, n) of the recordings
    friction: np.ndarray    # (n, 2) Coulomb [N m] and viscous [N m s/rad]; 0 of other motors
    friction_sd: np.ndarray  # (n, 2)
    inertia: np.ndarray     # (n,) of motors of rigid joints, else 0 [kg m^2]

    def torque(self, segment: Segment) -> np.ndarray:
        """Return what acts on joints (T, n) beyond motors that turn with their own [N m]."""
        out = beyond_own(segment.acceleration, self.inertia, self.coupling)
        for m in np.flatnonzero(self.friction.any(axis=1)):
            out += np.outer(plain_friction(segment.rate @ self.coupling[m]) @ self.friction[m],
                            self.coupling[m])
        return out


class Differences(NamedTuple):
    """What differs between R recordings of one robot with n joints, and torques from true ones."""

    scale: np.ndarray       # (n,), recorded torque over true torque
    scale_sd: np.ndarray    # (n,), relative; 0 where the scale was taken as known
    prior_sd: np.ndarray    # (n,), before the recordings were seen
    zero: np.ndarray        # (R, n), of link encoders, less that of the first [rad]
    zero_sd: np.ndarray     # (R, n)
    offset: np.ndarray      # (R, n), of torques as recorded, less that of the first
    labels: tuple           # (L,) of str, temperatures
    level: np.ndarray       # (L, n), friction over that of the first temperature
    change: np.ndarray      # (R, n, 4), coefficients of the friction that it has more
    usual: np.ndarray       # (n,), rate that these are for [rad/s]
    loaded: np.ndarray      # (n,), friction per torque carried, 0 where it does not grow
    loaded_sd: np.ndarray   # (n,)
    loads: dict             # number of a recording to its FoundLoad, of unknown ones
    coupled: Coupled | None  # None where each motor turns with its joint alone

    def cleared(self, segment: Segment, recording: int) -> Segment:
        """Return a segment with true torques, encoders and temperature as in the first one."""
        beyond = 0.0 if self.coupled is None else self.coupled.torque(segment)
        if recording >= len(self.zero):
            return replace(segment, torque=segment.torque / self.scale - beyond)
        more = np.stack([alike(friction_regressors(rate, usual)) @ change for rate, usual, change
                         in zip(segment.rate.T, self.usual, self.change[recording], strict=True)],
                        axis=1)
        return replace(segment, angle=segment.angle - self.zero[recording],
                       torque=(segment.torque - self.offset[recording] - more) / self.scale
                       - beyond)


def relative_change(friction, rate, label, curve, changes) -> np.ndarray:
    """Return by how much friction differs at other temperatures, over the first (L - 1,)."""
    top = min(np.quantile(np.abs(rate[label == k]), 0.9) for k in range(len(changes) + 1))
    seen = (np.abs(rate) < top) & (np.abs(rate) > 0.1 * top)
    usual = friction[seen] @ (0.5 * np.tile(curve[:4] + curve[4:], 2))
    return changes @ alike(friction[seen]).T @ usual / max(usual @ usual, 1e-300)


def coupled_motors(recordings) -> list[int]:
    """Return the motors (M,) that several joints turn; recordings have to agree."""
    first = recordings[0].coupling
    for one in recordings:
        if (one.coupling is None) != (first is None) or (
                first is not None and not np.array_equal(one.coupling, first)):
            raise IdentificationError(f'{one.source}: its coupling is another than that of '
                                      f'{recordings[0].source}: give both the same')
    return [] if first is None else [m for m, row in enumerate(first) if np.any(np.delete(row, m))]


def beyond_own(acceleration, inertia, coupling) -> np.ndarray:
    """Return the torque (T, n) of motors by their coupling beyond that of their own joint."""
    return (acceleration @ coupling.T * inertia) @ coupling - acceleration * inertia


def plain_friction(rate) -> np.ndarray:
    """Return columns (T, 2) of Coulomb and viscous friction, both directions alike."""
    return np.stack([np.sign(rate), rate], axis=1)


class Layout(NamedTuple):
    """Where each kind of unknown stands among all of them (P,), and what it is of."""

    links: slice    # base parameters
    zeros: slice    # of encoders, of all recordings but the first
    scales: slice   # logarithms of torque scales, of the joints ``free``
    loads: slice    # ten numbers each of the recordings ``unknown``
    coupled: slice  # Coulomb and viscous friction each of the motors ``shared``
    free: np.ndarray
    unknown: list
    shared: np.ndarray


def layout_of(count: int, recordings, prior_sd) -> Layout:
    """Return the Layout of ``count`` base parameters and what recordings leave open."""
    free = np.flatnonzero(prior_sd > 0.0)
    unknown = [r for r, one in enumerate(recordings) if one.operation.load_unknown]
    shared = coupled_motors(recordings)
    sizes = (count, len(prior_sd) * (len(recordings) - 1), len(free), 10 * len(unknown),
             2 * len(shared))
    ends = np.cumsum(sizes).tolist()
    return Layout(*map(slice, [0, *ends], ends), free, unknown, shared)


@dataclass
class Unknowns:
    """The values at which the model stands."""

    links: np.ndarray    # (B,)
    zeros: np.ndarray    # (R, n), of the first recording 0 [rad]
    scale: np.ndarray    # (n,), recorded over true torque
    loads: np.ndarray    # (R, 10)
    coupled: np.ndarray  # (2 M,)


class BaseFit(NamedTuple):
    """Base parameters of an arm from recordings."""

    names: tuple             # (B,), of the number that leads each, such as 'joint2.inertia_zz'
    units: tuple             # (B,)
    meanings: tuple          # (B,), the sum it stands for
    values: np.ndarray       # (B,)
    described: np.ndarray    # (B,), of the robot file
    covariance: np.ndarray   # (B, B)
    condition: float         # of the regressor, columns scaled
    offset: np.ndarray       # (n,), half of what forward and backward friction differ by [N m]
    arm: ArmParams           # nearest to the described one
    spread: np.ndarray       # (3, n), of `nearest_arm`
    differences: Differences

    @property
    def error(self) -> np.ndarray:
        """Return the standard deviations (B,)."""
        return np.sqrt(np.diag(self.covariance))


def base_estimates(fit: BaseFit, joints: Sequence[str]) -> list:
    """Return the Estimates of a BaseFit, a tuple per joint, the arm's with the first."""
    rows = {joint: [] for joint in joints}
    for name, unit, meaning, value, described, error in zip(
            fit.names, fit.units, fit.meanings, fit.values, fit.described, fit.error, strict=True):
        known = CONFIDENT * error < WIDE * abs(value)
        note = f'base parameter {meaning}, {described:.4g} as described'
        rows[name.split('.')[0]].append(estimated(
            f'arm.{name}', unit, value, error, note if known else f'{note}; {_NOT_MOVED}',
            bool(known)))
    for joint, offset in zip(joints, fit.offset, strict=True):
        rows[joint].append(estimated(
            f'arm.{joint}.torque_offset', 'N m', offset, None, 'a constant torque, or half of '
            'what friction differs by between the directions, where it stays'))
    rows[joints[0]].insert(0, estimated(
        'arm.condition_number', '1', fit.condition, None, 'of the regressor of base parameters, '
        'columns scaled: the smaller the better is the motion'))
    return [tuple(rows[joint]) for joint in joints]


def difference_estimates(found: Differences, joints: Sequence[str], sources: Sequence[str]
                         ) -> list:
    """Return the Estimates of Differences, a tuple per joint."""
    rows = [[] for _ in joints]
    for j, joint in enumerate(joints):
        if found.prior_sd[j] > 0.0:
            rows[j].append(scale_estimate(found, j, joint))
        if found.loaded[j] > 0.0:
            rows[j].append(load_estimate(joint, found.loaded[j], found.loaded_sd[j]))
        rows[j] += [estimated(f'friction.{joint}.at_{label}', '1', found.level[k, j], None,
                              f'friction at {label!r} over that at {found.labels[0]!r}')
                    for k, label in enumerate(found.labels[1:], 1)]
        rows[j] += [estimated(f'recordings.{r + 1}.{joint}.zero', 'rad', value, error, 'of the '
                              f'link encoder in {source}, less that in the first recording')
                    for r, (source, value, error) in enumerate(zip(
                        sources, found.zero[:, j], found.zero_sd[:, j], strict=False))
                    if abs(value) > _LARGE * error > 0.0]
    for m in range(len(joints) if found.coupled else 0):
        rows[m] += coupled_estimates(found.coupled, m, joints)
    for r, load in found.loads.items():
        rows[-1] += load_estimates(load, f'recordings.{r + 1}.load', sources[r])
    return [tuple(part) for part in rows]


def load_estimate(joint: str, per_load: float, error: float | None) -> Estimate:
    """Return the Estimate of friction that grows with the torque carried."""
    return estimated(f'friction.{joint}.per_load', '1', per_load, error,
                     'friction grows by this share of the torque that moves the link')


def coupled_estimates(coupled: Coupled, m: int, joints: Sequence[str]) -> list:
    """Return the Estimates of the friction of a motor that several joints turn, or none."""
    if not coupled.friction[m].any():
        return []
    turns = ' + '.join(f'{ratio:g} {joint}' for ratio, joint in zip(
        coupled.coupling[m], joints, strict=True) if ratio)
    return [estimated(f'friction.{joints[m]}.coupled_{part}', unit, value, sd, 'of the motor, '
                      f'which turns with {turns}, both directions alike')
            for part, unit, value, sd in zip(('coulomb', 'viscous'), ('N m', 'N m s/rad'),
                                             coupled.friction[m], coupled.friction_sd[m],
                                             strict=True)]


def load_estimates(load: FoundLoad, name: str, source: str) -> list:
    """Return the Estimates of a load that was unknown."""
    body, upper = load.body, np.triu_indices(3)
    written = (f'load: {{mass: {body.mass:.4g}, com: [{_listed(body.com)}], '
               f'inertia: [{_listed(body.inertia[upper])}]}}')
    return [estimated(f'{name}.mass', 'kg', body.mass, load.mass_sd,
                      f'carried in {source}; for recording.yaml: {written}'),
            *(estimated(f'{name}.com_{axis}', 'm', value, sd) for axis, value, sd in zip(
                'xyz', body.com, load.com_sd, strict=True))]


def _listed(values):
    return ', '.join(f'{value:.4g}' for value in values)


def scale_estimate(found: Differences, j: int, joint: str) -> Estimate:
    """Return the Estimate of what is recorded of a joint's torque."""
    value, error = found.scale[j], found.scale_sd[j]
    known = error < _LEARNT * found.prior_sd[j] and CONFIDENT * error < WIDE
    return estimated(
        f'arm.{joint}.torque_scale', '1', value, error * value, 'recorded over true torque, and '
        f'results are of true torques: the true torque constant is {1.0 / value:.4g} times the '
        'one of recording.yaml, times 1 if that has none' if known else _NEEDS, bool(known))
