# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Ripples whose waves pass faster than the whitened residuals show: those of gears, screws, magnets.

Over the angle of a motor all passes of a wave add up, at whatever speed. Residuals at every sample
of a recording, and waves, go through the filter that makes errors of prediction one sample ahead
of what is left (Ljung, System Identification, 2nd ed., 1999, section 3.2): these are white, where
a low-pass would take the waves away.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import rms, standing_out
from gms_flex_control.discrepancy.evidence import State
from gms_flex_control.discrepancy.gap import HeldOut
from gms_flex_control.discrepancy.motion import at_full_rate, filtered_alike, weight_of_neighbours
from gms_flex_control.discrepancy.result import Gap
from gms_flex_control.discrepancy.samples import encoder_step
from gms_flex_control.discrepancy.thresholds import CLEARLY, PRACTICAL
from gms_flex_control.discrepancy.validation import Gain, gain_over, memory_of
from gms_flex_control.effects.catalogue.drive import TorqueRipple
from gms_flex_control.effects.registry import find
from gms_flex_control.identification.prediction_error import FEWEST_WAVES
from gms_flex_control.params.robot import EffectSpec, with_effects
import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.ndimage import minimum_filter1d
from scipy.optimize import minimize_scalar

_SAMPLES_PER_WAVE = 4.0  # at the usual speed
_READINGS_PER_WAVE = 8.0  # counts of the motor's encoder, or standard deviations of its noise
_INDEPENDENT = 0.5    # blocks of time: errors of prediction remember little [s]
_ABOUT = 1.5          # of what the span of angles resolves: an order is looked for so far about
_RIDGE = 1e-6         # of the power: frequencies without any have no filter


class FastRipple(NamedTuple):
    """A ripple that no model so far has."""

    spec: EffectSpec
    deviations: tuple    # of its values, standard
    torque: float        # rms [N m]
    gain: Gain           # of blocks left out
    share: float         # of the squared errors of prediction that it explains
    residual: tuple      # rms of all that is left at the full rate, without it and with it [N m]


def fast_ripples(likelihood, model, excluded=()) -> list[FastRipple]:
    """
    Return the ripples of motors that matter and are not in a Fitted, list of FastRipple.

    As many per joint as it may have, those that gain most first; of joints with both encoders only
    those that the link's equation does not show as well: those are errors of the gear's angle.
    """
    if TorqueRipple.name in excluded:
        return []
    robot, motions = model.robot, [at_full_rate(motion) for motion in likelihood.motions]
    left, found = likelihood.unexplained(motions, robot, model.x), []
    for j, joint in enumerate(robot.joints):
        if joint not in likelihood.unseen:
            found += _of_joint(motions, left, j, likelihood, robot)
    return found


def with_ripples(likelihood, held_out, ripples, states, gap) -> tuple[State, Gap]:
    """
    Return the second State with FastRipples, and its Gap, on HeldOut data.

    With as many of the first ones as predict best, and no torque clearly worse.
    """
    alone, after = states
    if not ripples:
        return after, gap
    tried = [HeldOut(likelihood, held_out.other, tuple(one.spec for one in ripples[:count + 1]))
             for count in range(len(ripples))]

    def squared(data):
        return np.sum((data.errors(after).torque / likelihood.coulomb) ** 2)
    most = CLEARLY * squared(held_out)
    best = min((held_out, *(one for one in tried if not squared(one) > most)),
               key=lambda one: one.errors(after).energy)
    if not best.further:
        return after, gap
    own, robot = best.gap(alone, after), with_effects(after.model.robot, *best.further)
    return (after._replace(model=likelihood.fitted(robot, after.model.x)),
            replace(gap, after=own.after, rest_after=own.rest_after, free_after=own.free_after))


