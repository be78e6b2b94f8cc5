# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Terms without a name: curves and elements whose weights are learned from recordings.

They are written into a robot file as any effect, but the search for names does not propose them.
All are linear in their weights; where weights must not be negative, a term cannot give energy:

- friction against the motion takes power at every instant;
- a stop element behind the motion is a spring that yields, with any positive level g(q): moving
  by dx it gives back at most what loading it has stored (see docs/learned_terms.md);
- a mass on a spring and a damper that ride on the link are a passive body.
"""

from gms_flex_control.compiled import compiled
from gms_flex_control.effects import base as sig
from gms_flex_control.effects.base import Parameter, Stage, Term
import numpy as np

KNOTS = 24            # of a curve, at most
STOPS, MODES = 12, 8  # of hysteresis, of resonance
ZERO_BEYOND, FLAT_BEYOND, REPEATS = 0.0, 1.0, 2.0  # a curve outside its range
_LOWEST, _HIGHEST, _ENDS, USED, _SIGN = range(KNOTS, KNOTS + 5)


def _weights(count, unit, lower=-np.inf, upper=np.inf):
    return tuple(Parameter(f'w{k + 1:02d}', unit, f'weight {k + 1} of {count}', lower, upper)
                 for k in range(count))


def _range(unit, what):
    return tuple(Parameter(name, unit, f'{name} {what}', fixed=True)
                 for name in ('lowest', 'highest'))


def _curve(unit, what, lower=-np.inf, upper=np.inf, of='N m'):
    return (*_weights(KNOTS, of, lower, upper), *_range(unit, what),
            Parameter('ends', '1', 'beyond: 0 zero, 1 flat, 2 repeats', 0.0, 2.0, fixed=True),
            Parameter('knots', '1', 'how many weights are in use', 2.0, KNOTS, fixed=True))


_STILL = Parameter('still', 'rad/s', 'rate of which three count as motion', 0.0, fixed=True)


@compiled
def curve(at, p) -> float:
    """
    Return a piecewise linear curve at a place.

    ``p`` (pointer to float64, or ndarray) has `KNOTS` weights, lowest and highest place, what is
    beyond: 0 nothing (the first and the last knot lie one step inside), 1 the weight at that end,
    2 the curve again; and at how many even knots the first weights stand.
    """
    knots = int(p[USED])
    if not p[_HIGHEST] > p[_LOWEST] or not 2 <= knots <= KNOTS:
        return 0.0
    x = (at - p[_LOWEST]) / (p[_HIGHEST] - p[_LOWEST])
    if p[_ENDS] >= 2.0:
        x = (x - np.floor(x)) * knots
    elif p[_ENDS] >= 1.0:
        x = min(max(x, 0.0), 1.0) * (knots - 1)
    else:
        x = min(max(x * (knots + 1) - 1.0, -1.0), float(knots))
    k = int(np.floor(x))
    share, after = x - k, k + 1
    if p[_ENDS] >= 2.0:
        k, after = k % knots, after % knots
    value = 0.0
    if 0 <= k < knots:
        value += (1.0 - share) * p[k]
    if 0 <= after < knots:
        value += share * p[after]
    return value


@compiled
def _stop(moved, yields, before):
    """Return the state -1 to 1 of an element that yields after so much displacement."""
    return min(max(before + moved / yields, -1.0), 1.0)


@compiled
def _sign(rate, still):
    """Return the sign of a rate, smoothly through rest; 0 where no rate is still."""
    return np.tanh(rate / still) if still > 0.0 else 0.0


class Learned(Term):
    """A term that is linear in weights; ``count`` of them are its first parameters."""

    similar = ()
    discriminated_by = 'another motion over the same range'
    count = KNOTS
    written = True            # belongs into a robot file
    size = 'friction'         # usual size of a weight, of effects.base.Scales
    what = 'a friction'       # in words, of a curve

    @classmethod
    def variable(cls) -> str:
        """Return the variable of its curve, '' of a term that has no curve."""
        return (cls.parameters[KNOTS].description.removeprefix('lowest ')
                if cls.count == KNOTS else '')

    @classmethod
    def guesses(cls, scales) -> list:
        """Return nothing: the search for names does not propose it."""
        return []

    @classmethod
    def typical(cls, scales) -> tuple[float | None, ...]:
        """Return usual sizes of its parameters, tuple of float or None."""
        size = getattr(scales, cls.size) if cls.size else 1.0
        return (size,) * cls.count + (None,) * (len(cls.parameters) - cls.count)


class LearnedPosition(Learned):
    """Link torque f(q_link): conservative."""

    name = 'learned_position'
    stage = Stage.LINK
    what = 'a torque'
    evidence = 'link angle'
    fed_forward = True
    parameters = _curve('rad', 'link angle')

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.LINK_TORQUE] += curve(s[sig.Q_LINK], p)


class LearnedTorsion(Learned):
    """Spring torque f(torsion): conservative."""

    name = 'learned_torsion'
    stage = Stage.SPRING
    what = 'a torque'
    evidence = 'torsion'
    parameters = _curve('rad', 'torsion')

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.SPRING] += curve(s[sig.TORSION], p)


class LearnedRateFriction(Learned):
    """Friction sign(dq) g(abs(dq)), g >= 0: dissipative."""

    name = 'learned_rate_friction'
    stage = Stage.FRICTION
    evidence = 'link rate'
    parameters = *_curve('rad/s', 'speed', 0.0), _STILL

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.FRICTION] += curve(abs(s[sig.DQ_LINK]), p) * _sign(s[sig.DQ_LINK], p[_SIGN])


class LearnedPositionFriction(Learned):
    """Friction g(q_link) of a stop element, g >= 0: passive."""

    name = 'learned_position_friction'
    stage = Stage.FRICTION
    memory_size = 3           # angle before, whether there is one, state of the element
    evidence = 'link angle'
    fed_forward = True
    parameters = (*_curve('rad', 'link angle', 0.0),
                  Parameter('reach', 'rad', 'displacement from rest to sliding', 0.0, fixed=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[_SIGN] > 0.0:
            memory[2] = _stop((s[sig.Q_LINK] - memory[0]) * memory[1], p[_SIGN], memory[2])
            memory[0], memory[1] = s[sig.Q_LINK], 1.0
            s[sig.FRICTION] += curve(s[sig.Q_LINK], p) * memory[2]


class LearnedPositionDrag(Learned):
    """Friction sign(dq) g(q_link), g >= 0, that yields when it creeps: dissipative."""

    name = 'learned_position_drag'
    stage = Stage.FRICTION
    evidence = 'link angle'
    parameters = *_curve('rad', 'link angle', 0.0), _STILL

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.FRICTION] += curve(s[sig.Q_LINK], p) * _sign(s[sig.DQ_LINK], p[_SIGN])


class LearnedLoadFriction(Learned):
    """Friction sign(dq) h(abs(spring torque)), h >= 0: dissipative."""

    name = 'learned_load_friction'
    stage = Stage.FRICTION
    evidence = 'torsion'
    parameters = *_curve('N m', 'torque carried', 0.0), _STILL

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.FRICTION] += curve(abs(s[sig.SPRING]), p) * _sign(s[sig.DQ_LINK], p[_SIGN])


class LearnedHysteresis(Learned):
    """Friction of stop elements of many yields in parallel, weights >= 0: passive."""

    name = 'learned_hysteresis'
    stage = Stage.FRICTION
    memory_size = 2 + STOPS   # angle before, whether there is one, states of the elements
    count = STOPS
    evidence = 'time since reversal'
    fed_forward = True
    parameters = (*_weights(STOPS, 'N m', 0.0), *_range('rad', 'yield of an element'))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        moved, yields = (s[sig.Q_LINK] - memory[0]) * memory[1], p[STOPS]
        memory[0], memory[1] = s[sig.Q_LINK], 1.0
        if yields > 0.0 and p[STOPS + 1] > yields:
            ratio = (p[STOPS + 1] / yields) ** (1.0 / (STOPS - 1))
            for k in range(STOPS):
                memory[2 + k] = _stop(moved, yields, memory[2 + k])
                s[sig.FRICTION] += p[k] * memory[2 + k]
                yields *= ratio


class LearnedResonance(Learned):
    """Bodies on springs and dampers that ride on the link, inertias >= 0: passive."""

    name = 'learned_resonance'
    stage = Stage.LINK
    memory_size = 1 + 2 * MODES  # whether they move yet, angle and rate of each
    count = MODES
    size = 'link_inertia'
    evidence = 'link acceleration'
    parameters = (*_weights(MODES, 'kg m^2', 0.0), *_range('Hz', 'frequency of a body'),
                  Parameter('damping', '1', 'damping ratio of all', 0.0, 0.99, fixed=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        frequency, damping = p[MODES], p[MODES + 2]
        if frequency > 0.0 and p[MODES + 1] > frequency:
            ratio = (p[MODES + 1] / frequency) ** (1.0 / (MODES - 1))
            for k in range(MODES):
                if memory[0] == 0.0:
                    memory[1 + 2 * k], memory[2 + 2 * k] = s[sig.Q_LINK], s[sig.DQ_LINK]
                w = 2.0 * np.pi * frequency
                turn = 2.0 * damping / w
                # exact for a link that moves on evenly, as far as half the step
                rest = s[sig.Q_LINK] + (turn + 0.5 * dt) * s[sig.DQ_LINK]
                swing = w * np.sqrt(1.0 - damping * damping)
                x, rate = memory[1 + 2 * k] - rest, memory[2 + 2 * k]
                cosine, sine = np.cos(swing * dt), np.sin(swing * dt) / swing
                decay = np.exp(-damping * w * dt)
                x, rate = (decay * (x * cosine + (rate + damping * w * x) * sine),
                           decay * (rate * cosine - (damping * w * rate + w * w * x) * sine))
                # what the body takes, as mean over the step
                s[sig.LINK_TORQUE] -= p[k] * (rate - memory[2 + 2 * k]) / dt
                memory[1 + 2 * k], memory[2 + 2 * k] = rest + x, rate
                frequency *= ratio
            memory[0] = 1.0


class LearnedDrift(Learned):
    """Friction times 1 + f(time): of one recording alone, reported and never written."""

    name = 'learned_drift'
    stage = Stage.FRICTION
    evidence = 'time'
    written = False
    size = ''
    what = 'a relative change of friction'
    parameters = _curve('s', 'time', -0.8, 4.0, '1')

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[sig.FRICTION] *= 1.0 + curve(s[sig.TIME], p)


LEARNED = {kind.name: kind for kind in (
    LearnedPosition, LearnedTorsion, LearnedRateFriction, LearnedPositionFriction,
    LearnedPositionDrag, LearnedLoadFriction, LearnedHysteresis, LearnedResonance, LearnedDrift)}
