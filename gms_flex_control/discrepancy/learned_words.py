# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What a learned term looks like, in words: a short formula and its error."""

from typing import NamedTuple

from gms_flex_control.discrepancy.describe import angle_scale, torque_scale
from gms_flex_control.effects import learned as shapes
from gms_flex_control.params.arm import in_units
import numpy as np
from scipy.optimize import least_squares

_POINTS = 400         # of a curve that is described
_SIMPLER = 1.3        # times the least error, at which a formula of fewer numbers is preferred
_STEEP = 0.05         # of the range: a tanh that is less wide is a step
_LEAST = 0.02         # of the largest weight: others are not mentioned


class Formula(NamedTuple):
    """A simple function fitted to a curve."""

    shape: str           # 'constant', 'linear', 'quadratic', 'bump', 'step', 'tanh', 'sine'
    numbers: tuple       # amplitude, place or order, width or phase: what the shape has
    error: float         # rms of what it leaves over rms of the curve
    unknowns: int


def formula_of(x, y) -> Formula:
    """Return the simplest Formula nearly as close to a curve (P,), x rising, as the closest."""
    middle, span, size = 0.5 * (x[0] + x[-1]), x[-1] - x[0], np.sqrt(np.mean(y ** 2))
    if size == 0.0 or span <= 0.0:
        return Formula('constant', (0.0,), 0.0, 1)
    u, found = (x - middle) / span, []
    for shape, degree in (('constant', 0), ('linear', 1), ('quadratic', 2)):
        weights = np.polyfit(u, y, degree)
        numbers = tuple(float(w / span ** (degree - k)) for k, w in enumerate(weights))
        found.append(Formula(shape, (*numbers, middle), _error(y, np.polyval(weights, u)),
                             degree + 1))
    places = np.linspace(-0.5, 0.5, 41)
    for shape, of, begun in (
            ('bump', lambda p: np.exp(-((u - p[0]) / p[1]) ** 2),
             [(a, b) for a in places for b in (0.01, 0.03, 0.1, 0.3)]),
            ('tanh', lambda p: np.tanh((u - p[0]) / p[1]),
             [(a, b) for a in places for b in (0.01, 0.1, 0.4)]),
            ('sine', lambda p: np.sin(2.0 * np.pi * p[0] * u + p[1]),
             [(a, b) for a in np.arange(0.5, 8.1, 0.25) for b in np.linspace(0.0, 3.0, 7)])):
        found.append(_curved(u, y, shape, of, begun, middle, span))
    least = min(one.error for one in found)
    return min((one for one in found if one.error <= _SIMPLER * least + 1e-3),
               key=lambda one: (one.unknowns, one.error))


def _curved(u, y, shape, of, begun, middle, span):
    """Return the best Formula ``a of(p) + c`` of two shape parameters p."""
    def both(p):
        columns = np.stack([of(p), np.ones_like(u)], axis=1)
        weights = np.linalg.lstsq(columns, y, rcond=None)[0]
        return weights, columns @ weights
    start = min(begun, key=lambda p: np.sum((both(p)[1] - y) ** 2))
    p = least_squares(lambda p: both(p)[1] - y, start).x
    (height, _), fitted = both(p)
    error, width = _error(y, fitted), abs(p[1])
    if shape == 'sine':
        order = 2.0 * np.pi * p[0] / span
        return Formula(shape, (float(height), float(order), float(p[1] - order * middle)), error,
                       4)
    if shape == 'tanh':
        shape = 'step' if width < _STEEP else 'tanh'
        height = 2.0 * height * np.sign(p[1])
    if abs(p[0]) > 0.6 or width > 2.0:  # a piece of it that looks like nothing of the kind
        error = np.inf
    return Formula(shape, (float(height), float(middle + span * p[0]), float(span * width)), error,
                   4)


def _error(y, fitted):
    return float(np.sqrt(np.mean((y - fitted) ** 2) / np.mean(y ** 2)))


