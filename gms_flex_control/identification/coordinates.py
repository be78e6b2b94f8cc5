# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The numbers a fit moves, and the friction parameters of one joint that they stand for.

All are free of bounds: logarithms of what must be positive, of the yield displacement of each
block instead of its stiffness, log-ratios of the weights, and in the place of F_s the log-odds of
the drop F_s - F_c within the largest there may be: friction does not vanish at speed. A block's
stiffness is then ``k_i = alpha_i F_s / yield_i``, F_s the mean of both directions.
"""

from collections.abc import Sequence

from gms_flex_control import friction as gms
from gms_flex_control.params.robot import FrictionParams
from gms_flex_control.records import build
from gms_flex_control.simulation.predictor import (
    ATTRACTION,
    BLOCKS,
    COULOMB,
    parameter_rows,
    PER_DIRECTION,
    STATIC,
    VELOCITY,
    VISCOUS,
)
import numpy as np
from scipy.special import expit

MOST_BLOCKS = 8   # of one joint; records of all joints have this many, so that one kernel serves
N_STEADY = 9      # numbers of Stribeck curves and attraction
LAG = 0.08        # of F_c over C: lag of sliding friction to begin with [s]
DROP = 0.1        # of friction where the curve has faded: F_s - F_c to begin with
LARGEST_DROP = 4.0  # likewise, at most: a curve that falls more stands for what is no friction
_MOST = 0.95 * LARGEST_DROP  # to begin with: fits hardly move what is at its bound
_FADED = 2.0      # of v_s: speed at which the curve has
STATICS = [STATIC, PER_DIRECTION + STATIC]  # places of F_s in the parameters


class Coordinates:
    """
    One joint's parameters as free numbers.

    ``n_blocks`` up to MOST_BLOCKS; ``yields`` (n_blocks,) are fixed yield displacements [rad],
    by default they are fitted; without ``free_weights`` each weight is 1/N, as in the paper;
    ``n_extra`` further linear coefficients. The attribute ``size`` is how many numbers there are,
    ``yields`` where the logarithms of the yields stand, a slice, empty where fixed.
    """

    def __init__(self, n_blocks: int, *, yields=None, free_weights=False, n_extra=0):
        self.n_blocks, self.n_extra = n_blocks, n_extra
        self._fixed = None if yields is None else np.asarray(yields, dtype=float)
        self.free_weights = free_weights and n_blocks > 1
        self.yields = slice(N_STEADY, N_STEADY + (n_blocks if yields is None else 0))
        self._weights = slice(self.yields.stop,
                              self.yields.stop + (n_blocks - 1 if free_weights else 0))
        self.size = self._weights.stop + n_extra
        self._extra = slice(self._weights.stop, self.size)

    def pack(self, static, coulomb, velocity, viscous, attraction, yields, weights=None,
             extra=()) -> np.ndarray:
        """Return the free numbers (size,) of steady (2,) parameters, yields and weights (N,)."""
        free = np.zeros(self.size)
        drop = np.maximum(np.subtract(static, coulomb), 1e-3 * np.asarray(coulomb))
        drop /= coulomb + _FADED * np.multiply(velocity, viscous)
        for k in range(2):
            free[of_direction(k)] = (np.log(coulomb[k]), log_odds(drop[k]), np.log(velocity[k]),
                                     np.log(viscous[k]))
        free[N_STEADY - 1] = np.log(attraction)
        if self._fixed is None:
            free[self.yields] = np.log(yields)
        if self.free_weights:
            weights = np.full(self.n_blocks, 1.0) if weights is None else np.asarray(weights)
            free[self._weights] = np.log(weights[:-1] / weights[-1])
        free[self._extra] = extra
        return free

    def parameters(self, free) -> np.ndarray:
        """Return (9 + 2 MOST_BLOCKS + n_extra,) parameters, the order of simulation.predictor."""
        return self.unpack(free)[0]

    def unpack(self, free) -> tuple[np.ndarray, np.ndarray]:
        """Return `parameters` (blocks beyond ``n_blocks`` carry nothing) and their Jacobian."""
        rows = parameter_rows(MOST_BLOCKS, self.n_extra)
        theta, directions = np.zeros(rows), np.zeros((rows, self.size))
        for k in range(2):
            way = of_direction(k)
            theta[way], directions[way, way] = _curve(free[way])
        theta[ATTRACTION] = directions[ATTRACTION, N_STEADY - 1] = np.exp(free[N_STEADY - 1])
        self._unpack_blocks(free, theta, directions)
        at = BLOCKS + 2 * MOST_BLOCKS
        theta[at:] = free[self._extra]
        directions[at:, self._extra] = np.eye(self.n_extra)
        return theta, directions

    def _unpack_blocks(self, free, theta, directions):
        n = self.n_blocks
        stiffness, weight = (slice(BLOCKS + k * MOST_BLOCKS, BLOCKS + k * MOST_BLOCKS + n)
                             for k in range(2))
        alpha, d_alpha = np.full(n, 1.0 / n), np.zeros((n, 0))
        if self.free_weights:
            odds = np.append(free[self._weights], 0.0)
            alpha = np.exp(odds - odds.max())
            alpha /= alpha.sum()
            d_alpha = (np.diag(alpha) - np.outer(alpha, alpha))[:, :-1]
        yields = np.exp(free[self.yields]) if self._fixed is None else self._fixed
        static, d_static = theta[STATICS].mean(), directions[STATICS].mean(axis=0)
        theta[weight], theta[stiffness] = alpha, alpha * static / yields
        directions[weight, self._weights] = d_alpha
        directions[stiffness] = np.outer(alpha / yields, d_static)
        directions[stiffness, self._weights] += d_alpha * (static / yields)[:, None]
        if self._fixed is None:
            directions[stiffness, self.yields] -= np.diag(theta[stiffness])


def log_odds(drop) -> np.ndarray:
    """Return free numbers of drops F_s - F_c, stated as parts of friction where curves fade."""
    drop = np.minimum(drop, _MOST)
    return np.log(drop / (LARGEST_DROP - drop))


def _curve(free):
    """Return parameters (4,) of the free numbers (4,) of a Stribeck curve, and their Jacobian."""
    (coulomb, velocity, viscous), share = np.exp(free[[0, 2, 3]]), expit(free[1])
    part, sliding = LARGEST_DROP * share, _FADED * velocity * viscous
    drop = part * (coulomb + sliding)
    return np.array([coulomb + drop, coulomb, velocity, viscous]), np.array([
        [coulomb + part * coulomb, (1.0 - share) * drop, part * sliding, part * sliding],
        [coulomb, 0.0, 0.0, 0.0], [0.0, 0.0, velocity, 0.0], [0.0, 0.0, 0.0, viscous]])


def of_direction(way: int) -> slice:
    """Return where numbers of a Stribeck curve stand, free or not; ``way`` 1 is backward."""
    return slice(4 * way, 4 * way + 4)


def with_both_as(free: np.ndarray, way: int) -> np.ndarray:
    """Return free numbers (P,) with the Stribeck curve of direction ``way`` in both."""
    alike = free.copy()
    alike[of_direction(1 - way)] = alike[of_direction(way)]
    return alike


def with_narrow_curves(free: np.ndarray, velocity: float) -> np.ndarray:
    """
    Return free numbers (P,) with Stribeck curves that end at ``velocity`` [rad/s].

    For such as have not ended at all: what was static friction is F_c, which lags as usual.
    """
    narrow, levels = free.copy(), []
    for way in range(2):
        numbers = of_direction(way)
        levels.append(np.log(_curve(free[numbers])[0][STATIC]))
        narrow[numbers] = levels[-1], log_odds(DROP), np.log(velocity), free[numbers][3]
    narrow[N_STEADY - 1] = np.mean(levels) - np.log(LAG)
    return narrow


def friction_record(thetas: Sequence[np.ndarray]) -> np.record:
    """Return the kernels' constants (friction.constants_layout) of all joints' parameters."""
    table = np.stack([theta[:parameter_rows(MOST_BLOCKS, 0)] for theta in thetas], axis=1)
    both = {name: table[[row, PER_DIRECTION + row]] for name, row in (
        ('static', STATIC), ('coulomb', COULOMB), ('velocity', VELOCITY), ('viscous', VISCOUS))}
    blocks = table[BLOCKS:].reshape(2, MOST_BLOCKS, -1)
    return build(gms.constants_layout(table.shape[1], MOST_BLOCKS), **both,
                 stiffness=blocks[0].T, weight=blocks[1].T, attraction=table[ATTRACTION])


def theta_of(friction: FrictionParams, joint: int) -> np.ndarray:
    """Return the parameters of a joint as FrictionParams have them, MOST_BLOCKS blocks at most."""
    acts, blocks = friction.weight[joint] > 0.0, np.zeros((2, MOST_BLOCKS))
    own = np.stack([friction.stiffness[joint], friction.weight[joint]])[:, acts][:, :MOST_BLOCKS]
    blocks[:, :own.shape[1]] = own
    sides = [[getattr(side, name)[joint] for name in ('static', 'coulomb', 'velocity', 'viscous')]
             for side in (friction.forward, friction.backward)]
    return np.concatenate([*sides, friction.attraction[[joint]], *blocks])


def yields_of(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return yield displacements [rad] and weights of the blocks of a joint that carry load."""
    stiffness, weight = theta[BLOCKS:BLOCKS + 2 * MOST_BLOCKS].reshape(2, MOST_BLOCKS)
    used = weight > 0.0
    return weight[used] * theta[STATICS].mean() / np.maximum(stiffness[used], 1e-300), weight[used]


