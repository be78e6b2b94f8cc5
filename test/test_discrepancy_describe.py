# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What is said: units that suit, sentences of what was found, and where something is left."""

from dataclasses import replace
from types import SimpleNamespace

from core_runs import effect_on
from discrepancy_runs import as_believed, driven_motion
from gms_flex_control.discrepancy.describe import evidence_of, torque_scale
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.remainder import dependence, predicted_share, signature_of
from gms_flex_control.discrepancy.result import Signature
from gms_flex_control.discrepancy.validation import Gain
from gms_flex_control.discrepancy.worth import Worth
import numpy as np
import pytest


@pytest.mark.parametrize(('size', 'said'), [(0.0123, '12.3 mN m'), (4.2, '4.2 N m'),
                                            (4630.0, '4.63 kN m'), (np.nan, '- mN m')])
def test_torques_are_reported_in_units_that_suit(size, said):
    scale = torque_scale([size, 0.001])
    assert f'{scale.text(size)} {scale.unit}' == said


@pytest.mark.parametrize(('variable', 'joint', 'expected'), [
    ('time', 'j', True), ('time times the direction of motion', 'j', True),
    ('time', 'other', False), ('torsion', 'j', False), ('', 'j', False)])
def test_an_effect_of_the_variable_that_is_left_has_another_shape(variable, joint, expected):
    """Friction that steps up leaves a function of time beside a drift, which it is none."""
    left = Signature(0.2, 'link', 'j', variable, 'Something is left.')
    assert left.is_of(SimpleNamespace(effect='friction_drift', joint=joint)) == expected


def test_an_effect_that_changes_nothing_that_is_fitted_is_none():
    idle = Worth(0, 0.1, 0.0, 0.0, 50.0, 50.0, Gain(0.0, 0.0, 0), None, None)
    assert not idle.is_real() and idle.weight == 0.0
    assert '0 % of which' in evidence_of(idle, ())
    assert not idle._replace(evidence=1.0, gain=Gain(50.0, 5.0, 10)).is_real()
    assert idle._replace(gain=Gain(50.0, 5.0, 10)).is_real()
    assert not idle._replace(gain=Gain(50.0, 5.0, 10)).is_real(caution=3.0)


def test_what_is_left_is_described_where_most_is_left(robot, gains):
    """The second of two recordings holds a torque on a motor that the first does not."""
    biased = effect_on('joint2', 'motor_torque_bias', 0.02)
    motions = [driven_motion(replace(robot, effects=effects), gains, seed, duration=6.0)
               for seed, effects in enumerate([(), (biased,)])]
    for order in (motions, motions[::-1]):
        likelihood = Likelihood(order, robot)
        found = signature_of(likelihood, as_believed(likelihood), 1.0)
        assert (found.equation, found.joint, found.variable) == ('motor', 'joint2', 'constant')
        other = signature_of(likelihood, as_believed(likelihood), 1.0, among=('joint1',))
        assert other.joint == 'joint1'


def test_a_torque_that_stays_while_a_joint_rests_is_no_function_of_its_angle():
    """Each rest is at another angle: any torque is a function of it, but predicts nothing."""
    rng = np.random.default_rng(5)
    angle, torque = (np.repeat(rng.uniform(-1.0, 1.0, 30), 80) for _ in range(2))
    passes = np.sin(np.linspace(0.0, 40.0, len(angle)))
    for values, residual, share, predicted in (
            (angle, torque, 0.7, 0.0), (passes, np.sin(3.0 * passes), 0.95, 0.95)):
        places = np.floor(10.0 * values).astype(int) + 10
        visits = np.cumsum(np.diff(places, prepend=places[0]) != 0)
        assert dependence(values, residual) > share
        assert predicted_share(places, visits, residual) == pytest.approx(predicted, abs=0.05)
