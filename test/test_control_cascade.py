# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The cascade law: exact derivatives, the closed loops the paper promises, and what it buys."""

from dataclasses import replace
from pathlib import Path
import re

from core_runs import model_with_error
from gms_flex_control.control import cascade
from gms_flex_control.simulation import loop, plant
from gms_flex_control.trajectory import builders
import numpy as np
import pytest

SINUSOID = builders.sinusoid([1.0, 1.0], 6.0)
POLYNOMIAL = builders.polynomial([1.0, 1.0], 5.0, 5.0)
PAPER_RATIOS = np.array([[6.1, 8.4], [31.0, 9.5]])  # Table 4: sinusoid, polynomial
ONE_MOVE = builders.via_points([[0.0, 0.0], [1.0, 1.0]], 5.0, 0.0)


def with_mode(gains, mode, **changes):
    """Return gains of a mode, with the paper's k_e where it is the paper's observer."""
    gain = np.full_like(gains.kd_link, 0.01 if mode == 'gms_paper' else 1.0)
    return replace(gains, compensation=mode, **{'observer_gain': gain} | changes)


def mean_square(run):
    """Return the mean square tracking error of the true link angles."""
    return np.mean((run.true[:, 0] - run.reference[:, 0]) ** 2, axis=0)


class IdealLoop:
    """Controller and a robot that is exactly its model, stepped so finely that it is smooth."""

    step = 1e-7

    def __init__(self, robot, gains, trajectory, start):
        """Warm up in the ordinary closed loop to ``start``, and continue from there."""
        n = robot.n_joints
        self.gains, self.robot, self.trajectory, self.time = gains, robot, trajectory, start
        self.constants, self.work = cascade.constants_of(gains, robot), cascade.workspace(n)
        self.state, self.measured = cascade.init(robot), cascade.measurement(n)
        world = plant.init(robot)
        period = 1e-3
        for k in range(int(round(start / period)) + 1):
            self.copy_from(world)
            cascade.tick(self.state, self.measured, trajectory.sample(k * period), period,
                         self.constants, self.work)
            if k < int(round(start / period)):
                plant.advance(world, self.state.command, k * period, period, 10,
                              plant.constants_of(robot), plant.workspace(n))

    def copy_from(self, world):
        """Measure without error."""
        for name in ('q_link', 'dq_link', 'q_motor', 'dq_motor'):
            getattr(self.measured, name)[:] = getattr(world, name)

    def disturb_motor(self, angle, rate):
        """Move the motor away from where it should be."""
        self.measured.q_motor[:] += angle
        self.measured.dq_motor[:] += rate

    def advance(self):
        """Move on by one step; returns u_ed with derivatives, and s_2 of Eq. (28)."""
        m, work, step = self.measured, self.work, self.step
        cascade.tick(self.state, m, self.trajectory.sample(self.time), step, self.constants, work)
        stiffness, torque = self.robot.arm.stiffness, work.torque.copy()
        q_err = m.q_motor - (m.q_link + torque[0] / stiffness)
        dq_err = m.dq_motor - (m.dq_link + torque[1] / stiffness)
        motor = (self.state.command - stiffness * (m.q_motor - m.q_link))
        for q, dq, ddq in ((m.q_link, m.dq_link, work.acceleration),
                           (m.q_motor, m.dq_motor, motor / self.robot.arm.motor_inertia)):
            q += step * dq + 0.5 * step ** 2 * ddq
            dq += step * ddq
        self.time += step
        return torque, dq_err + self.gains.lambda_motor * q_err


TIMES = [0.7, 1.6, 4.55]  # speeding up, reversal, near the second one


