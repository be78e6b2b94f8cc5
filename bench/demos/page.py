# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The report of `bench demo-discrepancy`: gap and tracking before and after, and the truth."""

from pathlib import Path
from typing import Any, NamedTuple

from bench.demos.hidden_effect import link_rms
from gms_flex_control import __version__
from gms_flex_control.answer import align, Answer, command, measured
from gms_flex_control.control.feedforward import compensated
from gms_flex_control.discrepancy.result import Discrepancy, Finding
from gms_flex_control.file_io import plain, write_json
from gms_flex_control.reports import discrepancy_values
from gms_flex_control.reports.answers import gap_numbers, WITH, WITHOUT
from gms_flex_control.reports.discrepancy_page import add_discrepancy
from gms_flex_control.reports.figure_style import (
    COLOURS,
    finished,
    save_figure,
    stacked_panels,
    thinned,
)
from gms_flex_control.reports.page import ChartSeries, Report
from gms_flex_control.tuning.tracking import link_error
import numpy as np

BELIEFS = {'believed': WITHOUT, 'found': WITH, 'true': 'true model'}
COLUMNS = (WITHOUT, WITH, 'noise floor, or true model')
_COLOURS = dict(zip(BELIEFS, (COLOURS[1], COLOURS[0], '0.35'), strict=True))
_ROLES = dict(zip(BELIEFS, ('c1', 'c0', 'reference'), strict=True))


class DemoOutcome(NamedTuple):
    """What the demonstration did and found."""

    hidden: Any          # HiddenEffect
    seed: int            # it was drawn from
    result: Discrepancy  # of the first recording
    recordings: dict     # of one motion, one for each of BELIEFS of the controller

    @property
    def first(self) -> Finding | None:
        """Return the Finding that matters most, small ones coming last; None if there is none."""
        return next(iter(self.result.named), None)

    @property
    def named(self) -> bool:
        """Return whether that one has the name and joint of what was hidden."""
        effect = self.hidden.effect
        return self.first is not None and (self.first.effect, self.first.joint) == (
            effect.name, effect.joint)

    @property
    def shrank(self) -> bool:
        """Return whether residual torque and free-run error became less on data held out."""
        gap = self.result.gap
        return gap is not None and all(
            np.sum(after ** 2) < np.sum(before ** 2) for before, after in (
                (gap.retuned, gap.after), (gap.free_before, gap.free_after)))

    @property
    def tracking(self) -> dict[str, np.ndarray]:
        """Return the rms tracking error by belief, dict of str to ndarray (n,) [rad]."""
        return {belief: link_rms(recording) for belief, recording in self.recordings.items()}


def _outcome_values(outcome):
    joints, effect = outcome.hidden.robot.joints, outcome.hidden.effect
    return plain({
        'version': __version__, 'seed': outcome.seed, 'name_right': outcome.named,
        'gap_shrank': outcome.shrank,
        'tracking': {belief: dict(zip(joints, rms, strict=True))
                     for belief, rms in outcome.tracking.items()},
        'discrepancy': discrepancy_values.report_values(outcome.result),
        'hidden': discrepancy_values.described(effect) | {
            'compensated': compensated(effect.name)}})


def _outcome_rows(outcome):
    """Return header and rows of the table: what is measured, of which joint, before and after."""
    gap, rows = outcome.result.gap, []
    if gap is not None:
        kinds = [('residual torque in motion [mN m]', gap.retuned, gap.after, gap.floor),
                 ('free-run error, 0.5 s [mrad]', gap.free_before, gap.free_after, gap.free_floor)]
        if gap.closed_loop is not None:
            again = gap.closed_loop
            kinds.append(('closed loop again [mrad]', again.retuned, again.after, again.floor))
        rows += _rows(kinds, gap.joints)
    tracking = outcome.tracking
    rows += _rows([('tracking error [mrad]', *(tracking[belief] for belief in BELIEFS))],
                  outcome.hidden.robot.joints)
    return ('rms', 'joint', *COLUMNS), rows


def _rows(kinds, joints):
    return [(kind, joint, *(f'{1e3 * figure[j]:.3g}' for figure in figures))
            for kind, *figures in kinds for j, joint in enumerate(joints)]


