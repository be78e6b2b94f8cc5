# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What residuals depend on, before and after: the curves and maps behind pictures and charts."""

from dataclasses import dataclass, replace
from typing import NamedTuple

from gms_flex_control.discrepancy import remainder
from gms_flex_control.discrepancy.torque_noise import drawn_noise
from gms_flex_control.effects.registry import find
import numpy as np
from scipy.special import stdtrit

UNITS = remainder.VARIABLES | {'direction': '', 'distance since reversal': 'rad'}
BINS = 36
_LEAST = 6            # samples of a bin
_MOVING = 0.05        # of the rms rate: slower is at rest
_BETTER = 0.05        # share by which another factor, or joint, must improve
_STRANGE = 0.4        # likewise another variable than the one an effect names
_INDEPENDENT = 0.4    # share of the samples behind the low-pass that are on their own
_PERIODS = 3.0        # so many waves over a range are laid upon each other
_MAP_BINS, _OF_CELL, _LEAST_CELL = (8, 20), 12, 3.0  # samples of a cell in the mean, at least
_SEED = 991           # of the null simulation


class Binned(NamedTuple):
    """Means of a residual over bins of a variable, each with its 95 % band."""

    x: np.ndarray      # mean of the variable, shape (B,)
    mean: np.ndarray   # shape (B,)
    half: np.ndarray   # half width of the band, shape (B,)


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """How one effect shows."""

    effect: str      # the finding
    joint: str
    equation: str    # 'link' or 'motor', where it shows most
    of_joint: str    # joint of that equation
    x_label: str     # with unit
    times: str       # what the residual is multiplied by; '' for nothing
    x: np.ndarray    # (S,) variable
    y: np.ndarray    # (S,) residual without the effect [N m]
    before: Binned   # the residual without the effect
    after: Binned    # with it
    own: Binned      # what the effect itself contributes

    @property
    def title(self) -> str:
        """Return what is shown, without the name of the effect."""
        times = f', times {self.times}' if self.times else ''
        return f'missing in the {self.equation} equation of {self.of_joint}{times}'


class Along:
    """Residuals and variables of all recordings of a Likelihood, where filters are settled."""

    def __init__(self, likelihood):
        self.likelihood = likelihood
        self.joints = likelihood.robot.joints
        self._variables = {}

    def _kept(self, rows):
        """Return rows (S', ...) of each recording where filters are settled, joined (S, ...)."""
        return np.concatenate([one[whitening.settled] for one, whitening in zip(
            rows, self.likelihood.whitenings, strict=True)])

    def residual(self, model) -> np.ndarray:
        """Return residual torques (S, 2n) of a Fitted behind the low-pass [N m]."""
        return self._kept(self.likelihood.torque(model))

    def null(self, model) -> np.ndarray:
        """Return residuals (S, 2n) of a null simulation of a Fitted, torque noise in it."""
        likelihood = self.likelihood
        generators = [np.random.default_rng([_SEED, m]) for m in range(len(likelihood.motions))]
        runs = likelihood.null_simulations(model.robot, model.x)(generators)
        return self._kept([
            whitening.low_passed(left + drawn_noise(likelihood, m, generators[m]))
            for m, (left, whitening) in enumerate(zip(
                likelihood.unexplained(runs, model.robot, model.x), likelihood.whitenings,
                strict=True))])

    def variables(self, j) -> dict[str, np.ndarray]:
        """Return what residuals of joint ``j`` may depend on, dict of str to (S,)."""
        if j not in self._variables:
            parts = []
            for motion, whitening in zip(self.likelihood.motions, self.likelihood.whitenings,
                                         strict=True):
                time, settled = motion.time - motion.time[0], whitening.time[whitening.settled]
                known = remainder.variables(motion, j) | further(motion, j)
                parts.append({name: np.interp(settled, time, values)
                              for name, values in known.items()})
            self._variables[j] = {name: np.concatenate([part[name] for part in parts])
                                  for name in parts[0]}
        return self._variables[j]

    def channels(self, j) -> list[tuple[str, int]]:
        """Return (equation, column) of each equation of joint ``j``."""
        if self.likelihood.robot.arm.rigid[j]:
            return [('link', j)]
        return [('link', j), ('motor', len(self.joints) + j)]


class AlongUnfiltered(Along):
    """Likewise at every sample of the equations: a low-pass hides nothing."""

    def _kept(self, rows):
        return np.concatenate([one[motion.settled] for one, motion in zip(
            rows, self.likelihood.motions, strict=True)])

    def residual(self, model) -> np.ndarray:
        """Return residual torques (S, 2n) of a Fitted [N m]."""
        return self._kept(self.likelihood.unexplained(
            self.likelihood.motions, model.robot, model.x))

    def variables(self, j) -> dict[str, np.ndarray]:
        """Return what residuals of joint ``j`` may depend on, dict of str to (S,)."""
        parts = [remainder.variables(motion, j) | further(motion, j)
                 for motion in self.likelihood.motions]
        return {name: self._kept([part[name] for part in parts]) for name in parts[0]}


