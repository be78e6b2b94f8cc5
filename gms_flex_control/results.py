# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The interface for Python: what is asked of recordings and robots, and results that show themselves.

Every result has ``summary()``, ``to_dict()``, ``to_dataframe()``, ``plot()`` and, in notebooks, a
representation of its own; docs/python.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
import html
from typing import Any, TYPE_CHECKING

from gms_flex_control.batches import run_batch
from gms_flex_control.data.recording import Phase, Recording
from gms_flex_control.discrepancy import workflow
from gms_flex_control.discrepancy.result import Discrepancy
from gms_flex_control.errors import ConfigError
from gms_flex_control.identification import identify as identification
from gms_flex_control.identification.outcome import Identification
from gms_flex_control.identification.output import report_json
from gms_flex_control.params.arm import in_units
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.reports import comparison_page, pictures, tuning_page
from gms_flex_control.reports.answers import identification_text
from gms_flex_control.reports.discrepancy_values import report_values
from gms_flex_control.reports.figure_style import stacked_panels, svg
from gms_flex_control.reports.recordings_page import error_figure
from gms_flex_control.tuning import study
from gms_flex_control.tuning.linear_loop import Timing
from gms_flex_control.tuning.propose import Demands, Proposal, propose
from gms_flex_control.tuning.study import Trial, try_motions
from gms_flex_control.tuning.tracking import Table4, table4, TrackingRun
from matplotlib.figure import Figure
import numpy as np

if TYPE_CHECKING:
    import pandas

Recorded = Recording | tuple[Recording, Sequence[Phase]]
_MOST_AT_LIMIT = 0.02  # share of a motion that may be spent at the torque limit


class Result:
    """Text, plain values, table, picture and HTML of what was found."""

    def summary(self) -> str:
        """Return the result as text for a terminal."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON, in SI units."""
        raise NotImplementedError

    def plot(self) -> Figure:
        """Return the result as a figure of matplotlib."""
        raise NotImplementedError

    def _rows(self) -> list[dict[str, Any]]:
        """Return what `to_dataframe` holds, a dict per row."""
        raise NotImplementedError

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the numbers as a table of pandas; ConfigError where that is not installed."""
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise ConfigError('to_dataframe needs pandas: '
                              "pip install '.[pandas]' in the clone, or use to_dict") from error
        return DataFrame(self._rows())

    def _repr_html_(self) -> str:
        return f'<pre>{html.escape(self.summary())}</pre>{svg(self.plot())}'


class IdentificationResult(Result, Identification):
    """An Identification, see `identify`."""

    def summary(self) -> str:
        """Return parameters with intervals, and errors on held-out data."""
        return self.in_units(identification_text(self))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``gms_flex identify`` writes as report.json."""
        return report_json(self)

    def plot(self) -> Figure:
        """Return friction over velocity of the first joint; `plot_joint` has the others."""
        return self.plot_joint(self.joints[0].joint)

    def plot_joint(self, joint: str) -> Figure:
        """Return friction over velocity of a joint, measured and fitted (Fig. 3)."""
        return pictures.map_figure(next(one for one in self.joints if one.joint == joint))

    def _rows(self) -> list[dict[str, Any]]:
        return [{'joint': result.joint, 'parameter': one.name, 'unit': one.unit,
                 'value': one.value, 'low': one.interval.low, 'high': one.interval.high,
                 'flags': ', '.join(one.flags)}
                for result in self.joints_and_others for one in result.estimates]


class DiscrepancyResult(Result, Discrepancy):
    """A Discrepancy, see `find_discrepancy`."""

    def summary(self) -> str:
        """Return the verdict and what was found, one paragraph."""
        return self.words

    def to_dict(self) -> dict[str, Any]:
        """Return what ``gms_flex discrepancy`` writes as report.json."""
        return report_values(self)

    def plot(self) -> Figure:
        """Return the gap on held-out data: before, re-tuned, with what was found, floor."""
        if self.gap is None:
            raise ConfigError(f'there is no gap to be drawn: {self.words}')
        return pictures.gap_figure(self.gap)

    def _repr_html_(self) -> str:
        return super()._repr_html_() if self.gap is not None else html.escape(self.words)

    def _rows(self) -> list[dict[str, Any]]:
        return [{'effect': one.effect, 'joint': one.joint, 'matters': one.main,
                 'parameter': value.name, 'unit': value.unit, 'value': value.value,
                 'low': value.low, 'high': value.high, 'probability': one.probability}
                for one in self.named for value in one.values]