def slipping(theta: np.ndarray, reach: float) -> np.ndarray:
    """
    Return parameters of a joint without the blocks that never slip within ``reach`` [rad].

    They carry no friction, though what they are loaded with at first may pose as a torque;
    the levels are those that the others have together.
    """
    yields, _ = yields_of(theta)
    stiffness, weight = theta[BLOCKS:BLOCKS + 2 * MOST_BLOCKS].reshape(2, MOST_BLOCKS)
    kept = np.zeros(MOST_BLOCKS, dtype=bool)
    kept[weight > 0.0] = yields < reach
    share = weight[kept].sum()
    if not kept.any() or kept.sum() == len(yields):
        return theta
    out = theta.copy()
    out[[STATIC, COULOMB, PER_DIRECTION + STATIC, PER_DIRECTION + COULOMB]] *= share
    out[BLOCKS:BLOCKS + 2 * MOST_BLOCKS] = np.concatenate(
        [np.where(kept, stiffness, 0.0), np.where(kept, weight / share, 0.0)])
    return out


def yield_quantiles(theta: np.ndarray, n_blocks: int) -> np.ndarray:
    """Return increasing yields [rad] of N equal blocks that make the same presliding curve."""
    yields, weight = yields_of(theta)
    order = np.argsort(yields)
    yields, share = np.log(yields[order]), weight[order]
    middle = np.cumsum(share) - 0.5 * share
    at = (np.arange(n_blocks) + 0.5) / n_blocks
    return np.exp(np.interp(at, np.concatenate([[0.0], middle, [1.0]]),
                            np.concatenate([yields[:1], yields, yields[-1:]])))


def equal_blocks(theta: np.ndarray, n_blocks: int) -> tuple[Coordinates, np.ndarray]:
    """Return Coordinates and free numbers of N equal blocks like those of ``theta``."""
    n_extra = len(theta) - parameter_rows(MOST_BLOCKS, 0)
    coordinates = Coordinates(n_blocks, n_extra=n_extra)
    return coordinates, coordinates.pack(
        theta[[0, 4]], theta[[1, 5]], theta[[2, 6]], theta[[3, 7]], theta[8],
        yield_quantiles(theta, n_blocks), extra=theta[len(theta) - n_extra:])


def presliding_curve(theta: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """
    Return the torque [N m] of a joint pushed from rest with unloaded blocks.

    ``displacement`` (D,) is 0 or above [rad]. Eq. (2) with the break-away of each block at
    ``alpha_i F_s``; F_s, the mean of both directions, where all blocks slip.
    """
    stiffness, weight = theta[BLOCKS:BLOCKS + 2 * MOST_BLOCKS].reshape(2, MOST_BLOCKS)
    static = theta[STATICS].mean()
    return np.minimum(np.outer(displacement, stiffness), weight * static).sum(axis=1)
