# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Estimates of what a regression of an arm found: base parameters, differences of recordings."""

from collections.abc import Sequence
from typing import NamedTuple

from gms_flex_control.identification.arm_differences import Coupled, Differences, FoundLoad
from gms_flex_control.identification.outcome import CONFIDENT, Estimate, estimated
from gms_flex_control.params.arm import ArmParams
import numpy as np

_WIDE = 0.5         # half an interval this large a part of the value says nothing
_LEARNT = 0.5       # of the prior standard deviation: the recordings identify a scale
_LARGE = 4.0        # standard errors: a zero is reported
_NOT_MOVED = 'this motion hardly moves it: faster motion of all joints together identifies it'
_NEEDS = ('the scale is the one that the masses of the URDF have: a recording with a known load '
          'and one without identify it')


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
        known = CONFIDENT * error < _WIDE * abs(value)
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
    known = error < _LEARNT * found.prior_sd[j] and CONFIDENT * error < _WIDE
    return estimated(
        f'arm.{joint}.torque_scale', '1', value, error * value, 'recorded over true torque, and '
        f'results are of true torques: the true torque constant is {1.0 / value:.4g} times the '
        'one of recording.yaml, times 1 if that has none' if known else _NEEDS, bool(known))