def revealed(outcome) -> str:
    """Return in words what was hidden, and whether it was found."""
    truth = discrepancy_values.described(outcome.hidden.effect)
    values = ', '.join(f'{name} {value:.4g}' for name, value in truth['parameters'].items())
    sentence = f'Hidden was {truth["effect"]} of {truth["joint"]} ({values}): '
    if outcome.named:
        sentence += 'named rightly'
    elif outcome.first is not None:
        sentence += f'named wrongly, {outcome.first.effect} of {outcome.first.joint}'
        if (truth['effect'], truth['joint']) in outcome.first.indistinguishable_from:
            sentence += ' (said to be indistinguishable from it)'
    else:
        sentence += 'not named'
    sentence += ', and the gap shrank.' if outcome.shrank else ', and the gap did not shrink.'
    if not compensated(truth['effect']):
        sentence += ' No controller can compensate it: tracking stays as it is.'
    return sentence


def outcome_text(outcome) -> str:
    """Return the summary for a terminal."""
    return align(*_outcome_rows(outcome))


def demo_answer(outcome) -> Answer:
    """Return whether what was hidden was found, and what that changes (Answer)."""
    tracking, gap = outcome.tracking, outcome.result.gap
    joints = outcome.hidden.robot.joints
    worst = _worst(outcome)
    numbers = [] if gap is None else [kind[0] for kind in gap_numbers(gap)]
    numbers.append(measured(f'tracking error of {joints[worst]} [mrad]', *(
        tracking[belief][worst] for belief in BELIEFS)))
    bags = (outcome.recordings[belief].source for belief in ('believed', 'found'))
    return Answer(f'{revealed(outcome)} The noise floor is what encoders and torque noise alone '
                  'would leave.', COLUMNS, tuple(numbers), command('view', *bags))


def _worst(outcome):
    """Return the index of the link that what was found helps most."""
    tracking = outcome.tracking
    return int(np.argmax(tracking['believed'] - tracking['found']))


def write_demo_report(outcome, folder) -> None:
    """Write report.html, report.json and the PNGs of a DemoOutcome to a folder."""
    folder = Path(folder)
    report = Report('What does the model lack? A demonstration', demo_answer(outcome),
                    'Three ROS 2 nodes in lockstep; the plant has an effect that the tool, given '
                    'a bag and the believed robot file, does not know')
    save_figure(_tracking_figure(outcome), folder / 'tracking.png')
    worst = _worst(outcome)
    _add_error(report, outcome, worst)
    report.heading('Without and with the effects')
    report.text('A controller that believed the robot file, every parameter 1 to 3 % off, drove '
                'the arm through a motion: without effects. What the workflow found in the bag '
                'was added to the model where it helps; the controller then drove the same '
                'motion with that model, and once more with the true one. The upper rows are '
                'measured on blocks of the bag that no fit has seen.')
    report.table(*_outcome_rows(outcome))
    for j in range(len(outcome.hidden.robot.joints)):
        if j != worst:
            _add_error(report, outcome, j)
    add_discrepancy(report, outcome.result, folder, opened=True)
    _add_truth(report, outcome)
    write_json(folder / 'report.json', _outcome_values(outcome))
    report.write(folder / 'report.html')


def _tracking_figure(outcome):
    joints = outcome.hidden.robot.joints
    figure, panels = stacked_panels(len(joints))
    rms = outcome.tracking
    for j, (panel, joint) in enumerate(zip(panels, joints, strict=True)):
        panel.axhline(0.0, color='0.6', linewidth=0.6)
        for belief, recording in outcome.recordings.items():
            keep = thinned(len(recording.time))
            panel.plot(recording.time[keep], 1e3 * link_error(recording)[keep, j],
                       ':' if belief == 'true' else '-', color=_COLOURS[belief],
                       label=f'{BELIEFS[belief]}, rms {1e3 * rms[belief][j]:.3g}')
        panel.set_ylabel(f'{joint} [mrad]', parse_math=False)
        panel.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=3)
    return finished(figure, panels, 'Tracking error, by the model that the controller believes')


def _add_error(report, outcome, j):
    recordings = outcome.recordings
    report.chart(f'{outcome.hidden.robot.joints[j]}: tracking error, by what the controller '
                 'believes', recordings['believed'].time, [
                     ChartSeries(BELIEFS[belief], 1e3 * link_error(recording)[:, j],
                                 x=recording.time, role=_ROLES[belief])
                     for belief, recording in recordings.items()],
                 y_label='angle [mrad]')


def _add_truth(report, outcome):
    report.heading('What was hidden')
    truth = discrepancy_values.described(outcome.hidden.effect)['parameters']
    found = {value.name: value for value in outcome.first.values} if outcome.named else {}
    report.table(
        ('parameter', 'hidden', 'found', '95 % interval'),
        [(name, f'{value:.4g}', *(
            (f'{found[name].value:.4g}', f'{found[name].low:.4g} .. {found[name].high:.4g}')
            if name in found else ('-', '-'))) for name, value in truth.items()],
        'Parameters such as load and duration only set the unit of another')
