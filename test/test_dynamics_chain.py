# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Chains of 1, 2 and 3 links against Lagrange's equations of point positions."""

from dataclasses import replace

import core_runs
from gms_flex_control import records
from gms_flex_control.dynamics import chain
from gms_flex_control.errors import ParameterError
from gms_flex_control.params.arm import ArmParams
import numpy as np
import pytest

pytestmark = pytest.mark.fast

GRAVITY = [1.5, -9.0]


def random_arm(n, seed=0, **changes):
    """Return a planar chain of n links with unlike parameters, its last joint rigid."""
    rng = np.random.default_rng(100 * n + seed)
    values = {name: rng.uniform(0.2, 1.0, n) for name in (
        'mass', 'length', 'com', 'inertia', 'motor_inertia', 'damping')}
    stiffness = rng.uniform(5.0, 20.0, n)
    stiffness[-1] = np.inf
    offset = rng.uniform(-1.5, 1.5, n)
    values |= {'kind': 'planar', 'stiffness': stiffness, 'gravity': GRAVITY,
               'offset': offset} | changes
    return ArmParams(**values)


def motion(n, seed=0):
    """Return a function t -> q, dq, ddq, d3q (4, n) of smooth joint motions."""
    rng = np.random.default_rng(seed)
    amplitude, omega, phase = (rng.uniform(0.5, 2.0, n) for _ in range(3))

    def at(t):
        return np.array([amplitude * omega ** k * np.sin(omega * t + phase + 0.5 * np.pi * k)
                         for k in range(4)])
    return at


def kinetic_and_potential(q, dq, arm):
    """Return both energies of the links from the positions of their centres of mass."""
    theta, omega = np.cumsum(q + arm.offset), np.cumsum(dq)
    direction = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    normal = np.stack([-np.sin(theta), np.cos(theta)], axis=1)
    joint, joint_velocity = np.zeros(2), np.zeros(2)
    kinetic = potential = 0.0
    for i in range(len(q)):
        centre = joint + arm.com[i] * direction[i]
        velocity = joint_velocity + arm.com[i] * omega[i] * normal[i]
        kinetic += 0.5 * arm.mass[i] * velocity @ velocity + 0.5 * arm.inertia[i] * omega[i] ** 2
        if arm.rigid[i]:
            kinetic += 0.5 * arm.motor_inertia[i] * dq[i] ** 2
        potential -= arm.mass[i] * np.asarray(arm.gravity) @ centre
        joint = joint + arm.length[i] * direction[i]
        joint_velocity = joint_velocity + arm.length[i] * omega[i] * normal[i]
    return kinetic, potential


def gradient(function, x, step=1e-5):
    """Return the central differences of a scalar or array function of a vector."""
    return np.array([(function(x + step * unit) - function(x - step * unit)) / (2 * step)
                     for unit in np.eye(len(x))])


def lagrange(q, dq, ddq, arm):
    """Return the joint torques of Lagrange's equations; only energies are used."""
    def momentum(q, dq):  # exact: the kinetic energy is quadratic in dq
        return np.array([kinetic_and_potential(q, dq + unit, arm)[0]
                         - kinetic_and_potential(q, dq - unit, arm)[0]
                         for unit in np.eye(len(q))]) / 2.0
    step = 1e-5
    rate = (momentum(q + step * dq, dq + step * ddq)
            - momentum(q - step * dq, dq - step * ddq)) / (2 * step)
    return rate - gradient(lambda x: np.subtract(*kinetic_and_potential(x, dq, arm)), q)


