# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What an identification says, in plain words: how far each number can be trusted."""

import numpy as np

NOT_IDENTIFIABLE = 'not identifiable'
DEPENDS = 'depends on the model'
DOUBTFUL = 'doubtful'
SET = 'set, not fitted'
WELL_KNOWN = 0.1      # half of the 95 % interval over the value, at most
_UNEXPLAINED = 0.5    # of the drive torque: beyond, nothing is to be trusted
_ENDLESS = 1e6       # upper end over lower end of an interval that says nothing
_AT_FLOOR = 1.3       # error over floor that counts as the floor itself
STANDINGS = ('well known', 'roughly known', DOUBTFUL, NOT_IDENTIFIABLE, SET)


def short_name(name, joint):
    """Return 'forward.static' for 'friction.joint1.forward.static'."""
    head, _, rest = name.partition(f'.{joint}.')
    if not rest:
        return name
    return rest if head == 'friction' else f'{head}.{rest}'


def short_label(label):
    """Return the label of a piece of data without the folders before its recording."""
    return label.rstrip('/').rsplit('/', 1)[-1]


def spread(estimate):
    """Return half of the interval over the value; NaN if not known."""
    low, high = estimate.interval
    return 0.5 * (high - low) / abs(estimate.value) if estimate.value else np.nan


def standing(estimate):
    """Return which of STANDINGS an Estimate has; an interval without width was set."""
    if NOT_IDENTIFIABLE in estimate.flags or not np.isfinite(estimate.value):
        return NOT_IDENTIFIABLE
    if estimate.flags:
        return DOUBTFUL
    low, high = estimate.interval
    if low == high:
        return SET
    return 'well known' if spread(estimate) <= WELL_KNOWN else 'roughly known'


def number(value, digits=4):
    """Return a number as text, '-' for none."""
    return f'{value:.{digits}g}' if np.isfinite(value) else '-'


def quantity(value, unit):
    """Return a number with its unit as text, '-' for none."""
    return f'{number(value)} {unit}' if np.isfinite(value) else '-'


def percent(share):
    """Return a share as text, such as '4.1 %'; 'unknown' for none."""
    return f'{100 * share:.3g} %' if np.isfinite(share) else 'unknown'


def span(interval):
    """Return an Interval as text, such as '0.1 .. 0.2'; '-' if unknown or without width or end."""
    low, high = interval
    if not np.isfinite(interval).any() or low == high or 0.0 < _ENDLESS * low < high:
        return '-'
    return f'{number(low)} .. {number(high)}'


def floor_shares(held_out):
    """Return noise floor and repeatability relative to the drive torque, NaN where unknown."""
    known = held_out.relative > 0.0 and held_out.torque_rms > 0.0
    share = held_out.relative / held_out.torque_rms if known else np.nan
    return share * held_out.noise_floor, share * held_out.repeatability


def joint_sentences(result):
    """
    Return what can be trusted of one joint, what not, and which motion would tell.

    Parameters
    ----------
    result : JointResult
        Of any method.

    Returns
    -------
    list of (str, bool)
        Sentences, and whether each is a warning.

    """
    return [*_prediction(result.held_out), *_parameters(result),
            *((text, True) for text in result.warnings)]


def _prediction(errors):
    own, simple = errors.relative, errors.coulomb_viscous
    if not np.isfinite(own):
        return [('There is no held-out error: nothing checks these numbers.', True)]
    lines = [(f'On motion that took no part in the fit, the drive torque is predicted with an '
              f'error of {percent(own)} of its rms; Coulomb + viscous friction alone leaves '
              f'{percent(simple)}.', False)]
    if own >= simple:
        lines.append(('For this motion the model is no better than Coulomb + viscous friction '
                      'alone.', True))
    if own > _UNEXPLAINED:
        lines.append(('More than half of the drive torque stays unexplained: trust none of these '
                      'numbers until the cause is found (scale or sign of the torque, inertia, '
                      'gravity).', True))
    lines.append((_floor(errors), False))
    if np.isfinite(errors.free_run_rms):
        lines.append((
            f'Running free for {number(errors.horizon, 3)} s from a measured state, the model '
            f'ends up {number(1e3 * errors.free_run_rms, 3)} mrad (rms) off; with Coulomb + '
            f'viscous alone {number(1e3 * errors.free_run_coulomb_viscous, 3)} mrad.', False))
    return lines


