# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Picture of a planned motion: where the predictions of the explanations part."""

from gms_flex_control.design.plan import NextRecording
from gms_flex_control.reports.figures import COLOURS, STYLES, WIDTH
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from scipy.signal import butter, sosfiltfilt

_CUTOFF = 8.0  # of what is drawn [Hz]


def next_figure(plan: NextRecording) -> Figure:
    """Return the reference, and torques of each explanation less those of the first."""
    runs, hypotheses = plan.best.runs, plan.beliefs.hypotheses
    joints = plan.beliefs.robot.joints
    figure = Figure(figsize=(WIDTH, 1.4 + 1.5 * len(joints)), layout='constrained')
    FigureCanvasAgg(figure)
    rate = 1.0 / np.median(np.diff(runs[0].time))
    low_pass = butter(2, _CUTOFF, fs=rate, output='sos')
    panels = figure.subplots(len(joints) + 1, 1, sharex=True)
    for j, joint in enumerate(joints):
        panels[0].plot(runs[0].time, runs[0].reference[:, 0, j], STYLES[j % len(STYLES)],
                       color=COLOURS[j % len(COLOURS)], linewidth=0.9, label=joint)
        for k, (run, one) in enumerate(zip(runs[1:], hypotheses[1:], strict=True)):
            panels[j + 1].plot(run.time, 1e3 * sosfiltfilt(
                low_pass, run.command[:, j] - runs[0].command[:, j]),
                               color=COLOURS[(k + 1) % len(COLOURS)], linewidth=0.8,
                               label=one.words)
        panels[j + 1].set_ylabel(f'{joint} [mN m]')
    panels[0].set_ylabel('reference [rad]')
    panels[1].set_title(f'predicted torque less that with {hypotheses[0].words}, '
                        f'below {_CUTOFF:g} Hz', fontsize=9)
    panels[-1].set_xlabel('time [s]')
    for panel in panels[:2]:
        panel.legend(frameon=False, fontsize=8)
    for panel in panels:
        panel.grid(color='0.9', linewidth=0.6)
        panel.tick_params(direction='in', labelsize=8)
        panel.set_xlim(0.0, float(np.max(runs[0].time)))
    return figure
