# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Nothing is learned from a robot that lacks nothing; test_effects_learned hides a bump."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from gms_flex_control.discrepancy.learning import learn
from gms_flex_control.discrepancy.result import UNEXPLAINED
from gms_flex_control.discrepancy.workflow import find_discrepancy, Options
from gms_flex_control.reports.answers import discrepancy_answer


def test_a_term_for_parameters_believed_a_little_wrong_is_none():
    """As believed, a spring 3 % off lacks a torque over torsion; re-tuned, the robot does not."""
    case = make_case('clean', 206, duration=20.0)
    found = find_discrepancy([case.recording], case.nominal, holdout=[case.held_out])
    result = learn(replace(found, verdict=UNEXPLAINED), holdout=[case.held_out])
    assert result.learned == () and result.robot is found.robot


def test_a_clean_robot_gets_no_term_even_if_asked_for():
    case = make_case('clean', 1, duration=12.0)
    found = find_discrepancy([case.recording], case.nominal, Options(most=1))
    assert learn(found) is found
    asked = replace(found, verdict=UNEXPLAINED)  # as where a finding could not be added
    assert '--learn' in discrepancy_answer(asked, 'gap').command
    result = learn(asked)
    assert result.learned == () and result.robot is found.robot
    assert 'No learned term predicts' in result.words