def curve_of(spec, span) -> tuple[np.ndarray, np.ndarray]:
    """Return places and values of a term's curve over a range, (P,) each."""
    p = np.array(spec.values)
    inside = np.clip(np.linspace(*p[shapes.KNOTS:shapes.KNOTS + 2], _POINTS), *span)
    x = np.unique(np.concatenate([np.linspace(*span, _POINTS), inside]))
    return x, np.array([shapes.curve(one, p) for one in x])


def described(spec, span, arm) -> tuple[str, float]:
    """
    Return what a learned term looks like, in units of an arm, and the error of that.

    Such as 'a torque over the link angle of joint1 that looks like a bump of ...', and the rms of
    what that leaves over rms of the curve. ``span`` are lowest and highest value of its variable
    in the recordings; of no curve it is None, and the error NaN.
    """
    kind = shapes.LEARNED[spec.name]
    variable = kind.variable()
    if not variable:
        return in_units(arm, _of_elements(spec, kind)), np.nan
    formula = formula_of(*curve_of(spec, span))
    like = _in_words(formula, kind.parameters[shapes.KNOTS].unit, kind.parameters[0].unit == '1')
    return in_units(arm, f'{kind.what} over {"the " * (variable != "time")}{variable} of '
                    f'{spec.joint} that looks like {like} (error {100.0 * formula.error:.0f} % of '
                    'it rms)'), formula.error


def _of_elements(spec, kind):
    """Return a term that is no curve in words."""
    count = kind.count
    weights = np.array(spec.values[:count])
    places = np.geomspace(*spec.values[count:count + 2], count)[weights > _LEAST * weights.max()]
    if kind.parameters[0].unit == 'N m':
        torque, angle = torque_scale(weights.sum()), angle_scale(places)
        return (f'a hysteresis of {spec.joint} of {torque.text(weights.sum())} {torque.unit} '
                f'in all, of elements that yield at {", ".join(map(angle.text, places))} '
                f'{angle.unit}')
    return (f'a resonance of {spec.joint} of {weights.sum():.3g} kg m^2 at '
            f'{", ".join(f"{one:.3g}" for one in places)} Hz')


def _in_words(formula, unit, is_relative):
    """Return a formula in words, its place in a unit, its size a torque unless relative."""
    def size(value):
        if is_relative:
            return f'{100.0 * value:.3g} %'
        scale = torque_scale(value)
        return f'{scale.text(value)} {scale.unit}'
    numbers, shape = formula.numbers, formula.shape
    if shape == 'constant':
        return f'a constant {size(numbers[0])}'
    if shape == 'linear':
        return f'{size(numbers[0])} per {unit}'
    if shape == 'quadratic':
        return f'a parabola of {size(numbers[0])} per ({unit})^2 about {numbers[-1]:.3g} {unit}'
    if shape == 'sine':
        return f'a sine of {size(abs(numbers[0]))}, {abs(numbers[1]):.3g} per {unit}'
    word = 'a saturating slope (tanh)' if shape == 'tanh' else f'a {shape}'
    return (f'{word} of {size(numbers[0])} at {numbers[1]:.3g} {unit}, '
            f'{numbers[2]:.2g} {unit} wide')


def words_of(terms, before=None, after=None) -> str:
    """Return sentences on LearnedTerms, and on the Gaps without and with them."""
    if not terms:
        return ('No learned term predicts data left out of the fit better: what is unexplained '
                'does not follow from angle, speed, torsion, load or history of one joint alone.')

    def change(one, other):
        return f'{np.sqrt(np.nansum(other ** 2) / np.nansum(one ** 2)):.2g}'
    return (f'Learned, without a name: {"; ".join(one.formula for one in terms)}. '
            f'Held-out residual torque is {change(before.after, after.after)} times, the error of '
            f'free runs {change(before.free_after, after.free_after)} times what it was without.')
