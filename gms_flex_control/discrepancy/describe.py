# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What was found, in plain words, with units that suit: of a desk arm, or of a press."""

from typing import NamedTuple

from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE, FOUND, UNEXPLAINED
from gms_flex_control.discrepancy.thresholds import WORSE
from gms_flex_control.effects.registry import find, in_words, names
from gms_flex_control.identification.outcome import AT_FLOOR
import numpy as np

_IN_FULL = 5          # findings that are named in full
_REMAINS = 0.1        # of what is missing: less is not worth a sentence


class Scale(NamedTuple):
    """A unit, and how many of it one SI unit is."""

    unit: str
    factor: float

    def text(self, value) -> str:
        """Return a value in SI units as a number of this unit, three digits; '-' if absent."""
        return f'{self.factor * value:.3g}' if np.isfinite(value) else '-'


_TORQUES = ((0.9, Scale('mN m', 1e3)), (900.0, Scale('N m', 1.0)), (np.inf, Scale('kN m', 1e-3)))
_ANGLES = ((0.9, Scale('mrad', 1e3)), (np.inf, Scale('rad', 1.0)))


def torque_scale(values) -> Scale:
    """Return the Scale that suits torques (any shape) [N m]."""
    return _suiting(_TORQUES, values)


def angle_scale(values) -> Scale:
    """Return the Scale that suits angles (any shape) [rad]."""
    return _suiting(_ANGLES, values)


def _suiting(scales, values):
    sizes = np.abs(np.asarray(values, dtype=float))
    largest = float(np.max(sizes, where=np.isfinite(sizes), initial=0.0))
    return next(scale for limit, scale in scales if largest < limit)


def first_of(texts, count) -> str:
    """Return the first few texts as sentences, and how many more there are."""
    more = [f'({len(texts) - count} more in the report.)'] if len(texts) > count else []
    return ' '.join([f'{text.rstrip(".")}.' for text in texts[:count]] + more)


def listed(specs) -> str:
    """Return EffectSpecs as names of joints."""
    return ' and '.join(f'{spec.name} of {spec.joint}' for spec in specs)


def evidence_of(one, others) -> str:
    """Return one sentence on why an effect is named, from its Worth and its rivals."""
    scale = torque_scale(one.torque)
    sentence = (f'it contributes {scale.text(one.torque)} {scale.unit} rms, '
                f'{100.0 * one.share:.0f} % of which (in squares) nothing else in the model can '
                f'produce; on blocks of time left out of the fit it adds {one.gain.nats:.3g} to '
                f'the log likelihood, {one.gain.sigmas:.2g} standard errors')
    if others:
        name, joint, share = others[0]
        sentence += (f'; the next best in its place, {name} of {joint}, explains '
                     f'{100.0 * share:.1f} % of that')
    return sentence + '.'


def evidence_of_ripple(ripple) -> str:
    """Return one sentence on why a FastRipple is named."""
    scale = torque_scale(ripple.residual)
    before, after = (scale.text(one) for one in ripple.residual)
    return (f'at every sample, above the low-pass as well, it lessens the residual torque from '
            f'{before} to {after} {scale.unit} rms and errors of prediction one sample ahead by '
            f'{100.0 * ripple.share:.2g} % (in squares); on blocks of time left out of the fit '
            f'it adds {ripple.gain.nats:.3g} to the log likelihood, {ripple.gain.sigmas:.2g} '
            'standard errors.')


def of_joints(effects, between=', ') -> str:
    """Return (effect, joint) pairs in words, sorted."""
    return between.join(f'{effect} of {joint}' for effect, joint in sorted(effects))


def value_words(finding) -> str:
    """Return the values of a finding, such as 'half_gap 0.0021 rad'."""
    return ', '.join(f'{v.name} {v.value:.4g}{"" if v.unit == "1" else " " + v.unit}'
                     for v in finding.values)


def named(finding) -> str:
    """Return a finding in few words."""
    return (f'{finding.effect} of {finding.joint} ({value_words(finding)}; '
            f'{in_words(finding.effect)})')