@pytest.mark.parametrize('mode', ['none', 'gms_paper'])
@pytest.mark.parametrize('time', TIMES)
def test_derivatives_of_the_elastic_torque_are_those_of_finite_differences(
        ideal_robot, gains, mode, time):
    """u_ed' and u_ed'' along the loop of an exact model, within 1e-5 of their size."""
    loop = IdealLoop(ideal_robot, with_mode(gains, mode), SINUSOID, time)
    loop.disturb_motor(0.02, -0.3)
    torque = np.array([loop.advance()[0] for _ in range(4)])[1:]
    difference = (torque[2, :2] - torque[0, :2]) / (2 * loop.step)
    for k in range(2):
        scale = np.abs(torque[1, k + 1]).max()
        assert scale > 1e-3
        np.testing.assert_allclose(torque[1, k + 1], difference[k], rtol=0, atol=1e-5 * scale)


@pytest.mark.parametrize('mode', ['none', 'gms_paper', 'gms'])
@pytest.mark.parametrize('time', TIMES)
def test_the_motor_subsystem_closes_as_equation_30(ideal_robot, gains, mode, time):
    """J s_2' + K_D2 s_2 = 0 with an exact model, wherever the motor is."""
    free = with_mode(gains, mode, torque_limit=np.full(2, 100.0))
    loop = IdealLoop(ideal_robot, free, SINUSOID, time)
    loop.disturb_motor(0.1, 0.5)
    sliding = np.array([loop.advance()[1] for _ in range(4)])[1:]
    rate = (sliding[2] - sliding[0]) / (2 * loop.step)
    damping = gains.kd_motor * sliding[1]
    tolerance = 2e-5 if mode != 'gms' else 0.1  # its derivatives are those of a filter
    np.testing.assert_allclose(ideal_robot.arm.motor_inertia * rate, -damping, rtol=tolerance)


def documented(row):
    """Return the four numbers of each row of docs/model.md that begins with ``row``."""
    text = (Path(__file__).parents[1] / 'docs' / 'model.md').read_text(encoding='utf-8')
    text = text[text.index('### What it reaches'):]
    return [np.array(re.findall(r'\d[\d.e-]*', cells)[:4], dtype=float) for cells in re.findall(
        rf'^\| {row}[^|]*\|(.*)$', text, re.MULTILINE)]


@pytest.mark.parametrize('mode', ['none', 'gms_paper', 'gms'])
def test_the_documentation_states_what_is_reached(robot, ideal_robot, gains, mode):
    """Both tables of docs/model.md, within 30 %; with model errors more than Table 4."""
    exact = [mean_square(loop.run(ideal_robot, ideal_robot, with_mode(gains, mode),
                                  reference, duration=duration))
             for reference, duration in ((SINUSOID, 20.0), (ONE_MOVE, 10.0))]
    rows = documented(mode + r'\b')
    np.testing.assert_allclose(np.concatenate(exact), rows[0], rtol=0.3)
    if mode == 'none':
        return
    model = model_with_error(robot, friction=0.85, stiffness=1.05, inertia=0.93)
    ratios = [np.divide(*(mean_square(loop.run(
        robot, model, with_mode(gains, each), reference, duration=duration))
        for each in ('none', mode))) for reference, duration in ((SINUSOID, 20.0),
                                                                 (POLYNOMIAL, 25.0))]
    np.testing.assert_allclose(np.concatenate(ratios), rows[1], rtol=0.3)
    assert np.all(np.array(ratios) > (PAPER_RATIOS if mode == 'gms' else 6.0))


def after_move(robot, model, gains, move_time, far=(1.0, 1.0)):
    """Return the peak to peak of the links in 5 s of rest, from 1 s after a move [rad]."""
    reference = builders.via_points([[0.0, 0.0], far], move_time, 0.0)
    run = loop.run(robot, model, gains, reference, duration=move_time + 6.0)
    return np.ptp(run.true[run.time >= move_time + 1.0, 0], axis=0)


