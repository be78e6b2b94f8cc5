# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What identification and discrepancy come to, in words: answers, and the text of a terminal."""

from pathlib import Path
import shlex
from textwrap import fill

from gms_flex_control.answer import align, Answer, command, measured, Number
from gms_flex_control.data.conditions import file_of
from gms_flex_control.discrepancy import describe
from gms_flex_control.discrepancy.result import FOUND
from gms_flex_control.identification import outcome
from gms_flex_control.identification.assumed_robot import refusals
from gms_flex_control.identification.output import condition_files
import numpy as np

WITHOUT, WITH = 'without effects', 'with effects'
COLUMNS = (WITHOUT, WITH, 'noise floor')
_KNOWN = ('well known', 'roughly known')
_WIDTH = 98           # of text
_LONGEST_NAME = 22    # of a joint in text

_CHANGED = 0.02       # share of an error that is worth a word


def identification_text(identification) -> str:
    """Return an identification as lines of text."""
    blocks = [_wrapped(f'{outcome.data_sentence(identification)}; fitted in '
                       f'{identification.seconds:.1f} s')]
    blocks += [_wrapped(f'warning: {text}') for text in identification.warnings]
    blocks += [_joint_text(result) for result in identification.joints]
    if identification.others.estimates:
        blocks.append('\n'.join(['other joints:', *_parameter_lines(identification.others)]))
    blocks.append('Errors on held-out data; C+v: Coulomb + viscous alone\n'
                  + align(*held_out_rows(identification.joints)))
    return '\n\n'.join(blocks)


def _parameter_rows(result):
    """Return header and rows of a joint's parameters."""
    header = ('parameter', 'unit', 'value', '95 % interval', 'to be noted')
    rows = []
    for estimate in result.estimates:
        lost = outcome.standing(estimate) == outcome.NOT_IDENTIFIABLE
        value, interval = outcome.number(estimate.value), outcome.span(estimate.interval)
        rows.append((outcome.short_name(estimate.name, result.joint), estimate.unit,
                     f'({value})' if lost else value, interval, _remark(estimate)))
    return header, rows


def _remark(estimate):
    if outcome.standing(estimate) == outcome.NOT_IDENTIFIABLE:
        return 'NOT IDENTIFIABLE'
    if len(estimate.flags) > 1:
        return f'{estimate.flags[0]}, +{len(estimate.flags) - 1}'
    if estimate.flags:
        return estimate.flags[0]
    return outcome.SET if outcome.standing(estimate) == outcome.SET else ''


def held_out_rows(results) -> tuple:
    """Return header and rows of held-out errors, one row per joint."""
    header = ('joint', 'torque [%]', 'C+v [%]', 'noise [%]', 'repeat [%]', 'free run [mrad]',
              'C+v [mrad]')
    rows = []
    for result in results:
        errors = result.held_out
        noise, repeat = outcome.floor_shares(errors)
        rows.append((_clipped(result.joint), *(outcome.number(100 * share, 3) for share in (
            errors.relative, errors.coulomb_viscous, noise, repeat)),
            outcome.number(1e3 * errors.free_run_rms, 3),
            outcome.number(1e3 * errors.free_run_coulomb_viscous, 3)))
    return header, rows


def _joint_text(result):
    blocks = [(candidate.n_blocks, candidate.chosen) for candidate in result.candidates]
    chosen = next((f', N = {n} blocks' for n, used in blocks if used), '')
    source = {'spring': 'the spring', 'motor': 'the motor torque'}.get(result.side, result.side)
    lines = [f'{_clipped(result.joint)}: friction torque by {source}{chosen}',
             *_parameter_lines(result)]
    lines += [_wrapped(f'warning: {text}') for text in result.warnings]
    return '\n'.join(lines)


def _parameter_lines(result):
    return [align(*_parameter_rows(result)),
            *(_wrapped(f'- {note}') for note in outcome.notes(result))]


def _clipped(name):
    return name if len(name) <= _LONGEST_NAME else f'{name[:_LONGEST_NAME - 1]}…'


def _wrapped(text):
    return fill(text, _WIDTH, subsequent_indent='  ')


