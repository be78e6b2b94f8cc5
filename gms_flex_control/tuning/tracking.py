# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The paper's Table 4 from recordings: mean square tracking error with and without compensation.

The absolute values of the paper cannot be reproduced: it prints neither the inertias M and J,
nor the stiffness K, nor the trajectories. What can be compared is the ratio
MSE without / MSE with compensation on the same robot and trajectory.
"""

from dataclasses import dataclass
import math
from typing import NamedTuple

from gms_flex_control.answer import align, Answer, command, measured
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import quantum, runs
from gms_flex_control.file_io import plain
import numpy as np

HOLD_SETTLING = 1.0   # a reference constant this long counts as holding still [s]
HOLD_WINDOW = 5.0     # and the last this much of it is judged [s]
HOLD_TOLERANCE = 1e-9  # a reference that moves less than this is constant [rad]
# Table 4 as printed [rad^2], link 1 and link 2
PAPER_WITHOUT = {'sinusoid': (0.0048029, 0.0083391), 'polynomial': (0.0010912, 0.0019605)}
PAPER_WITH = {'sinusoid': (0.0007866, 0.0009879), 'polynomial': (0.0000352, 0.0002063)}
WITHOUT = 'none'

NOTE = ('The paper prints neither M, J, K nor its trajectories, so absolute errors are not '
        'comparable with it; the ratio without / with compensation is.')
MOST_UNANSWERED = 0.1  # share of samples without a command, above which gains are not judged


class TrackingRun(NamedTuple):
    """One experiment: what was asked of the robot, how friction was treated, what came."""

    trajectory: str    # 'sinusoid', 'polynomial' or any other name
    compensation: str  # 'none', 'gms_paper', 'gms' or any other name
    recording: Recording


class JointTracking(NamedTuple):
    """How one joint followed its reference; NaN where the recording does not show it."""

    joint: str
    mse: float          # mean of (q_link - reference)^2 [rad^2]
    rms: float          # [rad]
    floor: float        # rms error that the encoder's steps alone make of a reading [rad]
    max_error: float    # largest absolute error [rad]
    hold_peak_to_peak: float  # largest of all holds [rad]
    rms_torque: float   # of the torque applied, or commanded if that is not known [N m]
    samples: int        # samples with both a measurement and a reference


class RunTracking(NamedTuple):
    """The figures of one run, one entry per joint."""

    trajectory: str
    compensation: str
    source: str
    duration: float  # [s]
    joints: tuple
    unanswered: float  # share of the samples without a command; NaN where none was recorded


@dataclass(frozen=True, eq=False)
class Table4:
    """Mean square tracking errors per trajectory, compensation and link of RunTrackings."""

    runs: tuple

    @property
    def trajectories(self) -> tuple:
        """Return the trajectory names, the paper's two first."""
        return _ordered((run.trajectory for run in self.runs), tuple(PAPER_WITHOUT))

    @property
    def compensations(self) -> tuple:
        """Return the compensation names, none first."""
        return _ordered((run.compensation for run in self.runs), (WITHOUT, 'gms_paper', 'gms'))

    def joints(self, trajectory) -> tuple:
        """Return the joint names of all runs of ``trajectory``, in order of appearance."""
        return tuple(dict.fromkeys(
            joint.joint for run in self.runs if run.trajectory == trajectory
            for joint in run.joints))

    @property
    def places(self) -> list:
        """Return each (trajectory, joint), in the order of the tables."""
        return [(trajectory, joint) for trajectory in self.trajectories
                for joint in self.joints(trajectory)]

    @property
    def best(self) -> str:
        """Return the compensation with the least error of all links; none if it is alone."""
        modes = [mode for mode in self.compensations if mode != WITHOUT] or [WITHOUT]
        errors = {mode: [entry.mse for run in self.runs if run.compensation == mode
                         for entry in run.joints if math.isfinite(entry.mse)] for mode in modes}
        return min(modes, key=lambda mode: np.mean(errors[mode] or [np.inf]))

    @property
    def hardest(self) -> list:
        """Return (trajectory, joint) of all errors with the best one, the largest first."""
        best = self.best
        found = {(trajectory, joint): self.mse(trajectory, best, joint)
                 for trajectory, joint in self.places}
        return sorted((place for place, mse in found.items() if math.isfinite(mse)),
                      key=lambda place: -found[place])

    def answer(self) -> Answer:
        """Return how much closer the links follow with the best compensation (Answer)."""
        best, places = self.best, self.hardest
        if not places:
            return Answer('The recordings hold no reference, so no tracking error can be '
                          'computed.',
                          (), (), command('info', self.runs[0].source))
        rows = [(name, label, *place) for name, label in (
            ('rms', 'rms error'), ('max_error', 'largest error')) for place in places]
        numbers = [measured(f'{label} of {joint}, {trajectory} [mrad]', *(
            self.figure(*figure, joint) for figure in (
                (name, trajectory, WITHOUT), (name, trajectory, best),
                ('floor', trajectory, best)))) for name, label, trajectory, joint in rows[:3]]
        sources = dict.fromkeys(run.source for run in self.runs
                                if run.trajectory == places[0][0]
                                and run.compensation in (WITHOUT, best))
        with_it = 'Without compensation' if best == WITHOUT else f'With compensation {best}'
        without = 1e3 * np.fmax.reduce([
            self.figure('rms', trajectory, WITHOUT, joint) for trajectory, joint in places])
        beside = (f', without it within {without:.3g} mrad'
                  if best != WITHOUT and math.isfinite(without) else '')
        return Answer(f'{with_it} the links follow within {numbers[0].after} mrad (rms){beside}; '
                      'the noise floor is what the steps of the encoder alone make of a reading.',
                      ('without', best, 'noise floor'), tuple(numbers),
                      command('view', *sources))

    def figure(self, name, trajectory, compensation, joint) -> float:
        """Return a figure of `JointTracking`, averaged over repeats; NaN if there is no run."""
        values = [getattr(entry, name) for run in self.runs
                  if (run.trajectory, run.compensation) == (trajectory, compensation)
                  for entry in run.joints if entry.joint == joint]
        return float(np.mean(values)) if values else math.nan

    def mse(self, trajectory, compensation, joint) -> float:
        """Return the MSE [rad^2], averaged over repeats; NaN if there is no such run."""
        return self.figure('mse', trajectory, compensation, joint)

    def ratio(self, trajectory, compensation, joint) -> float:
        """Return MSE without compensation / MSE with ``compensation``; NaN if one lacks."""
        with_it = self.mse(trajectory, compensation, joint)
        if compensation == WITHOUT:
            return math.nan
        without = self.mse(trajectory, WITHOUT, joint)
        return without / with_it if with_it > 0 else math.nan

    def paper(self, trajectory, joint) -> tuple | None:
        """Return MSE without and with [rad^2] and their ratio as printed; None for others."""
        joints = self.joints(trajectory)
        if trajectory not in PAPER_WITHOUT or len(joints) != 2:
            return None
        i = joints.index(joint)
        without, with_it = PAPER_WITHOUT[trajectory][i], PAPER_WITH[trajectory][i]
        return without, with_it, without / with_it

    def rows(self) -> tuple:
        """Return the header and the rows, lists of str, of the comparison with the paper."""
        modes = [mode for mode in self.compensations if mode != WITHOUT]
        header = ['trajectory', 'joint', WITHOUT]
        for mode in modes:
            header += [mode, 'ratio']
        header += ['paper without', 'paper with', 'ratio']
        return header, [self._row(*place, modes) for place in self.places]

    def _row(self, trajectory, joint, modes):
        row = [trajectory, joint, _small(self.mse(trajectory, WITHOUT, joint))]
        for mode in modes:
            row += [_small(self.mse(trajectory, mode, joint)),
                    _plain(self.ratio(trajectory, mode, joint))]
        paper = self.paper(trajectory, joint) or (math.nan,) * 3
        return row + [_small(paper[0]), _small(paper[1]), _plain(paper[2])]

    def detail_rows(self) -> tuple:
        """Return the header and the rows, lists of str, of every run's own figures."""
        header = ['trajectory', 'compensation', 'joint', 'rms error [mrad]',
                  'max error [mrad]', 'hold p-p [mrad]', 'rms torque [N m]',
                  'duration [s]', 'samples']
        rows = []
        for run in self.runs:
            for joint in run.joints:
                rows.append([run.trajectory, run.compensation, joint.joint,
                             _plain(1e3 * joint.rms), _plain(1e3 * joint.max_error),
                             _plain(1e3 * joint.hold_peak_to_peak), _plain(joint.rms_torque),
                             _plain(run.duration), str(joint.samples)])
        return header, rows

    def findings(self) -> list[str]:
        """Return sentences on means, and on runs whose errors are not those of their gains."""
        labels = [(run.trajectory, run.compensation) for run in self.runs]
        return [*(f'{", ".join(label)}: mean of {labels.count(label)} bags'
                  for label in dict.fromkeys(labels) if labels.count(label) > 1), *(
            f'{run.trajectory}, {run.compensation}: {100.0 * run.unanswered:.0f} % of the '
            'samples had no command; the loop did not keep up, and errors are not what the '
            'gains would give' for run in self.runs if run.unanswered > MOST_UNANSWERED)]

    def text(self) -> str:
        """Return both tables as text for a terminal, and what speaks against them."""
        return '\n'.join([
            'Table 4: mean square error, link angle - reference [rad^2], and ratio '
            'without / with', '', align(*self.rows()), '', NOTE, '',
            align(*self.detail_rows()), *(f'NOTE: {finding}' for finding in self.findings())])

    def as_dict(self) -> dict:
        """Return everything as JSON can hold it; what is not known is None."""
        modes, names, rows = self.compensations, ('without', 'with', 'ratio'), []
        for trajectory, joint in self.places:
            paper = self.paper(trajectory, joint)
            rows.append({
                'trajectory': trajectory, 'joint': joint,
                'mse': {m: self.mse(trajectory, m, joint) for m in modes},
                'ratio': {m: self.ratio(trajectory, m, joint) for m in modes if m != WITHOUT},
                'paper': dict(zip(names, paper, strict=True)) if paper else None})
        return plain({
            'quantity': 'mean square of link angle - reference', 'unit': 'rad^2', 'note': NOTE,
            'findings': self.findings(), 'table': rows, 'runs': [run._asdict() | {
                'joints': [one._asdict() for one in run.joints]} for run in self.runs]})