def of_not_added(result) -> str:
    """Return a sentence on findings that matter and are not in the model written, '' if none."""
    shown = result.not_added[:_IN_FULL]
    if not shown:
        return ''
    them, are = ('them', 'they are') if len(shown) > 1 else ('it', 'it is')
    return (f'The recordings show {"; ".join(named(one) for one in shown)}, but no model with '
            f'{them} predicts everything as well: {are} named and not added.')


def of_complete(gap) -> str:
    """Return a sentence on a model to which no effect is to be added, by its Gap."""
    floor = 'the noise floor, which encoders and torque noise alone produce.'
    if all(total(after) <= AT_FLOOR * total(least) for after, least in (
            (gap.after, gap.floor), (gap.free_after, gap.free_floor))):
        return ('Nothing that matters is missing: on held-out data the error of the model does '
                f'not exceed {floor}')
    return ('No effect of the catalogue improves the prediction of held-out data by a relevant '
            f'amount, though its error exceeds {floor}')


def total(errors) -> float:
    """Return the root of the sum of squares of errors (n,), NaN left out."""
    return float(np.sqrt(np.nansum(errors ** 2)))


def of_noise(noise) -> str:
    """Return a Noise in words."""
    scale = torque_scale(noise.rms)
    where = f'drive of {noise.joint}' if noise.equation == 'motor' else f'link of {noise.joint}'
    per_sample = (f'{scale.text(noise.per_sample)} {scale.unit} per sample, '
                  if noise.per_sample > 0.0 else '')
    colour = {'white': 'white', 'slow': 'mostly slow', 'fast': 'mostly fast'}[noise.colour]
    return f'{where}: {per_sample}{scale.text(noise.rms)} {scale.unit} rms up to 8 Hz, {colour}'


def paragraph(result, unseen, known_off) -> tuple:
    """Return one paragraph on a Discrepancy, and what of it an answer in short leaves out."""
    if result.verdict == BAD_DATA:
        return result.words, ''
    parts = [*_verdict(result), *_remainder(result)]
    if result.stand_ins:
        names_of = listed(result.stand_ins)
        left = min(result.gap.energy_ratio, 1.0)
        parts.append((f'The written model has {names_of} ' + {
            COMPLETE: 'as well: it predicts better so, though by less than what matters in '
                      'practice.',
            FOUND: 'beside these: it predicts better so, but that only resembles what else is '
                   'missing.',
            UNEXPLAINED: f'in its place: this explains {100.0 * (1.0 - left):.0f} % of what is '
                         'missing and predicts better, but it only resembles the cause; '
                         f'{100.0 * left:.0f} % remains unexplained.'}[result.verdict], True))
    parts.append((_gap(result), False))
    more = [*_noise(result)]
    if result.data.differences:
        more.append(f'Different from the first recording: {"; ".join(result.data.differences)}.')
    if unseen:
        lost = [name for name in names() if find(name).needs_link_encoder]
        more.append(f'No link encoder of {", ".join(unseen)} was recorded: the link angle is '
                    "computed from the motor's, its torque, inertia and stiffness as believed. "
                    f'Not identifiable there: {", ".join(lost)}.')
    if known_off:
        more.append(f'{known_off[0]} of {known_off[1]} is in the model already; another value of '
                    'it would explain more than any new effect. Correct it or take it out, and '
                    'run again.')
    return (' '.join([*(one for one, _ in parts), *more]),
            ' '.join([*(one for one, is_detail in parts if is_detail), *more]))


