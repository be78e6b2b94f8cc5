# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""One hidden effect is named first, with its values; the bench of hidden robots asks for all."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from gms_flex_control.discrepancy.result import COMPLETE, FOUND
from gms_flex_control.discrepancy.workflow import find_discrepancy, Options
import numpy as np
import pytest


def test_a_hidden_effect_is_named_first_with_its_values():
    """Values within 5 %, directions within 0.1 rad; free runs end no farther off."""
    case = make_case('single', 26, duration=12.0, effect='gravity_tilt')
    result = find_discrepancy([case.recording], case.nominal, Options(most=2))
    first, hidden = result.findings[0], case.truth.effects[0]
    assert result.verdict == FOUND, result.words
    assert (first.effect, first.joint) == ('gravity_tilt', hidden.joint)
    for value, true in zip(first.values, hidden.values, strict=True):
        turned = value.name == 'direction'
        assert value.value == pytest.approx(true, abs=0.1 if turned else 0.05 * abs(true))
    errors = [np.sum(rms ** 2) for rms in (result.gap.free_before, result.gap.free_after)]
    assert errors[1] < 1.04 * errors[0]


def test_a_clean_robot_whose_links_are_not_seen_is_complete():
    case = make_case('clean', 3, duration=10.0)
    unknown = np.full_like(case.recording.q_link, np.nan)
    blind = replace(case.recording, q_link=unknown, dq_link=unknown)
    result = find_discrepancy([blind], case.nominal, Options(most=1))
    assert result.verdict == COMPLETE, result.words