@pytest.mark.parametrize('ratio', [0.8, 1.0, 1.3])
def test_what_a_brisk_move_leaves_ringing_dies_out(ideal_robot, gains, ratio):
    """After 1 rad in 2 s the links ring in their presliding springs, ever less."""
    model = model_with_error(ideal_robot, friction=ratio)
    reference = builders.via_points([[0.0, 0.0], [1.0, 1.0]], 2.0, 0.0)
    run = loop.run(ideal_robot, model, with_mode(gains, 'gms'), reference, duration=12.0)
    early, late = (np.ptp(run.true[(run.time >= begin) & (run.time < begin + 1.0), 0], axis=0)
                   for begin in (7.0, 11.0))
    assert np.all(late < np.maximum(early, 1e-5))
    assert late.max() < 1e-4


@pytest.mark.parametrize('ratio', [0.8, 1.0, 1.3])
def test_it_holds_still_behind_encoders(robot, gains, ratio):
    """With 20 000 counts a revolution it moves less than a count, 0.314 mrad, and mostly less."""
    model = model_with_error(robot, friction=ratio)
    for far, most in (((1.0, 1.0), 1e-4), ((1.0, -1.0), 2e-4), ((-0.7, 0.4), 2e-4)):
        assert after_move(robot, model, with_mode(gains, 'gms'), 5.0, far).max() < most


def test_the_papers_law_hunts_where_gms_holds_still(ideal_robot, gains):
    """tanh(50 v) lets go of the friction at rest: over 1 mrad, exact model or not."""
    p2p = after_move(ideal_robot, ideal_robot, with_mode(gains, 'gms_paper'), 5.0)
    assert p2p.max() > 1e-3


def test_the_observer_does_not_wind_up_at_the_torque_limit(ideal_robot, gains):
    """Commands stay within the limit; freed from it, the loop is soon as good as never there."""
    tight = with_mode(gains, 'gms', torque_limit=np.full(2, 0.22))
    run = loop.run(ideal_robot, ideal_robot, tight, SINUSOID, duration=20.0)
    assert np.abs(run.command).max() == 0.22
    assert np.mean(np.abs(run.command) >= 0.22) > 0.05
    assert np.abs(run.friction_hat).max() < 1.5 * np.abs(run.friction).max()


def test_the_correction_stands_still_while_the_torque_is_limited(ideal_robot, gains):
    """The same error moves the observer in a free joint and leaves it alone in a limited one."""
    limit = np.array([1e-3, 1e3])
    loop = with_mode(gains, 'gms', observer_gain=np.ones(2), torque_limit=limit)
    state, work = cascade.init(ideal_robot), cascade.workspace(2)
    constants = cascade.constants_of(loop, ideal_robot)
    measured = cascade.measurement(2)
    reference = np.zeros((5, 2))
    for k in range(3):
        reference[0], reference[1] = 0.02 + 1e-4 * k, 0.05
        cascade.tick(state, measured, reference, 2e-3, constants, work)
        assert state.saturated[0] == 1.0
        assert abs(state.command[0]) == 1e-3
    assert work.correction[0] == 0.0
    assert work.correction[1] != 0.0


@pytest.mark.parametrize(('mode', 'stiffness', 'most'), [
    ('none', np.inf, 2e-2), ('gms_paper', np.inf, 1e-4), ('gms', np.inf, 1e-4),
    ('gms', 1.5, 1e-4)])
def test_rigid_joints_are_controlled_by_the_link_law_alone(ideal_robot, gains, mode, stiffness,
                                                           most):
    """Without a motor side u = u_ed; friction is compensated, also beside a flexible joint."""
    rigid = replace(ideal_robot, motors=('', '' if np.isinf(stiffness) else 'joint2_motor'),
                    arm=replace(ideal_robot.arm, stiffness=[np.inf, stiffness]))
    run = loop.run(rigid, rigid, with_mode(gains, mode), SINUSOID, duration=10.0)
    assert np.all(mean_square(run) < most)
    assert np.isfinite(stiffness) or np.abs(run.command).max() < 2.0