@dataclass(frozen=True, eq=False)
class TrackingResult(Result):
    """Tracking errors with and without compensation, see `analyse`."""

    runs: tuple[TrackingRun, ...]
    table: Table4

    def summary(self) -> str:
        """Return the paper's Table 4 and the figures of every run."""
        return self.table.text()

    def to_dict(self) -> dict[str, Any]:
        """Return what ``gms_flex analyse`` writes as table4.json."""
        return self.table.as_dict()

    def plot(self) -> Figure:
        """Return the errors over time of the first trajectory, a panel per joint (Fig. 10)."""
        return error_figure(self.runs, self.runs[0].trajectory)

    def _rows(self) -> list[dict[str, Any]]:
        return [{'trajectory': run.trajectory, 'compensation': run.compensation}
                | joint._asdict() for run in self.table.runs for joint in run.joints]


@dataclass(frozen=True, eq=False)
class TuningResult(Result):
    """Gains proposed for a robot, see `tune`."""

    robot: RobotParams
    demands: Demands
    proposal: Proposal
    trials: dict[str, dict[str, Trial]]  # by compensation and motion; {} of an unstable loop

    @property
    def gains(self) -> ControllerParams:
        """Return the gains; the nearest found where ``unmet`` says that none meet the demands."""
        return self.proposal.gains

    @property
    def unmet(self) -> tuple[str, ...]:
        """Return a sentence for each demand that is not met."""
        return self.proposal.unmet

    def summary(self) -> str:
        """Return gains, margins, conditions and expected errors."""
        judgement, timing = self.proposal.judgement, self.demands.timing
        unmet = [f'NOT MET: {sentence}' for sentence in self.unmet]
        if not self.trials:
            return '\n'.join([tuning_page.gains_table(self.gains, self.robot), '', *unmet])
        return in_units(self.robot.arm, '\n'.join([
            tuning_page.gains_table(self.gains, self.robot),
            '\nMargins of the sampled loop, worst of all poses',
            tuning_page.margins_table(judgement, self.robot),
            *tuning_page.loop_lines(judgement, timing),
            f'\n{tuning_page.conditions_text(judgement.conditions)}',
            f'\nSimulated, exact model\n{tuning_page.trials_table(self.trials, self.robot)}',
            *tuning_page.expected_lines(self.trials, judgement, self.robot),
            *unmet]))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``gms_flex tune`` writes as tuning.json."""
        return tuning_page.as_values(self.proposal, self.robot, self.demands.timing, self.trials)

    def plot(self) -> Figure:
        """Return the open loops of all joints over frequency."""
        return tuning_page.tuning_figure(self.robot, self.gains, self.demands.timing)

    def _rows(self) -> list[dict[str, Any]]:
        names = [one.name for one in fields(self.gains) if one.name != 'compensation']
        return [{'joint': joint} | {name: float(getattr(self.gains, name)[j]) for name in names}
                for j, joint in enumerate(self.robot.joints)]


@dataclass(frozen=True, eq=False)
class ComparisonResult(Result):
    """Friction compensations side by side, see `compare`."""

    setting: study.Setting
    outcomes: dict[str, Any]    # a Trial by motion for each of study.cells
    rows: list[study.Row]       # one for each compensation

    def summary(self) -> str:
        """Return the table of ``gms_flex compare``."""
        return in_units(self.setting.robot.arm, comparison_page.plant_text(self.rows))

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of ``gms_flex compare``."""
        one = self.setting
        return {'rate': one.rate, 'amplitude': float(one.amplitude[0]), 'draws': one.draws,
                'seed': one.seed, 'rows': [row._asdict() for row in self.rows]}

    def plot(self) -> Figure:
        """Return the errors as bars, a panel for each group of conditions."""
        titles = list(self.rows[0].errors)
        figure, panels = stacked_panels(len(titles))
        for panel, title in zip(panels, titles, strict=True):
            panel.bar([row.mode for row in self.rows],
                      [row.errors[title] or 0.0 for row in self.rows])
            panel.set_ylabel(f'{title} [rad]')
            panel.tick_params(axis='x', labelrotation=30)
        return figure

    def _rows(self) -> list[dict[str, Any]]:
        return [{'compensation': row.mode} | {
            f'{title} [rad]': value for title, value in row.errors.items()} for row in self.rows]