def further(motion, j) -> dict[str, np.ndarray]:
    """Return which way joint ``j`` moves and how far since it turned: dict of str to (S,)."""
    angle, rate = motion.states[:, 0, j], motion.states[:, 1, j]
    last = np.maximum.accumulate(np.where(rate != 0.0, np.arange(len(rate)), 0))
    turns = np.concatenate([[True], np.diff(np.sign(rate[last])) != 0.0])
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle)))])
    return {'direction': np.sign(rate) * _moves(rate),
            'distance since reversal':
                travelled - np.maximum.accumulate(np.where(turns, travelled, 0.0))}


def _moves(rate):
    """Return where a joint moves, by its rates (S,), bool."""
    return np.abs(rate) > _MOVING * np.sqrt(np.mean(rate ** 2))


def binned(x, y, edges=None) -> Binned:
    """
    Return the Binned means of y (S,) over bins of x (S,); bins of few samples are left out.

    ``edges`` are inner ones, so that others have the same.
    """
    edges = bin_edges(x) if edges is None else edges
    places = np.searchsorted(edges, x)
    count = np.bincount(places, minlength=len(edges) + 1).astype(float)
    full = count >= _LEAST

    def means(values):
        return np.bincount(places, weights=values, minlength=len(count))[full] / count[full]
    mean = means(y)
    spread = np.sqrt(np.maximum(means(y ** 2) - mean ** 2, 0.0))
    return Binned(means(x), mean, 1.96 * spread / np.sqrt(_INDEPENDENT * count[full]))


