# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Torque noise of drives and loads, which no encoder makes: its white part, and all of it.

The quietest octave distinguishes the white part: noise shows in every octave, a missing effect
in some.
"""

from gms_flex_control.discrepancy.result import Noise
from gms_flex_control.discrepancy.thresholds import PRACTICAL_FLOOR
import numpy as np

_MEDIAN = 0.4549       # of the square of a standard normal number
_DRAWS = 4             # of unit noise
_OCTAVES_OF_NOISE = 3  # highest ones, of which the quietest shows the white part of noise
_EVEN = 2.0            # times the white part: noise of more is slow or fast
_FAST_OCTAVES = 2      # highest ones: above 5 Hz


def drawn_noise(likelihood, m, rng, size=None) -> np.ndarray:
    """Return the residual torque (S, 2 n) of white torque noise of a ``size`` in a recording."""
    motion, n = likelihood.motions[m], likelihood.robot.n_joints
    size = np.broadcast_to(likelihood.noise[m] if size is None else size, 2 * n)
    drawn = size * rng.standard_normal((len(motion.samples.time), 2 * n))
    unseen = [link.joint for link in motion.samples.unseen]
    computed = np.zeros((len(motion.samples.time), n))
    computed[:, unseen], drawn[:, unseen] = drawn[:, unseen], 0.0
    return np.concatenate([motion.through_filter(drawn[:, :n]),
                           motion.through_filter(drawn[:, n:])],
                          axis=1) + _moving_links(likelihood, m, computed)


def _moving_links(likelihood, m, torque):
    """Return the residual torque (S, 2 n) of noise (T, n) from which links are computed."""
    largest = np.max(np.std(torque, axis=0) / likelihood.coulomb)
    if largest == 0.0:
        return 0.0
    # small, so that friction along the links is nearly linear in it
    share, motion = PRACTICAL_FLOOR / largest, likelihood.null.pair[0][m]
    noisy = motion.with_torque(object(), lambda command: command + share * torque)
    with_it, without = likelihood.unexplained(
        [noisy, motion], likelihood.null.robot, likelihood.null.x)
    return (with_it - without) / share


def white_noise(likelihood, model) -> np.ndarray:
    """
    Return the white torque noise beyond the null simulations, (M, 2 n) per sample [N m].

    Nuisance parameters of ``model`` are re-tuned. The quietest of the high octaves decides:
    what is missing shows in some, noise in all. It is not more than drives make.
    """
    out, squares, groups = np.zeros_like(likelihood.noise), model.whitened ** 2, likelihood.groups
    for m in range(len(likelihood.motions)):
        mine = groups.recording == m
        unit = [np.zeros((len(one.time), out.shape[1])) for one in likelihood.motions]
        response = np.zeros(int(mine.sum()))
        for k in range(_DRAWS):
            rng = np.random.default_rng([likelihood.seed, 8, k, m])
            unit[m] = drawn_noise(likelihood, m, rng, 1.0)
            response += likelihood.whitener.whiten(unit)[mine] ** 2 / _DRAWS
        for c in range(out.shape[1]):
            excess = []
            for octave in range(_OCTAVES_OF_NOISE):
                here = (groups.channel[mine] == c) & (groups.part[mine] == octave)
                if here.any():  # by medians: what is missing acts in some moments
                    size = np.maximum(response[here], 1e-300)
                    clean = np.mean(likelihood.clean[:, mine][:, here] ** 2, axis=0)
                    excess.append(np.median((squares[mine][here] - _MEDIAN * clean) / size)
                                  / _MEDIAN * (1.0 + 1.0 / np.sqrt(here.sum())))
            if excess:
                out[m, c] = np.sqrt(max(min(excess) + likelihood.noise[m, c] ** 2, 0.0))
    return np.minimum(out, likelihood.largest_noise / noise_response(likelihood))


def noise_response(likelihood) -> float:
    """Return the rms behind the low-pass of white torque of unit size."""
    motion = likelihood.motions[0]
    white = np.random.default_rng([likelihood.seed, 8, 0]).standard_normal(
        (len(motion.samples.time), 2 * likelihood.robot.n_joints))
    torque = likelihood.whitenings[0].low_passed(np.concatenate(
        [motion.through_filter(side) for side in np.split(white, 2, axis=1)], axis=1))
    return float(np.sqrt(np.mean(torque ** 2)))


def noise_of(likelihood, model) -> tuple[Noise, ...]:
    """Return the torque noise of each equation beyond what encoders make, tuple of Noise."""
    robot, found = model.robot, []
    n, total = robot.n_joints, excess_torque(likelihood, model)
    white = np.sqrt(np.mean(likelihood.noise ** 2, axis=0))
    response = noise_response(likelihood)
    levels = _octave_levels(likelihood, model)
    for c in range(2 * n):
        rms = float(np.hypot(total[c], white[c] * response))
        if rms < PRACTICAL_FLOOR * likelihood.coulomb[c % n]:
            continue
        slow, fast = levels[c]
        colour = ('white' if max(slow, fast) < _EVEN else 'slow' if slow >= fast else 'fast')
        found.append(Noise(robot.joints[c % n], 'link' if c < n else 'motor', float(white[c]),
                           rms, colour))
    return tuple(found)


def excess_torque(likelihood, model) -> np.ndarray:
    """Return what a model leaves in motion beyond null simulations, rms (2 n,) [N m]."""
    left = likelihood.whitener.in_motion([one ** 2 for one in likelihood.torque(model)])
    return np.sqrt(np.maximum(left - clean_torque(likelihood) ** 2, 0.0))


def clean_torque(likelihood) -> np.ndarray:
    """Return what null simulations leave in motion, torque noise too, rms (2 n,) [N m]."""
    whitener, seed = likelihood.whitener, likelihood.seed
    squares = [[one ** 2 for one in whitener.behind_low_pass([
        residual + drawn_noise(likelihood, m, np.random.default_rng([seed, 9, k, m]))
        for m, residual in enumerate(run)])] for k, run in enumerate(likelihood.null.clean[:2])]
    return np.sqrt(whitener.in_motion([
        np.mean(one, axis=0) for one in zip(*squares, strict=True)]))


def _octave_levels(likelihood, model):
    """Return noise levels of slow and of fast octaves of each equation in motion, (2 n, 2)."""
    groups, out = likelihood.groups, np.zeros((2 * likelihood.robot.n_joints, 2))
    levels = model.sums.groups / groups.count
    for c in range(len(out)):
        for side, fast in enumerate((False, True)):
            mine = np.unique(groups.group[(groups.channel == c)
                                          & ((groups.part < _FAST_OCTAVES) == fast)])
            if len(mine):
                out[c, side] = np.average(levels[mine], weights=groups.count[mine])
    return out
