# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What was found, in plain words."""

from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE, FOUND
from gms_flex_control.discrepancy.units import angle_scale, torque_scale
from gms_flex_control.discrepancy.unseen_links import lost_effects
from gms_flex_control.effects.registry import find

IN_MOTION = ('Moments at which a link stands were left out: friction then holds what no model of '
             'these foresees.')


def of_unseen(joints):
    """Return what is lost where links of some joints (names) have no encoder, a sentence."""
    names = ', '.join(joints)
    return (f"No link encoder of {names} was recorded: the link angle is the motor's less the "
            'twist that its torque, inertia and stiffness ask for, as believed. Not looked for '
            f'there: {", ".join(lost_effects())}.')


def tells_apart(effect, others):
    """Return the motion that tells an effect from others, '' if there are none."""
    return find(effect).tells if others else ''


def evidence_of(spec, one, others):
    """Return one sentence on why an effect is named."""
    scale = torque_scale(one.torque)
    alone = 100.0 * one.loss / one.own
    sentence = (f'with it the residual loses {scale.told(one.torque)} {scale.unit} rms; nothing '
                f'else in the model takes its place for {alone:.0f} % of that')
    if others:
        name, joint, share = others[0]
        sentence += (f'; the next best, {name} of {joint}, would explain '
                     f'{100.0 * min(share, 1.0):.1f} % of it')
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
        listed = result.added
        parts.append('The model lacks ' + '; '.join(named(one) for one in listed[:5]) + '.')
        if len(listed) > 5:
            parts.append(f'{len(listed) - 5} further small effects are listed in the report.')
        for one in listed[:5]:
            if one.confusable_with:
                parts.append(f'{one.effect} of {one.joint} could also be '
                             f'{" or ".join(one.confusable_with)}: {one.tells_apart} would tell.')
    if result.unexplained is not None:
        parts.append(f'Something is there that the catalogue does not explain: '
                     f'{result.unexplained.sentence}')
    torque, angle = torque_scale(gap.before), angle_scale(gap.free_before)
    torques = ', '.join(
        f'{torque.told(before)} -> {torque.told(after)} {torque.unit} ({joint}, floor '
        f'{torque.told(floor)})'
        for joint, before, after, floor in zip(gap.joints, gap.before, gap.after, gap.floor,
                                               strict=True))
    strays = ', '.join(
        f'{angle.told(before)} -> {angle.told(after)} {angle.unit}'
        for before, after in zip(gap.free_before, gap.free_after, strict=True))
    parts.append(f'On data held out the residual torque is {torques}, and half a second of free '
                 f'simulation strays by {strays}.')
    return ' '.join(parts)
