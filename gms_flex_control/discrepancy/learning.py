# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A term for what has no name: curves and elements learned where something is unexplained.

Each is linear in its weights, which are bounded so that the term stays what physics allows; see
effects/learned.py. It is chosen as names are: by evidence, by blocks of time left out of the fit,
and by free runs.
"""

from dataclasses import replace

from gms_flex_control.compiled import in_one_thread
from gms_flex_control.discrepancy import fitting
from gms_flex_control.discrepancy.evidence import State, state_of
from gms_flex_control.discrepancy.gap import HeldOut
from gms_flex_control.discrepancy.learned_words import described, words_of
from gms_flex_control.discrepancy.likelihood import Likelihood, Residuals
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.nuisance import OfRecording, with_nuisances
from gms_flex_control.discrepancy.null_simulation import is_followed
from gms_flex_control.discrepancy.result import Discrepancy, LearnedTerm
from gms_flex_control.discrepancy.thresholds import CLEARLY, EVIDENCE, PLAUSIBLE
from gms_flex_control.discrepancy.validation import gain_of
from gms_flex_control.effects import learned as shapes
from gms_flex_control.params.robot import EffectSpec, with_effects
import numpy as np

MOST_TERMS = 3        # that are learned of one robot
_TRIED = 3            # candidates of most evidence that are validated
_COARSE = 3, 6        # knots of curves that few data determine
_ZOOMS = 0.25, 1.0 / 12.0  # of the range: windows about the place where a curve stands out
_ITERATIONS = 3       # of a fit, in which only noise levels change
_OFF = 5e-4           # of the moments, at either end of a range
_PROBE = 0.1          # of the usual size of a weight, for derivatives
_YIELDS = 1e-3, 0.3   # of the range of angles: of elements of a hysteresis
_REACH = 1e-3         # of the range of angles, from rest to sliding
_COUNTS = 4.0         # of the encoder, likewise
_STILL = 3e-3, 0.03   # of the rms of the rate: so slow is nearly at rest
_FREQUENCIES, _DAMPING = (2.0, 16.0), 0.05  # of a resonance [Hz], [1]


def learn(result, *, holdout=(), say=lambda text: None) -> Discrepancy:
    """
    Return a Discrepancy with terms learned for what no effect in its robot explains.

    The same where nothing is open, or no term predicts held-out data better. Else with ``learned``
    terms in ``robot``, in the place of effects that only resemble what is missing where that
    predicts better. ``holdout`` and ``say`` as of `find_discrepancy`.
    """
    if not result.is_open or result.behind is None:
        return result
    with in_one_thread(), np.errstate(all='ignore'):
        return _learned(result, holdout, say)


def _learned(result, holdout, say):
    """Return `learn` of a result in which something is unexplained."""
    likelihood = result.behind.likelihood
    # of known parameters a little off, which a term may stand for
    alone = result.behind.retuned_alone
    say('learning a term for what is unexplained')
    for learning, begin in _begun(result, holdout, say):
        state, terms, gap, drift = learning.run(learning.state(begin))
        if terms and all(_is_closer(likelihood, gap, other) for other in (result.gap, alone)):
            break
    else:
        return result.saying(drift or words_of(()))
    robot = replace(
        with_nuisances(state.model.robot, learning.likelihood.nuisances, state.model.x),
        uncertainty=result.robot.uncertainty)
    kept = {one.key for one in robot.effects}
    return replace(
        result.saying(words_of(terms, result.gap, gap), drift), learned=terms, robot=robot,
        gap=gap,
        stand_ins=tuple(one for one in result.stand_ins if one.key in kept),
        behind=result.behind._replace(
            written=state.model if learning.likelihood is likelihood
            else likelihood.fitted(robot, np.zeros(len(likelihood.nuisances)))))


def _begun(result, holdout, say):
    """
    Yield a _Learning and the Fitted that it begins with.

    Without what only resembles the cause, whose place a term may take; beside it, all re-tuned
    together; and beside the model written as it is: it was chosen by what it predicts, which
    re-tuning with a term may spoil.
    """
    likelihood, written = result.behind.likelihood, result.behind.written

    def measured(robot):
        return Residuals([motion_of(one, robot) for one in holdout], robot) if holdout else None
    learning = _Learning(likelihood, measured(likelihood.robot), result.behind.before, say)
    known = {one.key for one in result.stand_ins}
    if known:
        yield learning, likelihood.fitted(replace(written.robot, effects=tuple(
            one for one in written.robot.effects if one.key not in known)),
            written.x)
    yield learning, written
    robot = with_nuisances(written.robot, likelihood.nuisances, written.x)
    likelihood = Likelihood(likelihood.motions, robot, likelihood.seed).with_noise(
        likelihood.noise)
    begin = likelihood.fitted(robot, np.zeros(len(likelihood.nuisances)))
    yield _Learning(likelihood, measured(robot), begin, say, np.array(
        [PLAUSIBLE * isinstance(one, OfRecording) for one in likelihood.nuisances])), begin


def _is_closer(likelihood, gap, before):
    """Return whether a Gap is clearly less in torque and no more in free runs than another."""
    torque, other = (float(np.sum((one.after / likelihood.coulomb) ** 2)) for one in (gap, before))
    return CLEARLY * torque < other and (
        np.nansum(gap.free_after ** 2) <= np.nansum(before.free_after ** 2))


class _Learning:
    """The learning of terms for one robot, one after the other."""

    def __init__(self, likelihood, measured, before, say, plausible=np.inf):
        self.likelihood, self._measured, self._say = likelihood, measured, say
        self._nuisances = likelihood.jacobian(before)
        self._plausible = plausible  # standard deviations that nuisance parameters may go
        self._before = State(before, self._nuisances, fitting.effect_jacobian(
            likelihood, before, fitting.numbers_of(likelihood, before.robot)), -np.inf, PLAUSIBLE)
        joints = range(likelihood.robot.n_joints)
        self._ranges = [_ranges(likelihood, j) for j in joints]
        self._begun = [spec for j in joints for spec in _specs(likelihood, j, self._ranges[j])]
        self._count = len(self._begun) * (1 + len(_ZOOMS))

    def state(self, model) -> State:
        """Return a model fitted again as a State."""
        model = fitting.fit(self.likelihood, model.robot, model.x, self._nuisances,
                            plausible=self._plausible)
        return self._state(model, fitting.extended(self.likelihood, model, self._nuisances))

    def _state(self, model, jacobian):
        return state_of(self.likelihood, model, jacobian, self._count)._replace(
            plausible=self._plausible)

    def run(self, state) -> tuple:
        """Return a State with terms, LearnedTerm of each, its Gap, words on a drift or ''."""
        terms, gap, drift = [], self._gap(state), ''
        while len(terms) < MOST_TERMS:
            for one in sorted(self._candidates(state), key=lambda one: -one.evidence)[:_TRIED]:
                if one.evidence < state.evidence + EVIDENCE:
                    return state, tuple(terms), gap, drift
                spec, gain = one.model.robot.effects[-1], self._gain(one, state)
                if not gain.is_real(self.likelihood.caution):
                    continue
                if not shapes.LEARNED[spec.name].written:
                    drift = (f'What is unexplained includes {self._described(spec)[0]}: it '
                             'belongs to this recording and is not in the model.')
                    continue
                closer = self._closer(one, gap)
                if closer is not None:
                    break
            else:
                return state, tuple(terms), gap, drift
            formula, error = self._described(spec)
            terms.append(LearnedTerm(*spec.key, formula, error, self._freedom(one), gain))
            state, gap = one, closer
            self._say(f'learned {spec.name} of {spec.joint}')
        return state, tuple(terms), gap, drift

    def _gap(self, state):
        return HeldOut(self.likelihood, self._measured).gap(self._before, state)

    def _described(self, spec):
        """Return what a term looks like, and the error of that."""
        robot = self.likelihood.robot
        ranges = self._ranges[robot.joints.index(spec.joint)]
        return described(spec, ranges.get(shapes.LEARNED[spec.name].variable()), robot.arm)

    def _gain(self, one, state):
        """Return the Gain of a State with a term on blocks left out, over that without it."""
        likelihood, change = self.likelihood, state.model.whitened - one.model.whitened
        return gain_of(likelihood, *((each.model, each.jacobian) for each in (one, state)), change,
                       np.minimum(fitting.plausible_limit(likelihood, one.model), self._plausible))

    def _closer(self, state, gap):
        """Return the Gap of a model if it is clearly less in torque and no more in free runs."""
        if not is_followed(self._measured or self.likelihood, state.model):
            return None
        other = self._gap(state)
        return other if _is_closer(self.likelihood, other, gap) else None

    def _freedom(self, one):
        """Return how many parameters of the last term the data determine, effectively."""
        likelihood, model, spec = self.likelihood, one.model, one.model.robot.effects[-1]
        count = shapes.LEARNED[spec.name].count
        jacobian = fitting.informative(likelihood, model, one.jacobian)[-count:]
        values, size = np.array(spec.values[:count]), [
            number.sd for number in fitting.numbers_of(likelihood, model.robot)[-count:]]
        scaled = (jacobian * np.array(size)[:, None])[values != 0.0]
        known = np.linalg.eigvalsh((scaled * likelihood.weights(model.sums.groups)) @ scaled.T)
        return float(np.sum(np.maximum(known, 0.0) / (1.0 + np.maximum(known, 0.0))))

    # --- candidates --------------------------------------------------------------------------

    def _candidates(self, state):
        """Return the best State with a term of each kind and joint that a model lacks."""
        there = {one.key for one in state.model.robot.effects}
        found = {}
        for spec in self._begun:
            if spec.key in there:
                continue
            here = [self._fitted(state, spec)]
            if _used(spec) == shapes.KNOTS and shapes.LEARNED[spec.name].variable() != 'time':
                for zoom in _ZOOMS:
                    here.append(self._fitted(state, _window(
                        here[-1].model.robot.effects[-1], spec, zoom)))
                    if here[-1].evidence < here[-2].evidence:
                        break
            here += [found[spec.key]] if spec.key in found else []
            found[spec.key] = max(here, key=lambda one: one.evidence)
        return list(found.values())

    def _fitted(self, state, spec):
        """Return the State of a model with a term, all else re-tuned."""
        likelihood, base = self.likelihood, state.model
        kind = shapes.LEARNED[spec.name]
        count = kind.count
        size = _PROBE * kind.typical(likelihood.scales_of(spec.joint))[0]
        zero = with_effects(base.robot, spec)
        model = likelihood.fitted(zero, base.x)

        def column(k):
            values = (*(size * (i == k) for i in range(count)), *spec.values[count:])
            probe = with_effects(base.robot, replace(spec, values=values))
            return likelihood.change(model, probe, base.x) / size
        own = np.zeros((count, len(model.whitened)))
        own[:_used(spec)] = likelihood.each(column, range(_used(spec)))
        jacobian, at = np.concatenate([state.jacobian, own]), len(base.x)
        for _ in range(_ITERATIONS):
            numbers = [one._replace(reach=np.inf)
                       for one in fitting.numbers_of(likelihood, model.robot)]
            step, _ = fitting.foreseen(likelihood, model, jacobian, jacobian[:0], numbers,
                                       self._plausible)
            other = likelihood.fitted(
                fitting.at_values(model.robot, numbers, fitting.values_of(
                    model.robot, numbers) + step[at:]),
                model.x + step[:at])
            if not (fitting.total_cost(likelihood, other) < fitting.total_cost(likelihood, model)):
                break
            model = other
        return self._state(model, jacobian)


def _ranges(likelihood, j):
    """Return lowest and highest value of each variable of joint j, dict of str."""
    motions, stiffness = likelihood.motions, likelihood.robot.arm.stiffness[j]
    angle, speed, torsion, drive, time = (np.concatenate([of(one) for one in motions]) for of in (
        lambda one: one.states[:, 0, j], lambda one: np.abs(one.states[:, 1, j]),
        lambda one: one.states[:, 3, j] - one.states[:, 0, j], lambda one: one.drive[:, j],
        lambda one: one.time))
    found = {name: tuple(np.quantile(values, (_OFF, 1.0 - _OFF)).tolist()) for name, values in (
        ('link angle', angle), ('torsion', torsion), ('time', time))}
    load = drive if likelihood.robot.arm.rigid[j] else stiffness * torsion
    for name, values in (('speed', speed), ('torque carried', np.abs(load))):
        found[name] = 0.0, float(np.quantile(values, 1.0 - _OFF))
    return found


def _specs(likelihood, j, ranges):
    """Return all terms of joint j with weights of zero, EffectSpec each."""
    robot, joint, found = likelihood.robot, likelihood.robot.joints[j], []
    lowest, highest = ranges['link angle']
    span, rigid = highest - lowest, robot.arm.rigid[j]
    turns = robot.arm.axes == 'rotary' and span > 2.0 * np.pi
    further = {
        'learned_hysteresis': [tuple(share * span for share in _YIELDS)],
        'learned_resonance': [(*_FREQUENCIES, _DAMPING)]}
    for name, kind in shapes.LEARNED.items():
        variable, rest = kind.variable(), further.get(name)
        if rigid and variable == 'torsion':
            continue
        if rest is None:
            repeats = turns and variable == 'link angle'
            rest = [(*((0.0, 2.0 * np.pi, shapes.REPEATS) if repeats else (
                *ranges[variable], shapes.FLAT_BEYOND)), float(knots))
                for knots in (*_COARSE, shapes.KNOTS)]
        scales, last = likelihood.scales_of(joint), kind.parameters[-1].name
        ways = {'reach': (max(_REACH * span, _COUNTS * scales.count),),
                'still': tuple(share * scales.speed for share in _STILL)}.get(last, (None,))
        found += [EffectSpec(name=name, joint=joint, values=(0.0,) * kind.count + one + (
            () if way is None else (way,))) for one in rest for way in ways]
    return found


def _used(spec):
    """Return how many weights of a term are in use."""
    kind = shapes.LEARNED[spec.name]
    return int(spec.values[shapes.USED] if kind.variable() else kind.count)


def _window(fitted, whole, share):
    """Return a term with weights of zero in a window where a fitted curve stands out most."""
    count, ends = shapes.KNOTS, shapes.KNOTS + 2
    weights, (lowest, highest, beyond) = np.array(fitted.values[:count]), fitted.values[
        count:ends + 1]
    inside = beyond == shapes.ZERO_BEYOND
    places = np.linspace(lowest, highest, count + 2)[1:-1] if inside else np.linspace(
        lowest, highest, count, endpoint=beyond != shapes.REPEATS)
    centre = places[np.argmax(np.abs(weights - (0.0 if inside else np.median(weights))))]
    half = 0.5 * share * (whole.values[count + 1] - whole.values[count])
    return replace(whole, values=(0.0,) * count + (
        float(centre - half), float(centre + half), shapes.ZERO_BEYOND, *whole.values[ends + 1:]))