def identification_answer(identification, folder, robot=()) -> Answer:
    """Return how far the friction found predicts (Answer); ``robot`` files were believed."""
    worst, folder = worst_joint(identification), Path(folder)
    errors, joint = worst.held_out, worst.joint
    counts = identification.robot.encoder.counts  # if unknown the error a sample ahead serves
    reading = 2.0 * np.pi / counts / np.sqrt(12.0) if counts > 0.0 else errors.innovation_rms
    numbers = [
        measured(f'torque error of {joint} [% of the drive torque]', errors.coulomb_viscous,
                 errors.relative, np.fmax(*outcome.floor_shares(errors)), scale=100.0),
        measured(f'error of free runs of {joint} [mrad]', errors.free_run_coulomb_viscous,
                 errors.free_run_rms, reading)]
    known = next((one for one in worst.estimates if outcome.standing(one) in _KNOWN), None)
    if known is not None:
        low, high = known.interval
        numbers.append(measured(
            f'{outcome.short_name(known.name, joint)} of {joint} [{known.unit}]', None,
            known.value, 0.5 * (high - low), scale=1.0))
    files = robot or (('robot.yaml',) if identification.described else ())
    copies = [shlex.join(['cp', str(path), str(file_of(identification.sources[r]))])
              for r, path in condition_files(identification, folder).items()]
    return Answer(_identified(identification, worst),
                  ('Coulomb + viscous', 'identified', 'noise floor'), tuple(numbers),
                  ' && '.join([*copies, command(
                      'discrepancy', *identification.sources, '--robot', *files,
                      folder / 'friction.yaml', '--out', folder / 'gap')]))


def worst_joint(identification) -> outcome.JointResult:
    """Return the joint whose torque is predicted worst."""
    return max(identification.joints, key=lambda result: np.nan_to_num(result.held_out.relative))


def _identified(identification, worst):
    errors = worst.held_out
    standings = [outcome.standing(one) for result in identification.joints_and_others
                 for one in result.estimates]
    found, fitted = (len(standings) - sum(map(standings.count, those)) for those in (
        (outcome.NOT_IDENTIFIABLE, outcome.DOUBTFUL, outcome.SET), (outcome.SET,)))
    known = (f'{found} of {fitted} parameters {"is" if found == 1 else "are"} identified'
             if found < fitted else
             f'all {fitted} parameters are identified')
    if not np.isfinite(errors.relative):
        return f'{known.capitalize()}, but no held-out data check them.'
    simple = ('no better than Coulomb + viscous friction alone' if errors.relative
              >= errors.coulomb_viscous else 'Coulomb + viscous friction alone to '
              + outcome.percent(errors.coulomb_viscous))
    text = ('On motion left out of the fit, the identified friction predicts the torque of '
            f'{worst.joint}, the worst joint, to {outcome.percent(errors.relative)}, {simple}; '
            f'{known}. The noise floor is what the readings alone, or the repeated motion, would '
            'leave.')
    return f'{outcome.distrust(errors)} {text}'.lstrip()


def discrepancy_answer(result, folder, holdout=()) -> Answer:
    """
    Return what the model lacks and how much closer it came (Answer).

    robot.yaml is in ``folder``; ``holdout`` are the bags held out, paths.
    """
    if result.gap is None:
        return Answer(result.data.faults[0] if result.data.faults else result.words, (), (),
                      command('info', *result.data.sources))
    torque, angle = gap_numbers(result.gap)
    numbers = [torque[0], angle[0], *_values(result), *torque[1:], *angle[1:]]
    return Answer(_lacking(result), COLUMNS, tuple(numbers[:3]),
                  command(*_next_of(result, Path(folder), holdout)))