def _verdict(result):
    """Yield what is missing, and what each finding could also be: sentence, whether a detail."""
    if result.verdict == COMPLETE:
        yield of_complete(result.gap), False
    shown = result.added[:_IN_FULL]
    if shown:
        yield f'The model lacks {"; ".join(named(one) for one in shown)}.', False
    if result.not_added:
        yield of_not_added(result), bool(shown)
    for one in (*shown, *result.not_added[:_IN_FULL]):
        if one.indistinguishable_from:
            yield (f'{one.effect} of {one.joint} is indistinguishable here from '
                   f'{of_joints(one.indistinguishable_from, " or ")}; discriminating experiment: '
                   f'{one.discriminated_by}.'), True
    added = {spec.key for spec in result.robot.effects}
    for what, few in (('The model also lacks', result.added[_IN_FULL:]),
                      ('Too small to matter in practice:',
                       [one for one in result.minor if one.key in added])):
        if few:
            yield f'{what} {_briefly(few)}.', True
    without = [one for one in result.minor if one.key not in added]
    if without:
        yield ('The recordings also support these, but the model predicts better without them: '
               f'{_briefly(without)}.', True)


def of_unexplained(left) -> str:
    """Return a sentence on the joints of a Signature (or None) that no effect explains, or ''."""
    if left is None or not left.joints:
        return ''
    return (f'{" and ".join(left.joints)} {"remain" if len(left.joints) > 1 else "remains"} '
            f'unexplained: {left.sentence}')


def _remainder(result):
    """Yield how much is explained, and what remains: sentence, whether a detail."""
    gap, left = result.gap, result.unexplained
    if result.verdict == FOUND and left is not None and left.share > _REMAINS:
        own = gap.of_joints({one.joint for one in result.added}) if left.joints else gap
        share, sure = min(own.energy_ratio, 1.0), min(one.probability for one in result.added)
        where = f' in {" and ".join(own.joints)}' if own is not gap else ''
        rest = '.' if left.joints else (
            f'; {100.0 * share:.0f} % remains unexplained: {left.sentence}')
        yield (f'That explains {100.0 * (1.0 - share):.0f} % of what is missing{where} '
               f'({sure:.2f} sure){rest}', True)
    unexplained = of_unexplained(left)
    if result.verdict == FOUND and unexplained:
        yield unexplained, False
    elif left is not None and result.verdict != FOUND:
        yield (f'Something is missing that the catalogue does not explain: {left.sentence}', False)


def _gap(result):
    """Return a sentence on torque and free runs on held-out data."""
    gap = result.gap
    torque, angle = torque_scale(gap.before), angle_scale(gap.free_before)
    torques = ', '.join(
        f'{torque.text(before)} -> {torque.text(after)} {torque.unit} ({joint}, noise floor '
        f'{torque.text(floor)})'
        for joint, before, after, floor in zip(gap.joints, gap.retuned, gap.after, gap.floor,
                                               strict=True))
    text = f'On held-out data the residual torque in motion is {torques}'
    if np.isnan(gap.free_after).any():
        return f'{text}; no free run was possible.'
    runs = ', '.join(
        f'{angle.text(before)} -> {angle.text(after)} {angle.unit} (noise floor '
        f'{angle.text(floor)})'
        for before, after, floor in zip(gap.free_before, gap.free_after, gap.free_floor,
                                        strict=True))
    return f'{text}; errors of free runs of half a second are {runs}.{_untouched(result)}'


def _untouched(result):
    """Return a sentence if what was added hardly acts on held-out data, else ''."""
    gap = result.gap
    acts = any(np.any(np.abs(after - before) > WORSE * before) for before, after in (
        (gap.retuned, gap.after), (gap.free_before, gap.free_after)))
    return '' if acts or not result.added else (
        ' The held-out motion hardly meets what was found; hold out one that does to see the gap '
        'shrink.')


def _noise(result):
    """Yield a sentence on the torque noise of the recordings, if it matters."""
    shown = [of_noise(one) for one in result.data.noise if one.equation == 'motor'
             or one.rms > 0.0 and result.verdict == COMPLETE]
    if shown:
        yield f'Torque noise of the recording: {"; ".join(shown)}.'


def _briefly(findings):
    """Return the names of the first few findings, and how many more there are."""
    shown = ', '.join(f'{one.effect} of {one.joint}' for one in findings[:_IN_FULL])
    more = len(findings) - _IN_FULL
    return f'{shown} and {more} more in the report' if more > 0 else shown
