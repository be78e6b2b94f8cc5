# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What differs between recordings of one robot, or is found beside its links."""

from dataclasses import dataclass, replace
from typing import NamedTuple

from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.axis_fit import friction_regressors
from gms_flex_control.identification.inertial_parameters import body_of
from gms_flex_control.identification.segments import Segment
from gms_flex_control.params.arm import ArmParams, at_end, Body
import numpy as np

_SURE = 3.0         # standard deviations of its mass that an unknown load has at least
_TRIFLE = 5e-4      # and of the mass of the arm: links are not known better


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
        """
        Return a segment of a recording as it were with true torques in the first recording.

        That is with its encoder zeros, offsets and temperature. Of a recording that was not
        fitted, only the scale of torques is known.
        """
        beyond = 0.0 if self.coupled is None else self.coupled.torque(segment)
        if recording >= len(self.zero):
            return replace(segment, torque=segment.torque / self.scale - beyond)
        more = np.stack([alike(friction_regressors(rate, usual)) @ change for rate, usual, change
                         in zip(segment.rate.T, self.usual, self.change[recording], strict=True)],
                        axis=1)
        return replace(segment, angle=segment.angle - self.zero[recording],
                       torque=(segment.torque - self.offset[recording] - more) / self.scale
                       - beyond)


def alike(friction: np.ndarray) -> np.ndarray:
    """Return columns (S, 4) of friction that both directions have alike, of those by direction."""
    return friction[:, :4] + friction[:, 4:]


def relative_change(friction, rate, label, curve, changes) -> np.ndarray:
    """
    Return by how much friction differs at other temperatures, over that at the first (L - 1,).

    ``friction`` (S, 8) are columns at ``rate`` (S,) of temperature ``label`` (S,), ``curve`` (8,)
    and ``changes`` (L - 1, 4) coefficients.
    """
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
    return [] if first is None else [
        m for m, row in enumerate(first) if np.any(np.delete(row, m))]


def beyond_own(acceleration, inertia, coupling) -> np.ndarray:
    """Return the torque (T, n) of motors by their coupling beyond that of their own joint."""
    return (acceleration @ coupling.T * inertia) @ coupling - acceleration * inertia


def plain_friction(rate) -> np.ndarray:
    """Return columns (T, 2) of Coulomb and viscous friction, both directions alike."""
    return np.stack([np.sign(rate), rate], axis=1)


class Temperatures(NamedTuple):
    """Labels of the recordings: those of one label have the same friction."""

    labels: tuple
    of: np.ndarray  # (R,), index of each recording's label


def temperatures_of(recordings) -> Temperatures:
    """Return the Temperatures of recordings."""
    found = [one.operation.temperature for one in recordings]
    labels = tuple(dict.fromkeys(found))
    return Temperatures(labels, np.array([labels.index(one) for one in found]))


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

    @property
    def slices(self) -> tuple:
        """Return the five slices."""
        return self[:5]


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