def _next_of(result, folder, holdout):
    """
    Return the words of the command that follows a Discrepancy whose robot.yaml is in ``folder``.

    Where `identify` finds no friction beside what the robot has, or has found it, the written
    friction is the result: other data try it, and a model that lacks nothing is controlled, with
    torques and travel as recorded.
    """
    model, bags, likelihood = folder / 'robot.yaml', result.data.sources, result.behind.likelihood
    if result.is_open and not result.learned:
        return 'discrepancy', *bags, '--robot', model, '--learn', '--out', folder / 'learned'
    if not (result.is_open or result.identified_beside or refusals(result.robot)):
        return 'identify', *bags, '--robot', model, '--out', folder / 'friction'
    if result.verdict == FOUND and not result.learned:
        return 'discrepancy', *(holdout or bags), '--robot', model, '--out', folder / 'again'
    recorded = [likelihood.scales_of(joint) for joint in result.robot.joints]
    return ('tune', '--robot', model, '--torque-limit', *(f'{one.torque:.3g}' for one in recorded),
            '--amplitude', f'{0.5 * max(one.travel.span for one in recorded):.2g}',
            '--out', folder / 'tuned')


def gap_numbers(gap) -> tuple:
    """Return Numbers of residual torque and of free-run error, the largest change first."""
    torque, angle = describe.torque_scale(gap.retuned), describe.angle_scale(gap.free_before)
    return tuple([
        Number(f'{name} of {gap.joints[j]} [{scale.unit}]', *(
            scale.text(values[j]) for values in (without, found, floor)))
        for j in np.argsort(-np.nan_to_num(without - found), kind='stable')]
        for name, scale, without, found, floor in (
            ('residual torque', torque, gap.retuned, gap.after, gap.floor),
            ('error of free runs', angle, gap.free_before, gap.free_after, gap.free_floor)))


def _values(result):
    """Return the values of the finding that matters most as Numbers; noise makes its interval."""
    if not result.added:
        return []
    first, numbers = result.added[0], []
    for value in first.values:
        scale = (describe.angle_scale(value.value) if value.unit == 'rad' else
                 describe.torque_scale(value.value) if value.unit == 'N m' else
                 describe.Scale(value.unit, 1.0))
        numbers.append(Number(
            f'{value.name} of {first.effect}' + ('' if scale.unit == '1' else f' [{scale.unit}]'),
            '-', *map(scale.text, (value.value, 0.5 * (value.high - value.low)))))
    return numbers


def _lacking(result):
    if not result.added:
        left = result.unexplained
        return ' '.join(filter(None, (
            describe.of_not_added(result), left and 'Something is missing that no effect of the '
            f'catalogue explains: {left.sentence}'))) or describe.of_complete(result.gap)
    effects = ' and '.join(
        f'{one.effect} of {one.joint} ({describe.value_words(one)}'
        + (f'; indistinguishable here from {describe.of_joints(one.indistinguishable_from)})'
           if one.indistinguishable_from else ')') for one in result.added)
    gap = result.gap.of_joints({one.joint for one in result.added})
    changes = [_change(*figures) for figures in (
        ('the residual torque', gap.retuned, gap.after, gap.floor),
        ('the error of free runs', gap.free_before, gap.free_after, gap.free_floor))
        if np.nansum(figures[1]) > 0.0]
    at_floor = [name for name, _, there in changes if there]
    which = 'both' if len(at_floor) == 2 else ''.join(at_floor)
    where = f', {which} to about the noise floor, which' if at_floor else '. The noise floor'
    found = 'it' if len(result.added) == 1 else 'them'
    return ' '.join(filter(None, (
        f'The model lacks {effects}: with {found}, on held-out data, '
        f'{" and ".join(change for _, change, _ in changes)}{where} is what encoders and torque '
        'noise alone would leave.', describe.of_unexplained(result.unexplained))))


def _change(name, without, found, floor):
    """Return an error's name, how it changes in words, and whether it shrinks to its floor."""
    before, after, least = map(describe.total, (without, found, floor))
    share = 1.0 - after / before
    there, was_there = (one <= outcome.AT_FLOOR * least for one in (after, before))
    if share < _CHANGED and there and was_there:
        return name, f'{name} is at its noise floor either way', False
    if abs(share) < _CHANGED:
        return name, f'{name} stays as it is', False
    already = ', below its noise floor already,' if before <= least else (
        ', at its noise floor already,' if was_there else '')
    return (name, f'{name}{already} {"shrinks" if share > 0.0 else "grows"} by '
            f'{100.0 * abs(share):.0f} %', share > 0.0 and there and not was_there)
