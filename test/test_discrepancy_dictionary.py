# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What is looked for: every effect wherever it can act, at sizes the model allows."""

from dataclasses import replace
from types import SimpleNamespace

from bench.hidden_robots.cases import make_case
from core_runs import affected, effect_on
from discrepancy_runs import as_believed, driven_motion, likelihood_of, retuned_of, rigid_motion
from gms_flex_control.discrepancy.dictionary import Dictionary, guesses_of, may_join
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.motion import scales_of
from gms_flex_control.discrepancy.nuisance import nuisances_of
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.effects import registry
from gms_flex_control.effects.registry import find
import numpy as np
import pytest


@pytest.fixture(scope='module')
def likelihood(robot, gains):
    """Return the Likelihood of a clean run through encoders."""
    return Likelihood([driven_motion(robot, gains, seed=1)], robot)


def test_every_effect_is_looked_for_wherever_it_can_act_at_sizes_the_model_allows():
    """Its probes and what they stand for are values within the bounds of its parameters."""
    likelihood = likelihood_of(make_case('clean', 0, duration=5.0))
    guesses = guesses_of(likelihood)
    asked = {(name, joint) for name, joint, _ in guesses}
    again = {name for one in registry.names() for name in registry.find(one).again}
    assert asked == {(name, place) for name in registry.names() for place in (
        ['arm'] if registry.find(name).whole_arm else likelihood.robot.joints)
        if name != 'friction_backlash'  # of joints without a spring only
        and name not in again}          # where a joint has the first
    left_out = {(name, joint) for name, joint, _ in guesses_of(likelihood, ('backlash',))}
    assert left_out == {one for one in asked if one[0] != 'backlash'}
    for name, joint, guess in guesses:
        kind = find(name)
        ends = [np.clip(np.full(len(guess.probes), c), guess.lowest, guess.highest)
                for c in (-40.0, 0.7, 40.0)]
        for values in (*guess.probes, *map(guess.values, ends)):
            given = dict(zip([p.name for p in kind.parameters], values, strict=True))
            assert kind.values(given, f'{joint}.{name}') == tuple(map(float, values))


def test_what_a_guess_stands_for_is_the_sum_of_its_probes(likelihood):
    """Columns times coefficients against the rows of the effect itself, for linear ones."""
    rows = as_believed(likelihood).whitened

    def made(name, joint, values):
        robot = affected(likelihood.robot, joint, name, *map(float, values))
        return as_believed(likelihood, robot).whitened - rows
    linear = ('torque_ripple', 'position_friction', 'gravity_tilt', 'spring_cubic',
              'motor_viscous', 'kinematic_error', 'friction_drift', 'viscous_error',
              'motor_inertia_coupling')
    tried = set()
    for name, joint, guess in guesses_of(likelihood):
        if name not in linear or (name, joint) in tried:
            continue
        tried.add((name, joint))
        coefficients = np.array([0.6, -0.8])[:len(guess.probes)]
        whole = made(name, joint, guess.values(coefficients))
        parts = sum(c * made(name, joint, probe)
                    for c, probe in zip(coefficients, guess.probes, strict=True))
        scale = np.sqrt(np.mean(whole ** 2))
        assert np.sqrt(np.mean((whole - parts) ** 2)) < 0.01 * scale or scale == 0.0, name
    assert len(tried) == 2 * len(linear) - 1


def test_a_rigid_axis_has_guesses_of_what_can_be_there():
    """None of a spring or of a motor side, none of the whole arm."""
    def looked_for(robot, motion):
        scales = scales_of((motion,), robot)
        given = SimpleNamespace(robot=robot, motions=(motion,), unseen=frozenset(),
                                scales_of=lambda joint: scales[0])
        return {name for name, _, _ in guesses_of(given)}
    robot, motion = rigid_motion()
    found = looked_for(robot, motion)
    assert {'torque_gain', 'friction_asymmetry', 'end_stop', 'torque_ripple',
            'load_friction', 'actuator_deadzone', 'friction_backlash'} <= found
    assert not found & {'backlash', 'spring_cubic', 'stiffness_error', 'gravity_tilt',
                        'tip_payload', 'supply_sag', 'motor_inertia_error', 'motor_viscous',
                        'motor_torque_bias'}
    motion = replace(motion, samples=replace(motion.samples, commanded=False))
    measured = looked_for(robot, motion)
    assert found - measured == {'actuator_deadzone', 'actuator_saturation', 'actuator_lag',
                                'input_delay'}  # what is measured has passed them
    robot, _ = rigid_motion(0.0, motor_inertia=0.02)  # all of its inertia stands at the motor
    assert looked_for(robot, motion) - measured == {'motor_inertia_error'}
    nuisances = nuisances_of(robot)
    assert {nuisance.name for nuisance in nuisances} >= {'motor_inertia', 'level'}
    # it would fall below Coulomb friction
    assert 'static' not in {nuisance.name for nuisance in nuisances}


def test_effects_that_scale_a_joint_together_do_not_join(ideal_robot):
    """But beside one whose size is known, another has a size of its own."""
    specs = [effect_on('joint1', name, 0.1)
             for name in ('torque_gain', 'stiffness_error', 'input_delay', 'actuator_lag')]
    gain, spring, delay, lag = specs
    robot = replace(ideal_robot, effects=(gain, delay))
    assert [may_join(spec, robot, 0) for spec in specs] == [False] * 4
    assert [may_join(spec, robot, 2) for spec in specs] == [False, True, False, True]
    other = replace(spring, joint='joint2')
    assert may_join(replace(spring, name='motor_inertia_error'), robot, 0)  # K separates them
    assert not may_join(replace(spring, name='load_friction'), replace(robot, effects=(
        replace(spring, name='link_inertia_error'),)), 0)  # it would scale what a motor carries
    assert may_join(other, robot, 0) and not may_join(other, replace(robot, effects=(other,)), 1)


def test_a_supply_that_is_known_is_looked_for():
    """Two sags about voltages 1 V apart add up to one of another ratio and nominal voltage."""
    class Volts:
        supply = 24.0
    guess, = find('supply_sag').guesses(Volts)
    c, volts = np.array([0.3, 0.4]), np.array([20.0, 23.0, 25.5])
    ratio, nominal = guess.values(c)
    parts = sum(k * r * (volts - v) for k, (r, v) in zip(c, guess.probes, strict=True))
    np.testing.assert_allclose(ratio * (volts - nominal), parts, rtol=1e-12)


@pytest.mark.parametrize('effect', ['stiffness_error', 'spring_damping'])
def test_the_first_scan_gains_nearly_what_the_fit_does(effect):
    """Of effects that are linear: the gain is that of the fit in full, and the size is found."""
    case = make_case('single', 3, effect=effect, duration=20.0)
    true, = case.truth.effects
    likelihood = likelihood_of(case)
    model, columns = retuned_of(likelihood, PLAUSIBLE)
    ranked = Dictionary(likelihood, model).ranked(model, columns, PLAUSIBLE)
    decreases = [one.decrease for one in ranked]
    assert decreases == sorted(decreases, reverse=True)
    first, = (one for one in ranked if one.key == true.key)
    assert first.decrease > 0.9 * ranked[0].decrease
    assert first.spec.values[0] == pytest.approx(true.values[0], rel=0.2)
