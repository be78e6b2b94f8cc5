# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What was found, in plain words."""

from gms_flex_control.discrepancy.naming import strayed
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE, FOUND
from gms_flex_control.discrepancy.units import angle_scale, torque_scale
from gms_flex_control.discrepancy.unseen_links import lost_effects
from gms_flex_control.effects.registry import find
import numpy as np

_IN_FULL = 5  # findings that are said in full, and named
_NEAR = 0.5, 2.0  # of squares of free runs and of torque: effects that leave less come near
IN_MOTION = ('Moments at which a link stands were left out: friction then holds what no model of '
             'these foresees.')


def first_of(texts, count):
    """Return the first few texts as sentences, and how many more there are."""
    more = [f'({len(texts) - count} more in the report.)'] if len(texts) > count else []
    return ' '.join([f'{text.rstrip(".")}.' for text in texts[:count]] + more)


def of_unseen(joints):
    """Return what is lost where links of some joints (names) have no encoder, a sentence."""
    names = ', '.join(joints)
    return (f"No link encoder of {names} was recorded: the link angle is the motor's less the "
            'twist that its torque, inertia and stiffness ask for, as believed. Not looked for '
            f'there: {", ".join(lost_effects())}. Without link encoders less is told '
            '(docs/hidden_effects.md).')


def of_late(samples, periods):
    """Return a sentence on torques that were recorded so many samples (periods [s]) late."""
    times = sorted({f'{1e3 * samples * period:.3g}' for period in periods}, key=float)
    return (f'the torque stands {samples} sample{"s" * (samples > 1)} '
            f'({" or ".join(times)} ms) after the motion it caused: with all of it '
            'earlier by that, less than a tenth of what is missing remains; record torque with '
            'the stamp from which on it was held, or shift it')


def of_known(first, effects, whole, least):
    """
    Return a sentence if an effect that the model has would explain most with another value.

    Parameters
    ----------
    first : sequence of Ranked
        Of the first scan, the best first.
    effects : sequence of EffectSpec
        That the model has.
    whole : float
        What is missing, in units of gain.
    least : float
        Gain below which nothing is told.

    Returns
    -------
    str

    """
    if not first or first[0].gain < max(0.5 * whole, least):
        return ''
    name, joint = first[0].spec.name, first[0].spec.joint
    if (name, joint) not in {(spec.name, spec.joint) for spec in effects}:
        return ''
    return (f'{name} of {joint}, which the model has already, would '
            'explain more than anything else with another value: correct it or take it out, and '
            'ask again; what is named here may but stand for that.')


def of_nearest(near):
    """
    Return a sentence on what all but helped on data held out, '' if nothing did.

    Parameters
    ----------
    near : sequence of (float, float, list of (str, str))
        Squared strays of free runs and squared torque missed, after over before, and the effects
        with their joints.

    Returns
    -------
    str

    """
    near = [one for one in near if one[0] < _NEAR[0] and one[1] < _NEAR[1]]
    if not near:
        return ''
    stray, torque, effects = min(near)
    names = ' and '.join(f'{name} of {joint}' for name, joint in effects)
    return (f'nearest comes {names}: with it the free runs held out would stray '
            f'{stray ** 0.5:.2g} times as far and the torque missed there be {torque ** 0.5:.2g} '
            'times as large; to be added it would have to help both, or one of them more.')


def of_withheld(gap):
    """Return a sentence on effects that are named and would make a model worse, by their Gap."""
    runs = '' if np.isnan(gap.free_after).any() else (
        f', and free runs would stray {strayed(gap) ** 0.5:.3g} times as far')
    return ('What is named here is not added to the model: on data held out the torque missed '
            f'would be {gap.energy_ratio ** 0.5:.3g} times as large with it{runs}.')


def capitalised(text):
    """Return a text (not empty) with a capital at its beginning, the rest as it is."""
    return text[0].upper() + text[1:]


def tells_apart(effect, others):
    """Return the motion that tells an effect from others, '' if there are none (a sequence)."""
    return find(effect).tells if others else ''


