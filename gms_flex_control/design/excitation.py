# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A Fourier series that excites the base parameters of an arm of a URDF within its limits.

It minimises the condition number of what `gms_flex identify --estimate all` inverts: the
regressor of base parameters, rows over the noise of their joint, friction eliminated joint by
joint, columns scaled to unit length (Swevers, Ganseman, Tuekel, De Schutter and Van Brussel
1997). Limits enter as penalties, and are checked on the dense trajectory. Links are capsules
around the lines from joint to joint; pairs that overlap in every pose count as one body.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from gms_flex_control import records
from gms_flex_control.dynamics import chain, spatial
from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware.limits import Limits, UNLIMITED
from gms_flex_control.identification.inertial_parameters import base_of, link_regressors
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.trajectory.builders import fourier, sinusoid
from gms_flex_control.trajectory.polynomials import Trajectory
import numpy as np
from scipy.optimize import minimize

_PER_WAVE = 12        # samples of a period of the highest harmonic, for the search
_KEPT = 0.94          # of a limit, for the search
_PENALTY = 300.0      # of a squared excess over that, relative to the limit
_SIZE = 0.1           # worth of larger columns beside a smaller condition number
_ITERATIONS = 40      # of each start
_STARTS = 2
_DENSE = 2e-3         # between samples that are checked [s]
_SHRINK, _LONGER, _CORRECTIONS = 0.97, 1.2, 80  # of amplitudes and of the ramps
_THICK = 0.05         # radius of the capsules over the arm's length
_POSES = 200
_TURN = np.pi         # range of a joint without one [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounds:
    """What a motion must keep, (n,) each; infinite where there is no limit."""

    lower: np.ndarray         # [rad]
    upper: np.ndarray
    velocity: np.ndarray      # [rad/s]
    acceleration: np.ndarray  # [rad/s^2]
    torque: np.ndarray        # [N m]

    @classmethod
    def of_robot(cls, robot: RobotParams, limits: Limits | None = None,
                 acceleration: float = np.inf) -> 'Bounds':
        """Return those of the robot's URDF, narrowed by ``limits`` and ``acceleration``."""
        frames, offset = robot.arm.frames, robot.arm.offset
        own = {'lower': frames.lower - offset, 'upper': frames.upper - offset,
               'velocity': frames.velocity, 'torque': frames.effort}
        for name in own if limits is not None else ():
            given = getattr(limits, name)
            narrower = np.maximum if name == 'lower' else np.minimum
            own[name] = narrower(own[name], np.where(np.abs(given) < UNLIMITED, given, own[name]))
        return cls(**own, acceleration=np.full(robot.n_joints, float(acceleration)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Excitation:
    """A planned motion."""

    joints: tuple
    sine: np.ndarray      # (K, n) of harmonics [rad]
    cosine: np.ndarray    # (K, n)
    offset: np.ndarray    # (n,), where it begins and ends at rest [rad]
    period: float         # [s]
    repeats: int
    ramp_time: float      # [s]
    condition: float      # number of the regressor along the series
    usual: float          # of sinusoids over the same time and range, each joint its own
    parameters: int       # base parameters
    used: dict            # largest share of each limit, 'velocity' and so on; 1 is the limit
    clearance: float      # least distance between capsules [m]; infinite where none is checked

    @property
    def trajectory(self) -> Trajectory:
        """Return the motion."""
        return fourier(self.sine, self.cosine, self.period, repeats=self.repeats,
                       ramp_time=self.ramp_time).displaced(self.offset)

    @property
    def values(self) -> dict:
        """Return the parameters of trajectory_node."""
        values = {'trajectory.type': 'fourier', 'trajectory.autostart': True,
                  'trajectory.repeats': self.repeats, 'trajectory.ramp_time': self.ramp_time}
        for j, joint in enumerate(self.joints):
            values |= {f'trajectory.{joint}.{name}': value for name, value in (
                ('period', self.period), ('offset', float(self.offset[j])),
                ('sine', self.sine[:, j].tolist()), ('cosine', self.cosine[:, j].tolist()))}
        return values


def condition_number(angle, rate, acceleration, robot: RobotParams, lead=None) -> tuple:
    """Return condition number and column sizes of the base regressor along a motion (S, n)."""
    lead = base_of(robot.arm)[0] if lead is None else lead
    columns = link_regressors(angle, rate, acceleration, robot.arm)[:, :, lead]
    level = 0.5 * (robot.friction.forward.coulomb + robot.friction.backward.coulomb)
    gram = np.zeros((len(lead), len(lead)))
    for j in range(robot.n_joints):
        friction = np.stack([np.sign(rate[:, j]), rate[:, j], np.ones(len(rate))], axis=1)
        basis = np.linalg.qr(friction)[0]
        rows = columns[:, j] / level[j]
        rows = rows - basis @ (basis.T @ rows)
        gram += rows.T @ rows
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values = np.linalg.eigvalsh(gram / np.outer(size, size))
    return float(np.sqrt(values[-1] / max(values[0], 1e-300))), size / np.sqrt(len(rate))


def plan_excitation(robot: RobotParams, bounds: Bounds, *, period: float = 10.0,
                    harmonics: int = 5, repeats: int = 2, radius: float | None = None,
                    seed: int = 0, say: Callable[[str], object] = lambda text: None) -> Excitation:
    """
    Plan a motion of a robot of kind urdf within bounds, with the least condition number.

    Its friction counts for the torque, and as its noise. ``period`` [s] is of the first harmonic,
    ``radius`` [m] of the links as capsules: by default 5 % of the arm's length, 0 checks no
    collisions; ``seed`` is of the starts of the search. ConfigError if no motion keeps the bounds.
    """
    problem = _Problem(robot, bounds, period, harmonics, radius)
    best, rng = None, np.random.default_rng(seed)
    for k in range(_STARTS):
        say(f'search {k + 1} of {_STARTS}')
        begin = problem.start(rng)
        found = minimize(problem.cost, begin, method='L-BFGS-B',
                         options={'maxiter': _ITERATIONS, 'maxfun': np.inf})
        if best is None or found.fun < best.fun:
            best = found
    return problem.within(best.x, repeats)


class _Problem:
    """The search for one motion; its numbers x are coefficients and offsets over ranges."""

    def __init__(self, robot, bounds, period, harmonics, radius):
        self.robot, self.bounds, self._period, self._harmonics = robot, bounds, period, harmonics
        self._lead = base_of(robot.arm)[0]
        lower, upper = np.maximum(bounds.lower, -_TURN), np.minimum(bounds.upper, _TURN)
        if not np.all(lower < upper):
            j = int(np.argmin(upper - lower))
            raise ConfigError(f'{robot.joints[j]} has no range: lower {lower[j]:.4g}, upper '
                              f'{upper[j]:.4g} rad; correct its limits')
        self._middle, self._range = 0.5 * (lower + upper), 0.5 * (upper - lower)
        self._capsules = Capsules(robot.arm, radius)
        omega = 2.0 * np.pi / period * np.arange(1, harmonics + 1)
        time = period * np.arange(_PER_WAVE * harmonics) / (_PER_WAVE * harmonics)
        sine, cosine = np.sin(omega * time[:, None]), np.cos(omega * time[:, None])
        self._bases = [np.concatenate(pair, axis=1) for pair in (
            (sine, cosine), (omega * cosine, -omega * sine),
            (-omega ** 2 * sine, -omega ** 2 * cosine))]
        self._omega = np.tile(omega, 2)

    def start(self, rng) -> np.ndarray:
        """Return numbers to begin with, well within the ranges and velocities."""
        n = self.robot.n_joints
        found = rng.standard_normal((2 * self._harmonics + 1, n)) / np.sqrt(self._harmonics)
        fastest = np.minimum(self.bounds.velocity, 1e3) / self._range
        found[:-1] *= np.minimum(0.25, 0.25 * fastest / self._omega[:, None])
        found[-1] *= 0.1
        return found.ravel()

    def _numbers(self, x):
        """Return coefficients (2 K, n) and offsets (n,)."""
        table = x.reshape(-1, self.robot.n_joints) * self._range
        return table[:-1], self._middle + table[-1]

    def motion(self, x) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return angle, rate and acceleration (S, n) over one period."""
        coefficients, offset = self._numbers(x)
        angle, rate, acceleration = (basis @ coefficients for basis in self._bases)
        return angle + offset, rate, acceleration

    def cost(self, x) -> float:
        """Return the logarithm of the condition number, with penalties."""
        motion = self.motion(x)
        number, size = condition_number(*motion, self.robot, self._lead)
        excess = np.concatenate([np.maximum(one - _KEPT, 0.0).ravel()
                                 for one in self.shares(*motion).values()])
        return np.log(number) - _SIZE * np.mean(np.log(size)) + _PENALTY * np.sum(
            excess ** 2) / len(motion[0])

    def shares(self, angle, rate, acceleration) -> dict[str, float]:
        """Return by name what a motion (S, n) takes of each limit, 1 at the limit."""
        bounds, arm = self.bounds, self.robot.arm
        middle = 0.5 * (bounds.lower + bounds.upper)
        ranged = np.isfinite(bounds.upper - bounds.lower)
        half = np.where(ranged, 0.5 * (bounds.upper - bounds.lower), np.inf)
        torque = chain.inverse_dynamics(angle, rate, acceleration, arm) + np.where(
            arm.rigid, 0.0, arm.motor_inertia) * acceleration
        torque += self._friction(rate)
        return {'position': np.abs(angle - np.where(ranged, middle, 0.0)) / half,
                'velocity': np.abs(rate) / bounds.velocity,
                'acceleration': np.abs(acceleration) / bounds.acceleration,
                'torque': np.abs(torque) / bounds.torque,
                'collision': self._capsules.shares(angle)}

    def _friction(self, rate):
        forward, backward = self.robot.friction.forward, self.robot.friction.backward
        way = np.tanh(rate / np.maximum(forward.velocity, 1e-6))
        return np.where(rate > 0.0, way * forward.coulomb + forward.viscous * rate,
                        way * backward.coulomb + backward.viscous * rate)

    def within(self, x, repeats) -> Excitation:
        """Return the Excitation, smaller or with longer ramps until all of it is within."""
        coefficients, offset = self._numbers(x)
        ramp, count = max(0.2 * self._period, 1.0), self._harmonics
        for _ in range(_CORRECTIONS):
            found = Excitation(
                joints=self.robot.joints, sine=coefficients[:count],
                cosine=coefficients[count:], offset=offset, period=self._period,
                repeats=repeats, ramp_time=ramp, condition=np.nan, usual=np.nan,
                parameters=len(self._lead), used={}, clearance=np.inf)
            trajectory = found.trajectory
            time = np.arange(0.0, trajectory.end, _DENSE)
            motion = np.moveaxis(trajectory.sample(time)[:, :3], 1, 0)
            shares = self.shares(*motion)
            over = {name: float(one.max(initial=0.0)) for name, one in shares.items()}
            if max(over.values()) <= 1.0:
                return self._rated(found, motion, time, over)
            worst = max(shares, key=lambda name: over[name])
            at = time[int(np.argmax(shares[worst].max(axis=1)))]
            if ramp <= at <= trajectory.end - ramp or worst in ('position', 'collision'):
                coefficients = _SHRINK * coefficients
            else:
                ramp *= _LONGER
        raise ConfigError(f'no motion within the limits was found: {worst} is '
                          f'{over[worst]:.3g} times its limit even at rest or nearly so; give '
                          'more room (--limits, --radius), or a longer --period')

    def _rated(self, found, motion, time, used):
        inner = (time >= found.ramp_time) & (time < found.ramp_time + self._period)
        own, _ = condition_number(*(one[inner] for one in motion), self.robot, self._lead)
        usual, _ = condition_number(*self.usual_motion(), self.robot, self._lead)
        return replace(found, condition=own, usual=usual, used={
            name: share for name, share in used.items() if share > 0.0},
            clearance=self._capsules.least(motion[0]))

    def usual_motion(self) -> np.ndarray:
        """Return a motion (S, n) for comparison: sinusoids over half of what the limits allow."""
        n = self.robot.n_joints
        period = self._period / (1.0 + np.arange(n) % self._harmonics)
        fastest = np.minimum(self.bounds.velocity, 1e3) * period / (2.0 * np.pi)
        steepest = np.minimum(self.bounds.acceleration, 1e3) * (period / (2.0 * np.pi)) ** 2
        size = 0.5 * np.minimum(self._range, np.minimum(fastest, steepest))
        motion = sinusoid(size, period, ramp_time=1e-3).displaced(self._middle)
        time = 1e-3 + np.arange(0.0, self._period, _DENSE)
        return np.moveaxis(motion.sample(time)[:, :3], 1, 0)


class Capsules:
    """
    The links of an arm of kind urdf as capsules of one radius.

    It is 5 % of the arm's length by default, 0 for no capsules [m].
    """

    def __init__(self, arm: ArmParams, radius: float | None = None):
        frames = arm.frames
        length = np.linalg.norm(np.vstack([frames.position, frames.end]), axis=1).sum()
        self.radius = _THICK * length if radius is None else radius
        com = arm.com.copy()
        com[-1] = frames.end
        self._arm = replace(arm, com=com)
        self.pairs = ()
        if self.radius > 0.0:
            pairs = list(combinations(range(arm.n_joints + 1), 2))
            apart = self._distances(chain.configurations(arm, _POSES), pairs).max(axis=0)
            self.pairs = tuple(pair for pair, far in zip(pairs, apart, strict=True)
                               if pair[1] - pair[0] > 1 and far > 2.0 * self.radius)

    def _distances(self, angle, pairs):
        """Return the distances (S, P) of the lines of pairs of links [m]."""
        n = self._arm.n_joints
        places = np.zeros((len(angle), n + 2, 3))  # the base begins at its origin
        spatial.places_along(np.ascontiguousarray(angle), chain.constants_of(self._arm),
                             records.build(chain.work_layout(n)), places[:, 1:])
        first, second = np.array(pairs, dtype=int).reshape(-1, 2).T
        return segment_distance(places[:, first], places[:, first + 1], places[:, second],
                                places[:, second + 1])

    def least(self, angle) -> float:
        """Return the least gap between capsules along angles (S, n) [m]."""
        return float(self._distances(angle, self.pairs).min(initial=np.inf)) - 2.0 * self.radius

    def shares(self, angle) -> np.ndarray:
        """Return the distance that two lines must keep over the one they have (S, P)."""
        return 2.0 * self.radius / np.maximum(self._distances(angle, self.pairs), 1e-9)


def segment_distance(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return distances (...) between lines a-b and c-d (..., 3) [m] (Ericson 2005, 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (np.maximum(np.sum(x * y, axis=-1), floor) for x, y, floor in (
        (u, u, 1e-18), (v, v, 1e-18), (u, v, -np.inf)))
    uw, vw = np.sum(u * w, axis=-1), np.sum(v * w, axis=-1)
    across = uu * vv - uv ** 2
    s = np.where(across > 1e-12 * uu * vv,
                 np.clip((uv * vw - vv * uw) / np.where(across > 0.0, across, 1.0), 0.0, 1.0), 0.0)
    t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
    s = np.clip((uv * t - uw) / uu, 0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)


def sentence(plan: Excitation, joints: Sequence[str]) -> str:
    """Return what a plan does in one sentence."""
    nearest = max(plan.used, key=plan.used.get, default='position')
    return (f'The motion of {len(joints)} joints excites {plan.parameters} base parameters with '
            f'a condition number of {plan.condition:.3g}; sinusoids of the same ranges have '
            f'{plan.usual:.3g}. It comes nearest to the limits of {nearest}, '
            f'{100.0 * plan.used.get(nearest, 0.0):.0f} % of them.')
