# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Phases told from the data alone agree with those that the experiment wrote down."""

from bench.paper_method.experiments import label
import numpy as np
from paper_experiment import experiment
import pytest
from scipy.ndimage import maximum_filter1d, minimum_filter1d

SEED = 5
MARGIN = 0.25  # from the edges of a phase, where either name is right [s]


@pytest.fixture(scope='module', params=['joint1', 'joint2'])
def named(request, robot, gains):
    """Return known names where the experiment leaves no doubt, else '', and those found."""
    j = robot.joints.index(request.param)
    recording, _, stretches, half = experiment(robot, gains, request.param, SEED, ideal=False)
    known, found = [], []
    for stretch in stretches:
        if stretch.tested[:, j].any():
            known.append(known_names(recording, stretch, j))
            found.append(label(stretch, robot.arm, j, recording.period, half[j]))
    return np.concatenate(known), np.concatenate(found)


def known_names(recording, stretch, j):
    """Name samples by plan and commanded torque, the link's measured motion not looked at."""
    period, size = recording.period, len(stretch.phase)
    first = int(np.searchsorted(recording.time, stretch.begin - 1e-9))
    rows = slice(first, first + size)
    rate, rate_of_rate = recording.reference[rows, 1, j], recording.reference[rows, 2, j]
    half = round(MARGIN / period)
    command = recording.command[rows, j]
    change = np.abs(np.roll(command, -half) - np.roll(command, half))
    ramped = maximum_filter1d(change, 2 * half + 1) > 6e-3
    names = np.full(size, '', dtype='U20')
    for name, mask in (
            ('constant_velocity', (stretch.phase == 'constant_velocity') & (rate != 0.0)
             & (np.abs(rate_of_rate) < 1e-9)),
            ('sliding', (stretch.phase == 'sliding') & (np.abs(rate) > 0.0)),
            ('presliding', (stretch.phase == 'presliding') & np.isnan(rate) & ramped)):
        names[minimum_filter1d(mask.astype(int), 2 * half + 1) > 0] = name
    return names


def test_phases_found_agree_with_those_known(named):
    """96 % of all samples where the plan leaves no doubt, and 90 % of each phase."""
    known, found = named
    told = known != ''
    shares = {name: np.mean(found[known == name] == name) for name in np.unique(known[told])}
    assert set(shares) == {'constant_velocity', 'presliding', 'sliding'}
    assert np.mean((found == known)[told]) > 0.96, shares
    assert min(shares.values()) > 0.9, shares
