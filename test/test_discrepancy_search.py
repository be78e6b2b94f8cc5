# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The search exchanges an effect that was found for one that explains more."""

from dataclasses import replace

from core_runs import affected
from discrepancy_runs import driven_motion
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.search import search
from gms_flex_control.effects.registry import names


def test_an_effect_is_exchanged_where_a_belief_is_far_off_as_well(robot, gains):
    """
    An offset of a spring is found in the place of an eccentricity, beside motors 15 % heavier.

    What the eccentricity explains is all that is left without it, the motors as heavy as before:
    not also what lighter motors would leave.
    """
    hidden = affected(robot, 'joint2', 'spring_offset', 0.02)
    hidden = replace(hidden, arm=replace(
        hidden.arm, motor_inertia=1.15 * hidden.arm.motor_inertia))
    likelihood = Likelihood([driven_motion(hidden, gains, seed=1, duration=8.0)], robot)

    def searched(begin, *among):
        return search(likelihood, 1, tuple(name for name in names() if name not in among), begin,
                      False, lambda text: None)

    wrong = searched(None, 'link_encoder_eccentricity')
    assert [one.key for one in wrong.best.model.robot.effects] == [
        ('link_encoder_eccentricity', 'joint2')]
    found = searched(wrong, 'link_encoder_eccentricity', 'spring_offset').best
    assert [one.key for one in found.model.robot.effects] == [('spring_offset', 'joint2')]
    assert found.evidence > wrong.best.evidence