@pytest.mark.parametrize('n', [1, 2, 3])
@pytest.mark.parametrize('seed', range(3))
def test_the_closed_form_gives_the_torques_of_lagranges_equations(n, seed):
    arm, (q, dq, ddq, d3q) = random_arm(n, seed), motion(n, seed)(0.3)
    m = chain.matrices(q, dq, ddq, d3q, arm)
    np.testing.assert_allclose(m.mass @ ddq + m.coriolis @ dq + m.gravity,
                               lagrange(q, dq, ddq, arm), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize('n', [1, 2, 3])
@pytest.mark.parametrize('name', ['mass', 'coriolis', 'gravity'])
def test_first_and_second_derivatives_are_those_of_finite_differences(n, name):
    arm, at = random_arm(n), motion(n)

    def value(t, prefix=''):
        return getattr(chain.matrices(*at(t), arm), prefix + name)
    for t in (0.1, 1.3, 2.9):
        for lower, upper in (('', 'd'), ('d', 'dd')):
            difference = (value(t + 1e-5, lower) - value(t - 1e-5, lower)) / 2e-5
            scale = np.abs(difference).max() if n > 1 or name == 'gravity' else 1.0
            np.testing.assert_allclose(value(t, upper), difference, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_mass_rate_less_twice_coriolis_is_skew(n):
    m = chain.matrices(*motion(n, 7)(0.5), random_arm(n))
    skew = m.dmass - 2.0 * m.coriolis
    np.testing.assert_allclose(skew, -skew.T, atol=1e-13)
    np.testing.assert_allclose(m.mass, m.mass.T, atol=1e-15)
    assert np.all(np.linalg.eigvalsh(m.mass) > 0)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_the_kernels_acceleration_solves_the_equation_of_motion(n):
    arm, (q, dq, ddq, d3q) = random_arm(n), motion(n)(0.8)
    m = chain.matrices(q, dq, ddq, d3q, arm)
    work = records.build(chain.work_layout(n), tau=np.arange(1.0, n + 1))
    chain.accelerations(q, dq, chain.constants_of(arm), work)
    residual = m.mass @ work.acceleration + m.coriolis @ dq + m.gravity - work.tau
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_the_controllers_inverse_dynamics_and_its_derivatives_agree_with_the_matrices(n):
    """``M dr + C r + g`` along another reference velocity r, with both derivatives."""
    arm, real, ref = random_arm(n), motion(n, 1), motion(n, 2)

    def torque(t):
        q, dq, ddq, d3q = real(t)
        m = chain.matrices(q, dq, ddq, d3q, arm)
        return m.mass @ ref(t)[1] + m.coriolis @ ref(t)[0] + m.gravity
    t, step = 0.6, 1e-4
    links, (q, dq, ddq, d3q) = chain.constants_of(arm), real(t)
    work, found = records.build(chain.work_layout(n)), np.empty((3, n))
    chain.accelerations(q, dq, links, work)
    chain.reference_torque(dq, ddq, d3q, ref(t)[:3], ref(t)[1:], links, work, found)
    before, now, after = (torque(t + k * step) for k in (-1, 0, 1))
    np.testing.assert_allclose(found[0], now, rtol=1e-12)
    np.testing.assert_allclose(found[1], (after - before) / (2 * step), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found[2], (after - 2 * now + before) / step ** 2, rtol=1e-5,
                               atol=1e-5)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_energy_is_that_of_points_springs_and_motors(n):
    arm, (q, dq, motor, dmotor) = random_arm(n), motion(n, 3)(0.4)
    kinetic, potential = kinetic_and_potential(q, dq, arm)
    flexible = ~arm.rigid
    springs = 0.5 * np.sum(arm.stiffness[flexible] * (motor - q)[flexible] ** 2)
    motors = 0.5 * np.sum((arm.motor_inertia * dmotor ** 2)[flexible])
    assert core_runs.energy(q, dq, motor, dmotor, arm) == pytest.approx(
        kinetic + potential + springs + motors, rel=1e-12)


def test_the_default_robot_has_the_constants_its_file_states(robot):
    """M11 = 0.31175 + 0.105 cos q2, M12 = 0.03 + 0.0525 cos q2, M22 = 0.03 kg m^2."""
    for elbow in (0.0, 0.7, 2.0):
        m = chain.matrices([0.3, elbow], np.zeros(2), np.zeros(2), np.zeros(2), robot.arm)
        cos = np.cos(elbow)
        np.testing.assert_allclose(m.mass, [[0.31175 + 0.105 * cos, 0.03 + 0.0525 * cos],
                                            [0.03 + 0.0525 * cos, 0.03]], rtol=1e-12)
    m = chain.matrices([0.3, 0.7], [1.0, 2.0], np.zeros(2), np.zeros(2), robot.arm)
    h = -0.0525 * np.sin(0.7)
    np.testing.assert_allclose(m.coriolis @ [1.0, 2.0], [h * (2 * 1 * 2 + 4), -h], rtol=1e-12)
    np.testing.assert_array_equal(m.gravity, [0.0, 0.0])


def test_a_pendulum_that_reads_zero_where_it_hangs_feels_no_gravity_there():
    """Gravity acts along -y: an offset of -pi/2 from the x axis points down."""
    one, none = np.ones(1), np.zeros(1)
    arm = ArmParams(kind='decoupled', mass=2 * one, length=none, com=0.3 * one, inertia=none,
                    motor_inertia=none, stiffness=np.inf * one, damping=none, gravity=9.81,
                    offset=-0.5 * np.pi * one)
    for q in (0.0, 0.4, 2.0):
        torque = chain.inverse_dynamics([q], [0.0], [0.0], arm)
        np.testing.assert_allclose(torque, 2 * 0.3 * 9.81 * np.sin(q), atol=1e-12)


@pytest.mark.parametrize('kind', ['planar', 'decoupled'])
@pytest.mark.parametrize('n', [1, 2, 3])
def test_inverse_dynamics_is_the_left_side_of_the_link_equation(n, kind):
    """M ddq + C dq + g of `matrices`, at many samples and at one."""
    arm = random_arm(n, kind=kind)
    path = np.stack([motion(n, seed=3)(t) for t in np.linspace(0.0, 3.0, 17)], axis=1)
    torque = chain.inverse_dynamics(*path[:3], arm)
    assert torque.shape == (17, n)
    for k in range(17):
        m = chain.matrices(*path[:, k], arm)
        expected = m.mass @ path[2, k] + m.coriolis @ path[1, k] + m.gravity
        np.testing.assert_allclose(torque[k], expected, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(chain.inverse_dynamics(*path[:3, k], arm), expected,
                                   rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize('kind', ['planar', 'decoupled'])
def test_inverse_dynamics_undoes_the_accelerations_of_the_kernel(kind):
    arm = random_arm(3, kind=kind)
    q, dq, ddq, _ = motion(3, seed=5)(0.9)
    work = records.build(chain.work_layout(3), tau=chain.inverse_dynamics(q, dq, ddq, arm))
    chain.accelerations(q, dq, chain.constants_of(arm), work)
    np.testing.assert_allclose(work.acceleration, ddq, rtol=1e-10)


def test_decoupled_axes_do_not_feel_each_other():
    """Each has its inertia and gravity of its own, whatever the others do."""
    arm = random_arm(3, kind='decoupled')
    q, dq, ddq, d3q = motion(3)(0.2)
    m = chain.matrices(q, dq, ddq, d3q, arm)
    own = arm.inertia + arm.mass * arm.com ** 2 + np.where(arm.rigid, arm.motor_inertia, 0.0)
    np.testing.assert_allclose(m.mass, np.diag(own), atol=1e-15)
    np.testing.assert_array_equal(m.coriolis, np.zeros((3, 3)))
    for j in range(3):
        names = ('mass', 'length', 'com', 'inertia', 'motor_inertia', 'stiffness', 'damping',
                 'offset')
        alone = replace(arm, kind='planar', **{name: getattr(arm, name)[[j]] for name in names})
        assert chain.matrices(*(x[[j]] for x in (q, dq, ddq, d3q)), alone).gravity == (
            pytest.approx(m.gravity[[j]], rel=1e-14))


@pytest.mark.parametrize(('changes', 'sentence'), [
    ({'kind': 'spatial'}, r"arm.kind must be one of planar, decoupled, urdf, got 'spatial'"),
    ({'inertia': [-0.1, 0.1]}, r'inertia must be at least 0, got'),
    ({'mass': [np.nan, 1.0]}, r'mass must be finite, got \[nan'),
    ({'mass': [1.0, 1.0, 1.0]}, r'mass must have shape \(2,\) \(one entry per joint\)'),
    ({'stiffness': [0.0, 1.0]}, r'stiffness must be above 0 \(.inf for a rigid joint\)'),
    ({'motor_inertia': [0.0, 0.0]}, r'motor_inertia must be above 0 where the joint is flexible'),
    ({'inertia': [0.0, 0.0], 'com': [0.0, 0.1]}, r'each link needs inertia or mass away'),
    ({'gravity': [1.0, 2.0, 3.0]}, r'gravity must have shape \(2,\)'),
    ({'gravity': np.inf}, r'gravity must be finite'),
])
def test_an_impossible_arm_is_refused(changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        random_arm(2, **{'stiffness': [5.0, np.inf]} | changes)