def identify(recordings: Sequence[Recorded], robot: RobotParams | None = None, *,
             holdouts: Sequence[Recorded] = (),
             options: identification.IdentifyOptions | None = None,
             say: Callable[[str], object] | None = None) -> IdentificationResult:
    """
    Return the friction of a robot from recordings, with what its experiment did where known.

    ``robot`` is relied on but for its friction; without it each joint is a rigid axis of which
    nothing is known, and those that stand still are left out. ``holdouts`` are only predicted; by
    default blocks of time are. ``say`` gets a line of progress now and then. IdentificationError
    if the data cannot determine the friction.
    """
    return IdentificationResult(**_fields(identification.identify(
        recordings, robot, holdouts=holdouts, options=options, say=say)))


def find_discrepancy(recordings: Sequence[Recording], robot: RobotParams,
                     options: workflow.SearchOptions | None = None, *,
                     holdout: Sequence[Recording] = (),
                     say: Callable[[str], object] = lambda text: None) -> DiscrepancyResult:
    """
    Return the physical effects that ``robot`` lacks to explain its recordings.

    The gap is measured on ``holdout``, by default on blocks of time left out in turn. BagError if
    a recording lacks what the equations need.
    """
    return DiscrepancyResult(**_fields(workflow.find_discrepancy(
        recordings, robot, options, holdout=holdout, say=say)))


def analyse(recordings: Mapping[tuple[str, str], Recording]) -> TrackingResult:
    """Return tracking errors of recordings by (trajectory, compensation), such as 'none'."""
    runs = tuple(TrackingRun(*label, one) for label, one in recordings.items())
    return TrackingResult(runs, table4(runs))


def tune(robot: RobotParams, gains: ControllerParams, *, rate: float = 500.0, delay: float = 0.0,
         amplitude: float = 1.0, demands: Demands | None = None) -> TuningResult:
    """
    Return the stiffest gains that keep the demands, judged and tried in simulation.

    Compensation, observer and torque limits are those of ``gains``; the controller runs at
    ``rate`` [Hz], ``delay`` [s] passes from measurement to torque. ``demands``, which have their
    own timing, replace the usual ones. ``amplitude`` of the simulated motions [rad].
    """
    if demands is None:
        timing = Timing(1.0 / rate, delay)
        demands = Demands(timing=timing, torque_limit=gains.torque_limit, delay=timing.period)
    proposal = propose(robot, gains, demands)
    trials: dict[str, dict[str, Trial]] = {}
    unmet = list(proposal.unmet)
    modes = ('none', gains.compensation) if proposal.judgement.stable else ()
    for mode in dict.fromkeys(modes):
        trials[mode] = {}
        for motion, trial, run in try_motions(
                robot, robot, replace(proposal.gains, compensation=mode), demands.timing,
                np.full(robot.n_joints, amplitude)):
            trials[mode][motion] = trial
            where = f'{motion}, compensation {mode}'
            if trial.lost:
                unmet.append(f'{where}: the simulated robot was lost')
                continue
            share = np.mean(np.abs(run.command) >= demands.torque_limit, axis=0)
            unmet += [f'{joint}: at the torque limit for {100 * share[j]:.0f} % of the {where}; '
                      'give a smaller --amplitude or a larger --torque-limit'
                      for j, joint in enumerate(robot.joints) if share[j] > _MOST_AT_LIMIT]
    return TuningResult(robot, demands, proposal._replace(unmet=tuple(dict.fromkeys(unmet))),
                        trials)


def compare(robot: RobotParams, gains: ControllerParams, *, draws: int = 0, rate: float = 500.0,
            amplitude: float = 1.0, seed: int = 0,
            workers: int | None = None) -> ComparisonResult:
    """
    Return eight friction compensations side by side, in simulation.

    Each drives the robot at ``rate`` [Hz] through motions of ``amplitude`` [rad], also with
    ``draws`` robots that differ from the belief; in this process, or in so many ``workers``.
    """
    setting = study.Setting(robot, gains, np.full(robot.n_joints, amplitude), rate, draws, seed)
    cells = study.cells(setting)
    outcomes = ({key: study.try_cell(cell) for key, cell in cells.items()} if workers is None
                else run_batch(study.try_cell, cells, workers, 'cells'))
    return ComparisonResult(setting, outcomes, study.table(outcomes, setting))


def _fields(found: Any) -> dict[str, Any]:
    return {one.name: getattr(found, one.name) for one in fields(found)}