def _ordered(names, first):
    """Return each of ``names`` once, those of ``first`` before the others by their names."""
    return tuple(sorted(dict.fromkeys(names), key=lambda name: (
        first.index(name) if name in first else len(first), name)))


def _small(value):
    return f'{value:.3e}' if math.isfinite(value) else '-'


def _plain(value):
    if not math.isfinite(value):
        return '-'
    return f'{value:.0f}' if abs(value) >= 999.5 else f'{value:#.3g}'.rstrip('.')


def link_error(recording) -> np.ndarray:
    """Return actual minus desired link angle (T, n) [rad]; NaN where there was no reference."""
    return recording.q_link - recording.reference[:, 0]


def track(run) -> RunTracking:
    """Return the RunTracking of a run; means are over samples, as in the paper, not over time."""
    recording = run.recording
    error = link_error(recording)
    return RunTracking(
        run.trajectory, run.compensation, recording.source,
        float(recording.time[-1] - recording.time[0]),
        tuple(_track_joint(recording, error[:, i], i) for i in range(recording.n_joints)),
        unanswered(recording))


def unanswered(recording) -> float:
    """Return which share of samples between the first and last command has none; NaN if all."""
    there = np.isfinite(recording.command).all(axis=1)
    rows = np.flatnonzero(there)
    return float(np.mean(~there[rows[0]:rows[-1] + 1])) if len(rows) else np.nan