def _of_joint(motions, left, j, likelihood, robot):
    """Return the FastRipples of a joint by its motor's equation."""
    joint, rigid = robot.joints[j], robot.arm.rigid[j]
    equation = _Equation(motions, left, j, j if rigid else robot.n_joints + j)
    coarsest = 2.0 * np.pi * FEWEST_WAVES / max(equation.span, 1e-300)
    there = [value for spec in robot.effects if spec.joint == joint for parameter, value in zip(
        find(spec.name).parameters, spec.values, strict=True) if parameter.name == 'order']
    orders, found = [], []
    while True:
        taken = {one.name for one in robot.effects if one.joint == joint}
        name = next((name for name in (TorqueRipple.name, *TorqueRipple.again)
                     if name not in taken), None)
        if name is None:
            return found
        tried = [equation.sharpened(order, orders) for order in equation.standing_out(
            orders, coarsest)]
        tried = [order for order in tried if all(
            abs(order - one) > _ABOUT * equation.resolution for one in (*there, *orders))]
        if not tried:
            return found
        order = min(tried, key=lambda one: equation.cost([*orders, one]))
        ripple = equation.ripple(orders, order, name, joint)
        if (not ripple.gain.is_real() or ripple.torque < PRACTICAL * likelihood.level_of(joint)
                or not rigid and _Equation(motions, left, j, j).gain([], order).is_real()):
            return found
        orders.append(order)
        found.append(ripple)
        robot = with_effects(robot, ripple.spec)