def bin_edges(x) -> np.ndarray:
    """Return inner edges of bins of x (S,), half of them even in x, half in samples."""
    bins = int(np.clip(len(x) // (4 * _LEAST), 4, BINS))
    even = np.linspace(*np.quantile(x, (0.003, 0.997)), bins // 2 + 1)
    alike = np.quantile(x, np.linspace(0.0, 1.0, bins // 2 + 1)[1:-1])
    return np.unique(np.concatenate([even, alike]))


def evidence_of(along, model, finding) -> Evidence:
    """
    Return how a Finding of a Fitted shows against its own variable, an Evidence.

    Friction changes sign with the motion: where the effect's contribution follows its variable
    better after multiplication by the sign of the link's rate, that is what is shown, of samples
    that move. Over time, the residual is shown in the direction of the effect's contribution,
    which the noise knows nothing of.
    """
    specs = model.robot.effects
    spec = next(one for one in specs if one.key == finding.key)
    less = replace(model.robot, effects=tuple(one for one in specs if one is not spec))
    after, before = along.residual(model), along.residual(replace(model, robot=less))
    j, equation, column = _strongest(along, before - after, finding.joint)
    own = before[:, column] - after[:, column]
    x, x_label, sign, times = _shown_over(along, spec, own, j)
    used = sign != 0.0
    x, own, y, rest = (values[used] * factor for values, factor in (
        (x, 1.0), (own, sign[used]), (before[:, column], sign[used]),
        (after[:, column], sign[used])))
    edges = bin_edges(x)
    return Evidence(
        effect=spec.name, joint=spec.joint, equation=equation, of_joint=along.joints[j],
        x_label=x_label, times=times, x=x, y=y, before=binned(x, y, edges),
        after=binned(x, rest, edges), own=binned(x, own, edges))


def follows(x, y) -> float:
    """Return the share of the mean square of y (S,) that its means over bins of x make."""
    places = np.searchsorted(bin_edges(x), x)
    count = np.maximum(np.bincount(places), 1)
    return float(np.sum(np.bincount(places, weights=y) ** 2 / count) / max(np.sum(y ** 2), 1e-300))


def _shown_over(along, spec, own, j):
    """Return variable (S,), its label, factor of the residual (S,) and the factor's name."""
    wanted, rate = find(spec.name).evidence, along.variables(j)['link rate']
    if wanted == 'time':
        return (along.variables(j)[wanted], 'time [s]', np.where(own < 0.0, -1.0, 1.0),
                'the sign of the effect')
    moving = _moves(rate)
    factors = [(np.ones(len(own)), '')]
    if moving.sum() > _LEAST * 8:
        factors.append((np.sign(rate) * moving, 'the direction of motion'))
    tried = []
    for i, joint in enumerate(along.joints):
        for name in remainder.VARIABLES:
            values = along.variables(i)[name]
            x, label = _folded(spec, name, values)
            label = label if i == j else label.replace(name, f'{name} of {joint}')
            for sign, times in factors if name != 'time' else ():
                used = sign != 0.0
                share = follows(x[used], (sign * own)[used]) - _BETTER * (bool(times) + (i != j))
                tried.append((share - _STRANGE * (name != wanted), (x, label, sign, times)))
    return max(tried, key=lambda one: one[0])[1]


def _strongest(along, own, joint):
    """Return joint index, equation and column in which an effect contributes most."""
    candidates = [(float(np.std(own[:, column])), j, equation, column)
                  for j in range(len(along.joints)) if joint in (along.joints[j], 'arm')
                  for equation, column in along.channels(j)]
    return max(candidates)[1:]


def _folded(spec, name, x):
    """Return a variable and its label, waves of a known order laid upon each other."""
    values = dict(zip((p.name for p in find(spec.name).parameters), spec.values, strict=True))
    order = values.get('order', 0.0)
    if 'angle' in name and order > 0.0 and np.ptp(x) > _PERIODS * 2.0 * np.pi / order:
        return (np.mod(x, 2.0 * np.pi / order),
                f'{name} within a period of order {order:.3g} [rad]')
    return x, f'{name} [{UNITS[name]}]'


class Map(NamedTuple):
    """Mean residual over two variables, before and after; zero where that is chance."""

    title: str
    x_label: str
    y_label: str
    x_edges: np.ndarray
    y_edges: np.ndarray
    before: np.ndarray  # (X, Y), NaN where there are few samples
    after: np.ndarray


def maps_of(along, before, after, j) -> list:
    """Return Maps of the residuals (S, 2n) of two models in the equations of joint ``j``."""
    values, rigid = along.variables(j), along.likelihood.robot.arm.rigid[j]
    pairs = [(0, 'link angle', 'link rate'), (0, 'link acceleration', 'link rate')]
    pairs += [(0, 'torque', 'link rate')] if rigid else [(1, 'torsion', 'motor rate'),
                                                         (1, 'motor angle', 'motor rate')]
    bins, found = int(np.clip(np.sqrt(len(before) / _OF_CELL), *_MAP_BINS)), []
    for which, first, second in pairs:
        equation, column = along.channels(j)[which]
        edges = [np.linspace(*np.quantile(values[name], (0.01, 0.99)), bins + 1)
                 for name in (first, second)]
        found.append(Map(f'{equation} equation', f'{first} [{UNITS[first]}]',
                         f'{second} [{UNITS[second]}]', *edges,
                         *(_mean_over(values[first], values[second], residual[:, column], edges)
                           for residual in (before, after))))
    return found


def _mean_over(x, y, residual, edges):
    """Return means over cells (X, Y), zero where their 95 % interval holds it, NaN of few."""
    count, mean, square = (np.histogram2d(x, y, edges, weights=weights)[0]
                           for weights in (None, residual, residual ** 2))
    few, count = count < _LEAST_CELL, np.maximum(count, _LEAST_CELL)
    mean, square = mean / count, square / count
    alone = np.maximum(_INDEPENDENT * count, 1.5)
    half = stdtrit(np.maximum(alone - 1.0, 1.0), 0.975) * np.sqrt(
        np.maximum(square - mean ** 2, 0.0) / alone)
    return np.where(few, np.nan, np.where(np.abs(mean) > half, mean, 0.0))


class Over(NamedTuple):
    """What is missing in an equation, as a function of one variable."""

    joint: str
    equation: str      # 'link' or 'motor'
    variable: str      # with its unit
    before: Binned     # known parameters re-tuned
    after: Binned      # with the effects found
    shares: tuple      # of the residual that is a function of it: before, after, by chance
    off_zero: tuple    # of the bins whose 95 % band leaves zero out: likewise


def over_all(along, *residuals) -> list[Over]:
    """Return Overs of residuals (S, 2n) before, after, and of a null simulation (chance)."""
    found = []
    for j, joint in enumerate(along.joints):
        for equation, column in along.channels(j):
            for name, x in along.variables(j).items():
                edges, own = bin_edges(x), [residual[:, column] for residual in residuals]
                curves = [binned(x, one, edges) for one in own]
                found.append(Over(
                    joint, equation, f'{name} [{UNITS[name]}]' if UNITS[name] else name,
                    curves[0], curves[1],
                    tuple(remainder.dependence(x, one) for one in own),
                    tuple(float(np.mean(np.abs(one.mean) > one.half)) for one in curves)))
    return found


def over_of(result) -> list[Over]:
    """Return what the residuals of a Discrepancy depend on, list of Over; of bad data none."""
    if result.behind is None:
        return []
    along = Along(result.behind.likelihood)
    return over_all(along, *residuals_of(along, result.behind))


def residuals_of(along, behind) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals (S, 2n) before, after, and of a null simulation."""
    return along.residual(behind.before), along.residual(behind.after), along.null(behind.after)
