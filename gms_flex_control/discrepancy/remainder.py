# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What is left where no effect of the catalogue explains it: described, not named.

Torques that are a free function of one variable are hypotheses without a name. Where one of them
explains what is missing much better than an effect of the catalogue does, the effect only
resembles what is there.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import BLOCK_TIME
from gms_flex_control.discrepancy.describe import torque_scale
from gms_flex_control.discrepancy.evidence import finite, NormalEquations
from gms_flex_control.discrepancy.fitting import informative, numbers_of, prior_of
from gms_flex_control.discrepancy.residuals import friction_along
from gms_flex_control.discrepancy.result import Signature
from gms_flex_control.discrepancy.thresholds import EVIDENCE, PRACTICAL
from gms_flex_control.discrepancy.torque_noise import excess_torque
from gms_flex_control.discrepancy.validation import folds, gain_over, of_blocks
import numpy as np

_BINS = 24
_PERIODS = 8          # fewer in a recording are no tone
VARIABLES = {'time': 's', 'link angle': 'rad', 'motor angle': 'rad', 'link rate': 'rad/s',
             'motor rate': 'rad/s', 'torsion': 'rad', 'torque': 'N m',
             'link acceleration': 'rad/s^2', 'time since reversal': 's'}  # and their units
_KNOTS = 20           # of a function, even in the samples
_OF_TIME = 12         # likewise, of time, at most
# not of torque: a function of it may shrink the whole equation
_OF_FUNCTIONS = ('time', 'link angle', 'link rate', 'torsion')
_READ = ('link rate', 'torsion')  # angles and time are large beside the noise of encoders
_TIMES = ' times friction'  # behind the name of a variable
_SCALING = ('time', 'link angle')  # that scale friction, too
LEAST = 3.0 * PRACTICAL  # of Coulomb friction: a function that is free fits some noise
_TRIED = 4            # functions of most evidence, of which one may be real


def variables(motion, j) -> dict[str, np.ndarray]:
    """Return what a residual of joint ``j`` may depend on: dict of str to (S,)."""
    states = motion.states
    rate = states[:, 1, j]
    turned = np.concatenate([[False], rate[1:] * rate[:-1] < 0.0])
    place = np.arange(len(rate))
    since = motion.period * (place - np.maximum.accumulate(np.where(turned, place, 0)))
    return dict(zip(VARIABLES, (
        motion.time - motion.time[0], states[:, 0, j], states[:, 3, j], rate, states[:, 4, j],
        states[:, 3, j] - states[:, 0, j], motion.drive[:, j], states[:, 2, j], since),
        strict=True))


def of_others(motion, j) -> dict[str, np.ndarray]:
    """Return where the other joints are and how fast: dict of str to (S,)."""
    return {f'{name} of {joint}': motion.states[:, place, k]
            for k, joint in enumerate(motion.samples.joints) if k != j
            for place, name in enumerate(('link angle', 'link rate'))}


def dependence(values, residual) -> float:
    """Return the share of a residual's (S,) variance that bins of values explain."""
    places = np.searchsorted(_edges(values), values)
    count = np.maximum(np.bincount(places, minlength=_BINS), 1)
    means = np.bincount(places, weights=residual, minlength=_BINS) / count
    return float(np.sum(count * (means - residual.mean()) ** 2)
                 / max(np.sum((residual - residual.mean()) ** 2), 1e-300))


def _edges(values):
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)[1:-1]))


def predicted_share(places, visits, residual) -> float:
    """
    Return the share of a residual's (S,) variance that other visits of the same place predict.

    ``places`` and ``visits`` are int (S,). A torque that stays while a joint rests is a function
    of its angle, if each rest is at another one, and predicts nothing.
    """
    total, count = np.bincount(places, weights=residual), np.bincount(places)
    own, length = np.bincount(visits, weights=residual), np.bincount(visits)
    others = count[places] - length[visits]
    expected = np.where(others > 0, (total[places] - own[visits]) / np.maximum(others, 1),
                        residual.mean())
    whole = np.sum((residual - residual.mean()) ** 2)
    return max(0.0, 1.0 - float(np.sum((residual - expected) ** 2) / max(whole, 1e-300)))