def table4(runs) -> Table4:
    """Return the paper's Table4 of TrackingRuns, repeats averaged, missing ones as '-'."""
    return Table4(tuple(track(run) for run in runs))


def hold_windows(time, q_ref) -> list[slice]:
    """Return slices where a joint stands, settled `HOLD_SETTLING`, at most `HOLD_WINDOW`."""
    windows = []
    for first, last in runs(np.abs(np.diff(q_ref)) <= HOLD_TOLERANCE):
        begin = max(time[first] + HOLD_SETTLING, time[last] - HOLD_WINDOW)
        start = int(np.searchsorted(time, begin - 1e-9))
        if last > start:
            windows.append(slice(start, int(last) + 1))
    return windows


def _track_joint(recording, error, i):
    valid = error[np.isfinite(error)]
    mse = float(np.mean(valid ** 2)) if valid.size else np.nan
    return JointTracking(
        recording.joints[i], mse, float(np.sqrt(mse)),
        quantum(recording.q_link[:, i]) / np.sqrt(12.0),  # rounding is uniform within a step
        float(np.max(np.abs(valid))) if valid.size else np.nan,
        _worst_hold(recording, i), _rms_torque(recording, i), int(valid.size))


def _worst_hold(recording, i):
    """Return the largest peak to peak of all holds [rad], NaN without any."""
    peaks = [np.ptp(angle[np.isfinite(angle)])
             for angle in (recording.q_link[window, i] for window in hold_windows(
                 recording.time, recording.reference[:, 0, i])) if np.isfinite(angle).any()]
    return float(max(peaks, default=np.nan))


def _rms_torque(recording, i):
    for torque in (recording.tau_motor[:, i], recording.command[:, i]):
        known = torque[np.isfinite(torque)]
        if known.size:
            return float(np.sqrt(np.mean(known ** 2)))
    return np.nan
