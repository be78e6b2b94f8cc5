# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The next recording: motions keep limits, and the planned one separates what another left."""

from dataclasses import replace

from gms_flex_control.design.motions import candidates, random_moves
from gms_flex_control.design.plan import plan_next, surviving
from gms_flex_control.design.separation import beliefs_of
from gms_flex_control.errors import ConfigError
from gms_flex_control.experiment.plan import Plan
from gms_flex_control.experiment.simulated import simulate
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.trajectory import builders
import numpy as np
import pytest

PERIOD = 0.002
JOINTS = ('joint1', 'joint2')
LIMITS = Limits(torque=[2.0, 2.0], torque_rate=[50.0, 50.0], velocity=[1.5, 2.0],
                velocity_margin=[0.5, 0.5], lower=[-1.2, -1.5], upper=[1.0, 1.5],
                position_margin=[0.1, 0.1], torsion=[0.9, 0.9])
BIAS = frozenset({('constant_link_torque', 'joint2')})
ASYMMETRY = frozenset({('friction_asymmetry', 'joint2')})


@pytest.mark.parametrize('pace', [1.0, 2.5])
def test_references_keep_range_and_velocity(pace):
    time = np.linspace(0.0, 40.0, 8001)
    for one in (*candidates(LIMITS, JOINTS, pace), random_moves(LIMITS, JOINTS, 3)):
        angle, velocity = np.moveaxis(one.trajectory(JOINTS).sample(time)[:, :2], 1, 0)
        assert (angle >= LIMITS.lower).all() and (angle <= LIMITS.upper).all(), one.name
        assert (np.abs(velocity) <= LIMITS.velocity).all(), one.name
        assert np.ptp(angle, axis=0).max() > 0.0, one.name


def test_indistinguishable_effects_of_a_finding_survive_beside_the_credible_models():
    backlash = {'effect': 'backlash', 'joint': 'joint1'}
    gain = {'effect': 'torque_gain', 'joint': 'joint2'}
    report = {'credible': [{'effects': [backlash, gain], 'probability': 0.97}], 'minor': [],
              'findings': [gain | {'confusable_with': ['stiffness_error', 'spring_cubic of joint1']
                                   }, backlash | {'confusable_with': []}]}
    kept = ('backlash', 'joint1')
    assert surviving(report) == [
        frozenset({kept, ('torque_gain', 'joint2')}),
        frozenset({kept, ('stiffness_error', 'joint2')}),
        frozenset({kept, ('spring_cubic', 'joint1')})]


def _recording(robot, model, gains, trajectory, duration):
    """Return the closed loop of a robot that the controller believes to be ``model``."""
    return simulate(Plan(robot=robot, model=model, gains=gains, trajectory=trajectory,
                         motion='test', duration=duration, period_ns=2_000_000, substeps=20,
                         seed=5, q_link=np.zeros(2)))


@pytest.fixture(scope='module')
def forward_only(robot, gains):
    """Return the robot with a link torque, and a recording of moves in one direction."""
    biased = replace(robot, effects=(
        EffectSpec(name='constant_link_torque', joint='joint2', values=(0.012,)),))
    moves = builders.via_points(np.outer(np.linspace(0.0, 1.0, 4), [0.9, 1.2]), 2.0, 0.0)
    return biased, _recording(biased, robot, gains, moves, 6.5)


def test_the_planned_motion_separates_what_moves_in_one_direction_leave(
        robot, gains, forward_only):
    biased, recording = forward_only
    beliefs = beliefs_of([recording], robot, [BIAS, ASYMMETRY])
    before = {one.effects: one.evidence for one in beliefs.hypotheses}
    assert abs(before[BIAS] - before[ASYMMETRY]) < 2.0 * np.log(20.0)
    plan = plan_next(beliefs, gains, LIMITS, period=PERIOD, longest=20.0)
    assert not plan.undecided and plan.best.duration <= 20.0
    found = _recording(biased, robot, gains, plan.best.candidate.trajectory(JOINTS),
                       plan.best.duration)
    assert (np.abs(found.dq_link) <= 1.1 * LIMITS.velocity).all()
    after = {one.effects: one.evidence
             for one in beliefs_of([recording, found], robot, [BIAS, ASYMMETRY]).hypotheses}
    assert after[BIAS] - after[ASYMMETRY] > 2.0 * plan.wanted


def test_limits_that_no_motion_keeps_are_refused(robot, gains, forward_only):
    tight = replace(LIMITS, torsion=[1e-4, 1e-4])
    beliefs = beliefs_of([forward_only[1]], robot, [BIAS, ASYMMETRY])
    with pytest.raises(ConfigError, match='every motion would cross a limit'):
        plan_next(beliefs, gains, tight, period=PERIOD)