def _predicted_by(name, values, residual, period):
    """Return `predicted_share` of bins of a variable, of time each in two parts."""
    if name == 'time':
        parts = (np.arange(len(residual)) * period / BLOCK_TIME).astype(int)
        return predicted_share(parts // 2, parts, residual)
    places = np.searchsorted(_edges(values), values)
    return predicted_share(places, np.cumsum(np.diff(places, prepend=places[0]) != 0), residual)


def tone(rows, period) -> tuple[float, float]:
    """Return frequency [Hz] and share of power of the strongest line of a residual (S,)."""
    power = np.abs(np.fft.rfft((rows - rows.mean()) * np.hanning(len(rows)))) ** 2
    k = int(np.argmax(power[1:])) + 1
    near = power[max(k - 2, 1):k + 3].sum()
    return k / (len(rows) * period), float(near / max(power.sum(), 1e-300))


def signature_of(likelihood, model, share, free=None, among=None) -> Signature:
    """
    Return the Signature of what a model, with all that was found, leaves.

    In the equation, of joints ``among`` these (str), default all, in which it leaves most, or of
    ``free``, the Free function that explains most of it; ``share`` is how much of what was missing
    is left.
    """
    joints, n = likelihood.robot.joints, likelihood.robot.n_joints
    torque = likelihood.torque(model)
    if free is not None:
        scale, variable = torque_scale(free.torque), free.variable
        column = joints.index(free.joint) + n * (free.equation == 'motor')
        left = np.concatenate([one[:, column] for one in torque])
        if variable == 'time' and np.mean(left) ** 2 > 0.5 * np.mean(left ** 2):
            variable = 'constant'
        return Signature(
            float(share), free.equation, free.joint, variable,
            f'{scale.text(free.torque)} {scale.unit} rms in the {free.equation} equation of '
            f'{free.joint} are '
            + ('constant.' if variable == 'constant' else _words_of(variable)))
    excess = excess_torque(likelihood, model) / np.tile(likelihood.coulomb, 2)
    if among:
        excess[~np.tile(np.isin(joints, among), 2)] = -1.0
    channel = int(np.argmax(excess))
    equation, j = ('link', channel) if channel < n else ('motor', channel - n)
    worst = int(np.argmax([np.mean(left[:, channel] ** 2) for left in torque]))
    motion, whitening = likelihood.motions[worst], likelihood.whitenings[worst]
    residual = torque[worst][:, channel]
    at = np.clip(np.searchsorted(motion.time - motion.time[0], whitening.time), 0,
                 len(motion.time) - 1)
    shares = {name: _predicted_by(name, values[at], residual, whitening.row_period)
              for name, values in (variables(motion, j) | of_others(motion, j)).items()}
    variable = max(shares, key=shares.get)
    frequency, line = tone(residual, whitening.row_period)
    rms = float(np.sqrt(np.mean(residual ** 2)))
    scale = torque_scale(rms)
    text = (f'{scale.text(rms)} {scale.unit} rms are left in the {equation} equation of '
            f'{joints[j]}')
    if np.mean(residual) ** 2 > 0.5 * rms ** 2:
        text += ', most of it constant'
        variable = 'constant'
    elif line > 0.5 and frequency * len(residual) * whitening.row_period > _PERIODS:
        text += f', most of it a tone of {frequency:.2f} Hz'
        variable = 'time'
    elif shares[variable] > 0.2:
        text += f', {100 * shares[variable]:.0f} % of it a function of {variable}'
    else:
        text += ', which follows none of position, speed, torsion, torque or time alone'
        variable = ''
    return Signature(float(share), equation, joints[j], variable, text + '.')


def _words_of(variable):
    name = variable.removesuffix(_TIMES)
    return f'{"" if name == variable else "friction times "}a function of {name}.'


# --- free functions -----------------------------------------------------------------------------


class Free(NamedTuple):
    """A function of one variable in one equation, and what it would gain."""

    joint: str
    equation: str      # 'link' or 'motor'
    variable: str
    triangles: Callable  # -> list of ndarray (S, K): its values along each recording
    noise: Callable | None = None  # likewise: how they differ in two null simulations
    evidence: float = -np.inf   # 2 log, over the model it is added to
    torque: float = 0.0         # rms of what it adds [N m]

    @property
    def place(self) -> tuple[str, str, str]:
        """Return (joint, equation, variable)."""
        return self.joint, self.equation, self.variable


class FreeFunctions:
    """
    All free functions along the recordings of a Likelihood; their values fill memory.

    What encoders misread is in rates, torsion and residuals alike: friction steps where a rate is
    misread. Functions are cleared of what that adds, as derivatives by known parameters are.
    One of the torsion is a spring's, which acts on link and motor alike: in one equation alone it
    might shrink the whole, as a function of the torque.
    """

    def __init__(self, likelihood):
        self._likelihood, self._all, robot = likelihood, [], likelihood.robot
        constants = likelihood.constants(robot, np.zeros(len(likelihood.nuisances)))
        friction = [[friction_along(motion, motion.states, constants) / likelihood.coulomb
                     for motion in run] for run in (likelihood.motions, *likelihood.pair)]
        for j, joint in enumerate(robot.joints):
            shapes, noise = _shapes(likelihood, j, [[one[:, j] for one in run]
                                                    for run in friction])
            for equation in ('link', 'motor'):
                if equation == 'motor' and (robot.arm.rigid[j] or joint in likelihood.unseen):
                    continue
                self._all += [Free(joint, equation, name, hats, noise.get(name))
                              for name, hats in shapes.items()
                              if name != 'torsion' or equation == 'link']

    def ranked(self, model, jacobian, joint=None) -> list:
        """Return the free functions beside a Fitted, list of Free, that of most evidence first."""
        normal = NormalEquations(self._likelihood, model, jacobian)
        lost = self._likelihood.noise_cleared(model, self._likelihood.weights(model.sums.groups))
        here = [one for one in self._all if joint in (None, 'arm', one.joint)]
        found = self._likelihood.pool.map(lambda one: self._gained(normal, lost, one), here)
        return sorted(found, key=lambda one: -one.evidence)

    def _gained(self, normal, lost, free):
        """Return a Free with what it gains; sums are cleared of the noise ``lost`` (R,)."""
        likelihood, level = self._likelihood, self._likelihood.level_of(free.joint)
        rows, noise = self._rows(free)
        least = normal.beside(rows, noise @ lost, pull=1.0 / level ** 2)
        scaled = level * rows
        _, occam = np.linalg.slogdet(np.eye(len(rows)) + (
            scaled * likelihood.weights(least.sums)) @ scaled.T)
        torque = np.concatenate(free.triangles()) @ least.added
        return free._replace(
            evidence=finite(normal.alone.cost - least.cost - occam - 2.0 * np.log(len(self._all))),
            torque=float(np.sqrt(np.mean(torque ** 2))))

    def _rows(self, free):
        """Return whitened residuals (K, R) of triangles and noise."""
        whitener, n = self._likelihood.whitener, self._likelihood.robot.n_joints
        j = self._likelihood.robot.joints.index(free.joint)

        def rows_of(values):
            rows = whitener.whiten_each(values, j + n * (free.equation == 'motor'))
            return (rows - whitener.whiten_each(values, j + n) if free.variable == 'torsion'
                    else rows)
        rows = rows_of(free.triangles())
        return rows, np.zeros_like(rows) if free.noise is None else rows_of(free.noise())

    def left_in(self, model, jacobian, ranked=None) -> Free | None:
        """Return the Free function, of ``ranked`` ones or all, that a model lacks, or None."""
        without = normal = None
        for free in (self.ranked(model, jacobian) if ranked is None else ranked)[:_TRIED]:
            if (free.evidence <= EVIDENCE
                    or free.torque <= LEAST * self._likelihood.level_of(free.joint)):
                continue
            rows, noise = self._rows(free)
            if without is None:
                normal = NormalEquations(self._likelihood, model, jacobian)
                without = self._predicted(normal, model, jacobian, rows[:0], rows[:0])
            gain = gain_over(self._predicted(normal, model, jacobian, rows, noise) - without)
            if gain.is_real(self._likelihood.caution):
                return free
        return None

    def _predicted(self, normal, model, jacobian, rows, noise):
        """Return log likelihoods of blocks left out (B,), with a function of ``rows`` (K, R)."""
        likelihood, numbers = self._likelihood, numbers_of(self._likelihood, model.robot)
        pull = 1.0 / likelihood.coulomb.max() ** 2
        weight = likelihood.weights(normal.beside(rows, pull=pull).sums)
        prior, every = prior_of(likelihood, model, numbers), np.concatenate(
            [informative(likelihood, model, jacobian), rows])
        free = np.concatenate([prior.free, np.ones(len(rows), dtype=bool)])
        towards = np.concatenate([prior.pull * prior.values, np.zeros(len(rows))])
        pull = np.concatenate([prior.pull, np.full(len(rows), pull)])
        parts = list(folds(likelihood))
        kept = weight * ~np.array(parts)
        slopes = np.concatenate([likelihood.noise_slopes(model, kept, numbers),
                                 noise @ likelihood.noise_cleared(model, kept).T])
        slopes -= every @ (kept * model.whitened).T + towards[:, None]
        grams = [(every[:, part] * weight[part]) @ every[:, part].T for part in parts]
        out, step = np.zeros(likelihood.groups.blocks), np.zeros(len(every))
        for k, left_out in enumerate(parts):
            gram = np.diag(pull) + sum(one for m, one in enumerate(grams) if m != k)
            step[free] = np.linalg.lstsq(gram[np.ix_(free, free)], slopes[free, k], rcond=1e-12)[0]
            out += of_blocks(likelihood, left_out, model.whitened + step @ every, weight)
        return out


def _shapes(likelihood, j, friction):
    """
    Return triangles over variables of joint ``j``, and how null simulations of them differ.

    Both by name as of `Free`; the second where noise is not small beside the variable.
    ``friction`` is that of the model, in Coulomb frictions, of recordings and null simulations.
    """
    motions, found, noise = likelihood.motions, {}, {}
    own, *null = ([variables(motion, j) for motion in run] for run in (motions, *likelihood.pair))
    others = [of_others(motion, j) for motion in motions]
    longest = max(motion.time[-1] - motion.time[0] for motion in motions)
    acting, *misread = friction
    apart = [one - two for one, two in zip(*misread, strict=True)]
    for name in (*_OF_FUNCTIONS, *(name for name in others[0] if name.startswith('link angle'))):
        if name == 'torsion' and (likelihood.robot.arm.rigid[j]
                                  or likelihood.robot.joints[j] in likelihood.unseen):
            continue
        values = [one[name] for one in (own if name in _OF_FUNCTIONS else others)]
        # a block of time that is left out must not hold a knot alone
        knots = int(np.clip(longest / (2.0 * BLOCK_TIME), 3, _OF_TIME)
                    ) if name == 'time' else _KNOTS
        at = np.unique(np.quantile(np.concatenate(values), np.linspace(0.0, 1.0, knots)))
        found[name] = partial(_along, values, at)
        if name in _READ:
            noise[name] = partial(_apart, *([one[name] for one in run] for run in null), at)
        if name in _SCALING:
            scaled = name + _TIMES
            found[scaled] = partial(_along, values, at, acting)
            noise[scaled] = partial(_along, values, at, apart)
    return found, noise


def _along(values, at, factors=None):
    """Return triangles (S, K) of each of values (S,), with tops at knots (K,), times factors."""
    found = [_hats(one, at) for one in values]
    return found if factors is None else [
        hats * factor[:, None] for hats, factor in zip(found, factors, strict=True)]


def _apart(ones, twos, at):
    """Return by how much the triangles of values (S,) differ, list of (S, K)."""
    return [_hats(one, at) - _hats(two, at) for one, two in zip(ones, twos, strict=True)]


def _hats(values, at):
    """Return triangles (S, K) of values (S,) with their tops at knots (K,)."""
    hats = np.zeros((len(values), len(at)))
    if len(at) == 1:
        return hats + 1.0
    left = np.clip(np.searchsorted(at, values) - 1, 0, len(at) - 2)
    share = np.clip((values - at[left]) / np.diff(at)[left], 0.0, 1.0)
    sample = np.arange(len(values))
    hats[sample, left], hats[sample, left + 1] = 1.0 - share, share
    return hats
