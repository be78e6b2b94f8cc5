# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Conditions on the gains, Eqs. (34) to (43) in the corrected form of docs/model.md.

The error vector is rho = (q1~, dq1~, q2~, dq2~, F~ of every block) and mixes units as the paper
does, so the matrices and the bound are numbers without one. A rigid joint has no motor rows.
The theory knows neither sampling nor delay nor encoders, nor the softer velocity feedback of mode
gms at rest.
"""

from dataclasses import dataclass
from functools import lru_cache
import math

from gms_flex_control.dynamics import chain
import numpy as np

GERSHGORIN, EXACT = 'gershgorin', 'exact'
_CONFIGURATIONS = 4000  # at most, over which the extremes of M(q) are sought


@dataclass(frozen=True, kw_only=True)
class GainCondition:
    """One inequality on the gains of one joint: ``value`` must be above ``limit``."""

    joint: str      # link name
    kind: str       # GERSHGORIN, sufficient only, a row of Eq. (39), or EXACT for N_2 > 0
    condition: str  # the inequality in the paper's symbols
    value: float    # its left side
    limit: float    # its right side

    @property
    def met(self) -> bool:
        """Return whether the inequality holds."""
        return self.value > self.limit


@dataclass(frozen=True, kw_only=True, eq=False)
class GainReport:
    """What the stability proof says about a controller on a robot."""

    conditions: tuple    # of GainCondition, joint by joint; nothing couples into rigid joints
    joints: tuple        # link names
    alpha: np.ndarray    # (n,) smallest eigenvalue of each joint's N_2 (37)
    mass_range: tuple    # smallest and largest eigenvalue of M(q), all configurations [kg m^2]
    energy_range: tuple  # the same of N_1 (34)
    disturbance: float   # D_bar, bound on the norm of the disturbance (38)
    # bound on the norm of rho as time goes on, sqrt(lmax / lmin of N_1) D_bar / alpha; infinite
    # where N_2 is not positive definite; safe, and far from tight
    residual: float

    @property
    def met(self) -> bool:
        """Return whether every condition holds."""
        return all(condition.met for condition in self.conditions)


def check(gains, robot) -> GainReport:
    """Judge the gains of a controller on the robot it believes in."""
    alpha = np.array([np.linalg.eigvalsh(matrix)[0] for matrix in n2_matrices(gains, robot)])
    mass, energy = _extremes(gains, robot)
    disturbance = disturbance_bound(gains, robot)
    residual = math.inf
    if alpha.min() > 0.0 and energy[0] > 0.0:
        residual = math.sqrt(energy[1] / energy[0]) * disturbance / float(alpha.min())
    return GainReport(
        conditions=tuple(_conditions(gains, robot)), joints=tuple(robot.joints), alpha=alpha,
        mass_range=mass, energy_range=energy, disturbance=disturbance, residual=residual)


def violations(gains, robot) -> list[str]:
    """Return what the gains break, as sentences with the numbers."""
    conditions = list(_conditions(gains, robot))
    exact = {c.joint: c for c in conditions if c.kind == EXACT}
    sentences = []
    for condition in conditions:
        if condition.met:
            continue
        numbers = f'{condition.value:.6g} is not above {condition.limit:.6g}'
        sentence = f'{condition.joint}: {condition.condition} does not hold, {numbers}'
        if condition.kind == EXACT:
            sentence += '; N_2 is not positive definite, tracking may be unstable'
        else:
            spring = exact[condition.joint]
            verdict = 'still holds' if spring.met else 'does not hold either'
            sentence += (f' (Eq. 39, sufficient only; the exact test {spring.condition} '
                         f'{verdict}, {spring.value:.6g} against {spring.limit:.6g})')
        sentences.append(sentence)
    return sentences


def _conditions(gains, robot):
    for j, joint in enumerate(robot.joints):
        if robot.arm.rigid[j]:
            continue
        k1, l1 = float(gains.kd_link[j]), float(gains.lambda_link[j])
        k2, l2 = float(gains.kd_motor[j]), float(gains.lambda_motor[j])
        stiffness = float(robot.arm.stiffness[j])
        rows = (  # Gershgorin's discs of Eq. (37), rows 1 to 3; the print has the last two
            (GERSHGORIN, 'Lambda_1 K_D1 > K/2', l1 * k1, stiffness / 2),
            (GERSHGORIN, 'K_D1 > K/2', k1, stiffness / 2),
            (GERSHGORIN, 'Lambda_2^2 K_D2 > K (Lambda_1 + 1)/2', l2 * l2 * k2,
             stiffness * (l1 + 1) / 2),
            (EXACT, 'Lambda_2 sqrt(2 K_D1 K_D2) > K', l2 * math.sqrt(2 * k1 * k2), stiffness))
        for kind, text, value, limit in rows:
            yield GainCondition(joint=joint, kind=kind, condition=text, value=value, limit=limit)


def _observes(gains, j):
    """Return whether the errors of joint j's blocks are part of rho."""
    return gains.compensation in ('gms_paper', 'gms') and gains.observer_gain[j] > 0.0


