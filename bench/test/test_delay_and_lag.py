# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Two effects that resemble each other below 20 Hz."""

from bench.hidden_robots.cases import make_case
from gms_flex_control.discrepancy.workflow import find_discrepancy, Options
import pytest


@pytest.mark.parametrize(('seed', 'effect'), [(86, 'input_delay'), (85, 'actuator_lag')])
def test_a_delay_and_a_lag_are_told_apart_in_a_closed_loop(seed, effect):
    """By residuals below 20 Hz, the delay of the first would be a lag of the same time."""
    case = make_case('single', seed, duration=25.0)
    hidden, = case.truth.effects
    assert hidden.name == effect and hidden.values[0] < 8e-3
    result = find_discrepancy([case.recording], case.nominal, Options(most=2))
    first = result.findings[0]
    assert (first.effect, first.joint) == (effect, hidden.joint)
    assert next(iter(first.parameters.values())) == pytest.approx(hidden.values[0], rel=0.05)
