# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Chains of 1, 2 and 3 links against Lagrange's equations of point positions."""

from dataclasses import replace

from bench.chain_matrices import matrices
from gms_flex_control import records
from gms_flex_control.dynamics import chain
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


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', range(3))
def test_the_closed_form_gives_lagranges_equations_and_the_kernel_solves_them(n, seed):
    arm, (q, dq, ddq, d3q) = random_arm(n, seed), motion(n, seed)(0.3)
    m = matrices(q, dq, ddq, d3q, arm)
    torque = m.mass @ ddq + m.coriolis @ dq + m.gravity
    np.testing.assert_allclose(torque, lagrange(q, dq, ddq, arm), rtol=1e-7, atol=1e-7)
    work = records.build(chain.work_layout(n), tau=torque)
    chain.accelerations(q, dq, chain.constants_of(arm), work)
    np.testing.assert_allclose(work.acceleration, ddq, rtol=1e-10, atol=1e-12)
    work.implicit = implicit = np.linspace(0.0, 0.7, n)
    chain.accelerations(q, dq, chain.constants_of(arm), work)
    held = m.mass + np.diag(implicit)
    np.testing.assert_allclose(work.acceleration, np.linalg.solve(held, m.mass @ ddq), rtol=1e-10)
    between = np.empty((n, n))
    chain.mass_between(np.arange(n), chain.constants_of(arm), work, between)
    np.testing.assert_allclose(between, held, rtol=1e-10)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('name', ['mass', 'coriolis', 'gravity'])
def test_first_and_second_derivatives_are_those_of_finite_differences(n, name):
    arm, at = random_arm(n), motion(n)

    def value(t, prefix=''):
        return getattr(matrices(*at(t), arm), prefix + name)
    for t in (0.1, 1.3, 2.9):
        for lower, upper in (('', 'd'), ('d', 'dd')):
            difference = (value(t + 1e-5, lower) - value(t - 1e-5, lower)) / 2e-5
            scale = np.abs(difference).max() if n > 1 or name == 'gravity' else 1.0
            np.testing.assert_allclose(value(t, upper), difference, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize('n', [2, 3])
def test_mass_rate_less_twice_coriolis_is_skew(n):
    m = matrices(*motion(n, 7)(0.5), random_arm(n))
    skew = m.dmass - 2.0 * m.coriolis
    np.testing.assert_allclose(skew, -skew.T, atol=1e-13)
    np.testing.assert_allclose(m.mass, m.mass.T, atol=1e-15)
    assert np.all(np.linalg.eigvalsh(m.mass) > 0)


@pytest.mark.parametrize('n', [2, 3])
def test_the_controllers_inverse_dynamics_and_its_derivatives_agree_with_the_matrices(n):
    """``M dr + C r + g`` along another reference velocity r, with both derivatives."""
    arm, real, ref = random_arm(n), motion(n, 1), motion(n, 2)

    def torque(t):
        q, dq, ddq, d3q = real(t)
        m = matrices(q, dq, ddq, d3q, arm)
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


@pytest.mark.parametrize('kind', ['planar', 'decoupled'])
@pytest.mark.parametrize('n', [2, 3])
def test_inverse_dynamics_is_the_left_side_of_the_link_equation(n, kind):
    """M ddq + C dq + g of `matrices`, at many samples and at one."""
    arm = random_arm(n, kind=kind)
    path = np.stack([motion(n, seed=3)(t) for t in np.linspace(0.0, 3.0, 17)], axis=1)
    torque = chain.inverse_dynamics(*path[:3], arm)
    assert torque.shape == (17, n)
    for k in range(17):
        m = matrices(*path[:, k], arm)
        expected = m.mass @ path[2, k] + m.coriolis @ path[1, k] + m.gravity
        np.testing.assert_allclose(torque[k], expected, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(chain.inverse_dynamics(*path[:3, k], arm), expected,
                                   rtol=1e-12, atol=1e-13)


def test_decoupled_axes_do_not_feel_each_other():
    """Each has its inertia and gravity of its own, whatever the others do."""
    arm = random_arm(3, kind='decoupled')
    q, dq, ddq, d3q = motion(3)(0.2)
    m = matrices(q, dq, ddq, d3q, arm)
    own = arm.inertia + arm.mass * arm.com ** 2 + np.where(arm.rigid, arm.motor_inertia, 0.0)
    np.testing.assert_allclose(m.mass, np.diag(own), atol=1e-15)
    np.testing.assert_array_equal(m.coriolis, np.zeros((3, 3)))
    for j in range(3):
        names = ('mass', 'length', 'com', 'inertia', 'motor_inertia', 'stiffness', 'damping',
                 'offset')
        alone = replace(arm, kind='planar', **{name: getattr(arm, name)[[j]] for name in names})
        assert matrices(*(x[[j]] for x in (q, dq, ddq, d3q)), alone).gravity == (
            pytest.approx(m.gravity[[j]], rel=1e-14))