def _largest_level(friction):
    """Return the largest Stribeck level of each joint, either way (n,)."""
    return np.maximum(friction.forward.static, friction.backward.static)


def n2_matrices(gains, robot) -> list[np.ndarray]:
    """Return the matrix N_2 of Eq. (37), which falls apart into a symmetric one per joint."""
    found = []
    levels = _largest_level(robot.friction)
    for j in range(robot.n_joints):
        k1, l1 = gains.kd_link[j], gains.lambda_link[j]
        k2, l2 = gains.kd_motor[j], gains.lambda_motor[j]
        diagonal = [l1 * k1 * l1, k1]
        flexible = not robot.arm.rigid[j]
        if flexible:
            diagonal += [l2 * k2 * l2, k2]
        if _observes(gains, j):
            rate = robot.friction.attraction[j] / levels[j] / gains.observer_gain[j]
            diagonal += [rate] * robot.friction.weight.shape[1]
        matrix = np.diag(diagonal)
        if flexible:
            half = robot.arm.stiffness[j] / 2
            matrix[0, 2] = matrix[2, 0] = -l1 * half
            matrix[1, 2] = matrix[2, 1] = -half
        found.append(matrix)
    return found


def disturbance_bound(gains, robot) -> float:
    """
    Return D_bar, a bound on the norm of the disturbance D of Eq. (38).

    From the friction error F~ of the link rows, (Lambda_1 F~, F~), and ``C alpha_i Delta / k_e``
    of every block, with known parameters and F_s the larger of both directions. ``none``: F~ is
    the friction of the blocks, at most F_s. ``gms_paper``: abs(F~_i) <= alpha_i s abs(Delta) in
    slip and in the stick after it, with abs(Delta) <= 1 the sign less its tanh, so F~ <= F_s.
    ``gms``: Delta = 0 while blocks slip, so they contribute nothing; estimate and friction both
    lie within F_s and differ by up to 2 F_s while the command filter follows a reversal; the same
    is assumed of the others. The viscous part is compensated or damps.
    """
    total = 0.0
    levels = _largest_level(robot.friction)
    for j in range(robot.n_joints):
        error = levels[j] * (1.0 if gains.compensation in ('none', 'gms_paper') else 2.0)
        total += (gains.lambda_link[j] ** 2 + 1.0) * error ** 2
        if gains.compensation == 'gms_paper' and _observes(gains, j):
            pushed = robot.friction.attraction[j] * robot.friction.weight[j]
            total += float(np.sum((pushed / gains.observer_gain[j]) ** 2))
    return math.sqrt(total)


@lru_cache(maxsize=16)
def mass_matrices(arm) -> np.ndarray:
    """Return M(q) (m, n, n) [kg m^2] on a grid of relative angles, or spread over joint ranges."""
    n = arm.n_joints
    if arm.kind == 'urdf':
        return chain.mass_matrices(chain.configurations(arm, _CONFIGURATIONS), arm)
    if arm.kind != 'planar' or n == 1:
        return chain.mass_matrices(np.zeros((1, n)), arm)
    # an even number, so that 0 and pi are both on the grid
    count = max(2, 2 * int(_CONFIGURATIONS ** (1.0 / (n - 1)) / 2.0))
    angles = 2.0 * np.pi * np.arange(count) / count
    grid = np.meshgrid(*[angles] * (n - 1), indexing='ij')
    relative = np.stack([np.zeros(count ** (n - 1)), *(axis.ravel() for axis in grid)], 1)
    return chain.mass_matrices(relative - arm.offset, arm)


def _extremes(gains, robot):
    """Return smallest and largest eigenvalues of M and of N_1, Eq. (34)."""
    mass = mass_matrices(robot.arm)
    scale = np.diag(gains.lambda_link)
    potential = 2.0 * np.diag(gains.lambda_link * gains.kd_link)  # P_1
    upper = np.concatenate([scale @ mass @ scale + potential, scale @ mass], axis=2)
    lower = np.concatenate([mass @ scale, mass], axis=2)
    spectra = [np.linalg.eigvalsh(np.concatenate([upper, lower], axis=1)).ravel()]
    for j in range(robot.n_joints):
        if not robot.arm.rigid[j]:
            inertia, l2 = robot.arm.motor_inertia[j], gains.lambda_motor[j]
            corner = l2 * inertia * l2 + 2.0 * l2 * gains.kd_motor[j]
            spectra.append(np.linalg.eigvalsh([[corner, l2 * inertia], [l2 * inertia, inertia]]))
        if _observes(gains, j):
            spectra.append([1.0 / gains.observer_gain[j]])
    return _range(np.linalg.eigvalsh(mass)), _range(np.concatenate(spectra))


def _range(values):
    return float(np.min(values)), float(np.max(values))
