# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Nuisance parameters: what a fit moves is what is written, and each has its prior."""

from dataclasses import replace

from core_runs import effect_on
from gms_flex_control.discrepancy.nuisance import nuisances_of, tuned, with_nuisances
from gms_flex_control.simulation import plant
import numpy as np
import pytest


def flat(record):
    """Return all numbers of a record by name."""
    numbers = {}
    for part in ('chain', 'friction'):
        entry = getattr(record, part)
        for name in entry.dtype.names:
            numbers[f'{part}.{name}'] = np.array(getattr(entry, name))
    return numbers


def assert_written_as_fitted(robot, nuisances, x):
    """Raise unless a robot that is written has the inertia and moments that were fitted."""
    own = plant.constants_of(replace(robot, effects=()))
    asked = flat(tuned(plant.constants_of(robot), nuisances, x, own))
    made = flat(plant.constants_of(with_nuisances(robot, nuisances, x)))
    for field in ('chain.coupling', 'chain.moment'):
        np.testing.assert_allclose(made[field], asked[field], rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('arm', [{}, {'damping': [0.01, 0.02]}, {'gravity': [0.0, -9.0]},
                                 {'kind': 'decoupled', 'gravity': [0.0, -9.0]},
                                 {'kind': 'decoupled', 'stiffness': [np.inf, 5.0]},
                                 {'stiffness': [np.inf, np.inf], 'motor_inertia': [0.01, 0.3]}])
def test_a_robot_with_nuisances_is_the_record_with_nuisances(ideal_robot, arm):
    """And nuisances at zero are the robot as it was."""
    changed = replace(ideal_robot.arm, **arm)
    motors = [motor * (not rigid) for motor, rigid in zip(ideal_robot.motors, changed.rigid,
                                                          strict=True)]
    robot = replace(ideal_robot, arm=changed, motors=tuple(motors))
    base = plant.constants_of(robot)
    nuisances = nuisances_of(robot)
    sd, rng = np.array([nuisance.sd for nuisance in nuisances]), np.random.default_rng(0)
    for x in (np.zeros(len(sd)), sd * rng.uniform(-1.0, 1.0, len(sd))):
        asked = flat(tuned(base, nuisances, x))
        made = flat(plant.constants_of(with_nuisances(robot, nuisances, x)))
        used = [name for name in asked if arm.get('gravity') or name != 'chain.moment']
        for name in used:
            np.testing.assert_allclose(made[name], asked[name], rtol=1e-12, atol=1e-15,
                                       err_msg=name)
    for nuisance in nuisances:
        one = tuned(base, [nuisance], [0.01])
        changed = [name for name, value in flat(one).items()
                   if not np.array_equal(value, flat(base)[name])]
        assert changed and {name.split('.')[1] for name in changed} == {
            field for _, field, _ in nuisance.fields}


@pytest.mark.parametrize('kind', ['planar', 'decoupled'])
@pytest.mark.parametrize('mass', [[1.5, 1.0], [0.3, 2.0]])
@pytest.mark.parametrize('effect', [('tip_payload', '', (0.4,)),
                                    ('tip_payload', '', (1.5,)),
                                    ('link_inertia_error', 'joint1', (0.9,)),
                                    ('link_inertia_error', 'joint1', (3.0,)),
                                    ('link_inertia_error', 'joint2', (-0.5,))])
def test_nuisances_scale_a_link_beside_what_effects_add(ideal_robot, effect, kind, mass):
    """The fit moves the inertia of the link, not of its payload; so does the robot written."""
    name, joint, values = effect
    arm = replace(ideal_robot.arm, kind=kind, mass=mass, gravity=[0.0, -9.0])
    robot = replace(ideal_robot, arm=arm, effects=(effect_on(joint, name, *values),))
    nuisances = nuisances_of(robot)
    for seed in range(5):
        x = np.random.default_rng(seed).uniform(-0.04, 0.04, len(nuisances))
        assert_written_as_fitted(robot, nuisances, x)


@pytest.mark.parametrize('tilt', [0.0, 0.1])
def test_a_point_mass_and_a_known_tilt_are_written_as_they_are_fitted(ideal_robot, tilt):
    """Moments up and inertia down would ask for an inertia below zero about the centre of mass."""
    known = (effect_on('arm', 'gravity_tilt', tilt, -1.5),) if tilt else ()
    robot = replace(ideal_robot, effects=known, arm=replace(
        ideal_robot.arm, inertia=[0.0, 0.0], gravity=[0.0, -9.0 * (not tilt)]))
    nuisances = nuisances_of(robot)
    x = np.array([{'gravity': 0.03, 'inertia': -0.02}.get(nuisance.name, 0.0)
                  for nuisance in nuisances])
    assert_written_as_fitted(robot, nuisances, x)