def _floor(errors):
    noise, repeat = floor_shares(errors)
    floors = [f'noise alone makes {percent(noise)}'] if np.isfinite(noise) else []
    floors += [f'the same motion repeated differs by {percent(repeat)}'] if np.isfinite(
        repeat) else ['no motion was repeated, so that repeatability is not known']
    text = ', '.join(floors)
    best = np.fmax(noise, repeat)
    if np.isfinite(best):
        text += (': the model is as good as these data allow'
                 if errors.relative <= _AT_FLOOR * best else
                 ': the rest is due to the model, or to motion too quick for these samples')
    return f'{text[0].upper()}{text[1:]}.'


def _parameters(result):
    names = {kind: [] for kind in STANDINGS}
    for estimate in result.estimates:
        names[standing(estimate)].append(estimate)
    lines = []
    for kind, opening, warn in (
            ('well known', f'Known within {100 * WELL_KNOWN:g} %', False),
            ('roughly known', 'Known roughly', False),
            ('doubtful', 'To be taken with care', True),
            (NOT_IDENTIFIABLE, 'NOT identifiable from these data, not to be taken as facts',
             True), (SET, 'Set, not fitted', False)):
        if names[kind]:
            mentions = [_mention(estimate, kind, result.joint) for estimate in names[kind]]
            lines.append((f"{opening}: {', '.join(_joined(mentions))}.", warn))
    return [*lines, *((note, False) for note in notes(result))]


def notes(result):
    """Return the notes on estimates of a JointResult as sentences, those alike as one."""
    about = {}
    for estimate in result.estimates:
        if estimate.note:
            about.setdefault(estimate.note.rstrip('.'), []).append(
                short_name(estimate.name, result.joint))
    return [f"{', '.join(_joined(names))}: {note}." for note, names in about.items()]


def _mention(estimate, kind, joint):
    name = short_name(estimate.name, joint)
    if kind == 'roughly known':
        return f'{name} (± {percent(spread(estimate))})' if np.isfinite(
            spread(estimate)) else f'{name} (no interval)'
    return f"{name} ({', '.join(estimate.flags)})" if kind == 'doubtful' else name


def _joined(mentions):
    """Return 'weight[0..2]' for 'weight[0]', 'weight[1]', 'weight[2]'; the rest as it is."""
    out, run = [], []
    for mention in [*mentions, '']:
        leaf, bracket, index = mention.partition('[')
        follows = bracket and index[:-1].isdigit() and index.endswith(']')
        if run and follows and run[-1] == (leaf, int(index[:-1]) - 1):
            run.append((leaf, int(index[:-1])))
            continue
        if run:
            last = f'..{run[-1][1]}' if len(run) > 1 else ''
            out.append(f'{run[0][0]}[{run[0][1]}{last}]')
        run = [(leaf, int(index[:-1]))] if follows else []
        out += [mention] if mention and not follows else []
    return out


def data_sentence(identification):
    """Return what data an Identification rests on, how fitted and what was held out."""
    names = ', '.join(identification.sources)
    recorded = f', recorded {identification.recorded}' if identification.recorded else ''
    held = (f"held out: {', '.join(identification.holdouts)}" if identification.holdouts
            else 'blocks of time held out')
    return (f'{identification.duration:.4g} s at {1.0 / identification.period:.4g} Hz from '
            f'{names}{recorded}; method {identification.method}, {held}')