def evidence_of(spec, one, others):
    """Return one sentence on why an effect is named."""
    scale = torque_scale(one.torque)
    sentence = (f'with it the residual loses {scale.told(one.torque)} {scale.unit} rms, '
                f'{100.0 * one.share:.0f} % of which (in squares) nothing else in the model makes '
                'up for')
    if others:
        name, joint, share = others[0]
        sentence += (f'; added in its place, the next best, {name} of {joint}, would make up for '
                     f'{100.0 * min(share, 1.0):.1f} % of that')
    return sentence + '.'


def value_words(finding):
    """Return the values of a finding, such as 'half_gap 0.0021 rad'."""
    return ', '.join(f'{v.name} {v.value:.4g}{"" if v.unit == "1" else " " + v.unit}'
                     for v in finding.values)


def named(finding):
    """Return a finding in few words."""
    summary = (find(finding.effect).__doc__ or '').strip().splitlines()[0]
    return f'{finding.effect} of {finding.joint} ({value_words(finding)}; {summary.rstrip(".")})'


def paragraph(result):
    """Return one paragraph on a Discrepancy."""
    if result.verdict == BAD_DATA:
        return result.words
    gap, parts = result.gap, []
    if result.verdict == COMPLETE:
        parts.append('Nothing is missing: what the model leaves is what a run of the model itself '
                     'leaves when read through the same encoders.')
    if result.verdict == FOUND:
        parts += _listed(result)
    if result.withheld:
        parts.append(of_withheld(result.withheld))
    if result.unexplained is not None:
        parts.append(f'Something is there that the catalogue does not explain: '
                     f'{result.unexplained.sentence}')
    if result.nearest:
        parts.append(capitalised(result.nearest))
    torque, angle = torque_scale(gap.before), angle_scale(gap.free_before)
    torques = ', '.join(
        f'{torque.told(before)} -> {torque.told(after)} {torque.unit} ({joint}, floor '
        f'{torque.told(floor)})'
        for joint, before, after, floor in zip(gap.joints, gap.before, gap.after, gap.floor,
                                               strict=True))
    strays = ', '.join(
        f'{angle.told(after)} {angle.unit}' if result.verdict == COMPLETE else
        f'{angle.told(before)} -> {angle.told(after)} {angle.unit}'
        for before, after in zip(gap.free_before, gap.free_after, strict=True))
    where = 'Without it, on' if result.withheld else 'On'
    parts.append(f'{where} data held out the residual torque is {torques}, and ' + (
        'free simulation of half a second tells nothing' if np.isnan(gap.free_after).any() else
        'half a second of free simulation, known parameters re-tuned, strays by '
        f'{strays}') + '.')
    return ' '.join(parts)


def _listed(result):
    """Yield sentences: findings and what they could also be, small ones, those of many names."""
    groups = [group for group in (result.findings, result.minor, result.undecided) if group]
    shown = groups[0][:_IN_FULL]
    small = '' if result.findings else ', small as it is,'
    yield f'The model lacks{small} {"; ".join(named(one) for one in shown)}.'
    for one in shown:
        if one.confusable_with:
            yield (f'{one.effect} of {one.joint} could also be '
                   f'{" or ".join(one.confusable_with)}: {one.tells_apart} would tell.')
    beside = [*groups[0][_IN_FULL:], *(result.minor if result.findings else ())]
    if beside:
        yield f'Smaller beside that: {_briefly(beside)}.'
    if result.undecided and groups[0] is not result.undecided:
        size = '' if any(one.main for one in result.undecided) else ' small'
        yield (f'Something{size} is there too that these data cannot tell from others, it could '
               f'be {_briefly(result.undecided)}.')


def _briefly(findings):
    """Return the names of the first few findings, and how many more there are."""
    names = ', '.join(f'{one.effect} of {one.joint}' for one in findings[:_IN_FULL])
    more = len(findings) - _IN_FULL
    return f'{names} and {more} more in the report' if more > 0 else names