class _Equation:
    """One equation of a joint along all recordings, at their full rate."""

    def __init__(self, motions, left, j, column):
        self._angles = [motion.states[:, 3, j] for motion in motions]
        self._rates = [motion.states[:, 4, j] for motion in motions]
        self._left = [one[:, column] for one in left]
        self.span = max(float(np.ptp(angle)) for angle in self._angles)
        self.resolution = 2.0 * np.pi / max(self.span, 1e-300)
        self._period = motions[0].samples.period
        grain = max(max(float(one.samples.noise[1, j]), encoder_step(
            one.samples.readings[:, 1, j], one.samples.noise[1, j])) for one in motions)
        self._finest = 2.0 * np.pi / max(_READINGS_PER_WAVE * grain, 1e-300)
        memory = memory_of(self._period)
        self._filter = np.concatenate([[1.0], -_prediction(self._left, memory)])
        speed = np.median(np.abs(np.concatenate(self._rates)))
        self._used, blocks, first = [], [], 0
        for motion in motions:
            time = motion.time - motion.time[0]
            used = motion.settled & minimum_filter1d(motion.known, memory + 1, origin=memory // 2)
            self._used.append(used)
            blocks.append(first + (time[used] / _INDEPENDENT).astype(int))
            first += int(time[-1] / _INDEPENDENT) + 1
        self._block = np.unique(np.concatenate(blocks), return_inverse=True)[1]
        rate = np.concatenate([one[used] for one, used in zip(self._rates, self._used,
                                                              strict=True)])
        self._way = 2 * (rate > 0.0) + (np.abs(rate) > speed)
        self._errors = self._predicted(self._left)

    def _predicted(self, signals):
        """Return signals (T,) of all recordings as errors of prediction, used samples (S,)."""
        return np.concatenate([self._error(one)[used] for one, used in zip(
            signals, self._used, strict=True)])

    def _error(self, signal):
        """Return the error of prediction (T,) at each sample of a signal (T,)."""
        return np.convolve(signal, self._filter)[:len(signal)]

    def _waves(self, orders):
        """Return sines and cosines of orders K as errors of prediction (S, 2 K)."""
        weight = weight_of_neighbours(1)
        columns = [self._predicted([filtered_alike(wave(order * angle), weight)
                                    for angle in self._angles])
                   for order in orders for wave in (np.sin, np.cos)]
        return np.stack(columns, axis=1) if columns else np.empty((len(self._errors), 0))

    def standing_out(self, orders, coarsest) -> tuple:
        """Return the orders that stand out of what waves of ``orders`` leave."""
        left = self._beside(orders)
        # errors of prediction through the filter backwards: of these a wave takes as much as of
        # the errors its errors of prediction do
        white = [self._error(np.where(used, self._error(one), 0.0)[::-1])[::-1]
                 for one, used in zip(left, self._used, strict=True)]
        fastest = 1.0 / (_SAMPLES_PER_WAVE * self._period)
        return tuple(order for signal in (left, white) for order in standing_out(
            self._angles, signal, self._rates, coarsest, fastest) if order < self._finest)

    def _beside(self, orders):
        """Return what waves of orders leave, of each recording (T,)."""
        sizes, left = self._fitted(self._waves(orders)), self._left
        for order, sine, cosine in zip(orders, sizes[::2], sizes[1::2], strict=True):
            left = [one - sine * np.sin(order * angle) - cosine * np.cos(order * angle)
                    for one, angle in zip(left, self._angles, strict=True)]
        return left

    def _fitted(self, columns, used=slice(None)):
        return np.linalg.lstsq(columns[used], self._errors[used], rcond=None)[0]

    def cost(self, orders) -> float:
        """Return the sum of squared errors of prediction beside waves of orders."""
        columns = self._waves(orders)
        return float(np.sum((self._errors - columns @ self._fitted(columns)) ** 2))

    def sharpened(self, order, others) -> float:
        """Return the order near one that leaves least, beside waves of ``others``."""
        reach = _ABOUT * self.resolution
        return float(minimize_scalar(
            lambda trial: self.cost([*others, trial]), bounds=(order - reach, order + reach),
            method='bounded', options={'xatol': 1e-3 * reach}).x)

    def _left_out(self, columns):
        """
        Return the squared errors of blocks (B,), each way of motion predicted by the others.

        That is slow or fast, forward or backward: along the same motion all is a function of the
        angle, and a ripple is the same on any.
        """
        out = np.zeros(self._block.max() + 1)
        for way in range(4):
            mine = self._way == way
            if mine.any() and not mine.all():
                errors = self._errors[mine] - columns[mine] @ self._fitted(columns, ~mine)
                out += np.bincount(self._block[mine], errors ** 2, len(out))
        return out

    def gain(self, orders, order) -> Gain:
        """Return the Gain of the log likelihood of blocks left out, by a wave beside others."""
        variance = self.cost([*orders, order]) / len(self._errors)
        return gain_over((self._left_out(self._waves(orders))
                          - self._left_out(self._waves([*orders, order]))) / (2.0 * variance))

    def ripple(self, orders, order, name, joint) -> FastRipple:
        """Return the wave of an order beside others as a FastRipple of a name and joint."""
        columns = self._waves([*orders, order])
        sizes, before = self._fitted(columns), self.cost(orders)
        after = float(np.sum((self._errors - columns @ sizes) ** 2))
        sine, cosine = sizes[-2:]
        amplitude = float(np.hypot(sine, cosine))
        error = float(np.sqrt(after / len(self._errors) * np.trace(
            np.linalg.pinv(columns.T @ columns)[-2:, -2:]) / 2.0))
        of_order = error / amplitude * np.sqrt(12.0) / self.span  # a line through the phase
        middle = float(np.mean(np.concatenate(self._angles)))
        values = amplitude, order, float(np.arctan2(cosine, sine))
        return FastRipple(
            EffectSpec(name=name, joint=joint, values=values), (error, of_order, float(np.hypot(
                error / amplitude, middle * of_order))), amplitude / np.sqrt(2.0),
            self.gain(orders, order), 1.0 - after / before,
            tuple(rms(np.concatenate(self._beside(there)))
                  for there in (orders, [*orders, order])))


def _prediction(signals, memory):
    """Return the weights (memory,) of earlier samples that predict the next, of all signals."""
    power = sum(np.array([one[:len(one) - k] @ one[k:] for k in range(memory + 1)])
                for one in signals)
    if power[0] <= 0.0:
        return np.zeros(memory)
    power[0] *= 1.0 + _RIDGE
    return solve_toeplitz(power[:-1], power[1:])
