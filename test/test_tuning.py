# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Margins against closed forms and simulation; proposals against what was asked of them."""

from dataclasses import replace
import json
import math
import re

from core_runs import effect_on, single_axis
from gms_flex_control.cli.main import main
from gms_flex_control.control.cascade import SteppedController
from gms_flex_control.control.gain_conditions import violations
from gms_flex_control.file_io import robot_file
from gms_flex_control.hardware.limits import limited, violation
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import EncoderParams, FrictionParams, StribeckParams
from gms_flex_control.schema import files
from gms_flex_control.schema.build import limits_from_values, robot_values
from gms_flex_control.simulation import loop as closed_loop
from gms_flex_control.simulation.loop import SteppedPlant
from gms_flex_control.trajectory import builders
from gms_flex_control.tuning import margins, study
from gms_flex_control.tuning.linear_loop import compliance, linear_loop, Timing
from gms_flex_control.tuning.margins import judged
from gms_flex_control.tuning.propose import _candidates, _SLOWEST, Demands, propose
import numpy as np
import pytest

NOTHING = StribeckParams(static=[1e-12], coulomb=[1e-12], velocity=[0.01], viscous=[0.0])
FRICTIONLESS = FrictionParams(forward=NOTHING, backward=NOTHING, stiffness=[[0.0] * 8],
                              weight=[[1.0 / 8.0] * 8], attraction=[1.0])
INERTIA, KD, RATE = 0.2, 1.5, 6.0
STILL = np.zeros(1)


def gains_of(**values):
    one = {'kd_link': KD, 'lambda_link': RATE, 'kd_motor': 0.3, 'lambda_motor': 50.0,
           'observer_gain': 1.0, 'sign_slope': 50.0, 'filter_bandwidth': 100.0,
           'torque_limit': 1e6} | values
    return ControllerParams(compensation='none', **{key: [value] for key, value in one.items()})


@pytest.fixture
def rigid():
    return single_axis(FRICTIONLESS, INERTIA)


@pytest.fixture
def flexible():
    """Return an axis with a spring and with encoders as real ones, but for the counting."""
    axis = single_axis(FRICTIONLESS, INERTIA, stiffness=20.0, motor_inertia=0.01)
    return replace(axis, encoder=EncoderParams(velocity_cutoff=50.0))


def test_a_rigid_axis_has_the_loop_of_a_sampled_double_integrator(rigid):
    """Closed form of the held torque: L(z), the gain margin 2 m / (c T), and no lower one."""
    period, m = 2e-3, INERTIA
    k, c = KD * RATE, KD + m * RATE
    loop = linear_loop(rigid, rigid, gains_of(), Timing(period, 0.0), STILL)
    w = np.array([1.0, 10.0, 100.0, 1000.0])
    z = np.exp(1j * w * period)
    expected = (0.5 * k * period ** 2 * (z + 1) + c * period * (z - 1)) / m / (z - 1) ** 2
    np.testing.assert_allclose(margins.open_loop(loop, 0, w), expected, rtol=1e-6)
    found = margins.joint_margins(loop, 0)
    assert found.gain_up == pytest.approx(2 * m / (c * period), rel=1e-6)
    assert found.gain_down == 0.0


@pytest.mark.parametrize('delay', [0.0, 1.5e-3, 2e-3, 5e-3])
def test_the_linear_loop_moves_as_the_simulated_robot(flexible, delay):
    """From 1 mrad beside the reference, with velocity filter and delay, sample by sample."""
    timing, begin = Timing(2e-3, delay), 1e-3
    run = closed_loop.run(study.with_delay(flexible, delay), flexible, gains_of(),
                          builders.hold(STILL), duration=0.4, substeps=200, q_link=[begin])
    loop = linear_loop(flexible, flexible, gains_of(), timing, STILL)
    z = np.zeros(len(loop.a))
    z[[0, 2, 4, 5]] = begin  # link, motor, and what both encoders saw before
    links = []
    for _ in run.time:
        links.append(z[0])
        z = loop.closed @ z
    np.testing.assert_allclose(run.true[:, 0, 0], links, atol=2e-2 * begin)


def test_at_the_delay_margin_the_simulated_robot_begins_to_swing(flexible):
    timing = Timing(2e-3, 0.0)
    margin = margins.delay_margin(flexible, flexible, gains_of(), timing, STILL)
    assert 1e-3 < margin < 0.05
    swings = []
    for delay in (0.93 * margin, 1.07 * margin):
        run = closed_loop.run(study.with_delay(flexible, delay), flexible, gains_of(),
                              builders.hold(STILL), duration=3.0, substeps=100, q_link=[1e-6])
        swings.append(np.ptp(run.true[-200:, 2, 0]) / np.ptp(run.true[:200, 2, 0]))
    assert swings[0] < 0.5 and swings[1] > 2.0


def test_encoder_noise_causes_the_torque_that_is_reported(flexible):
    noisy = replace(flexible, encoder=EncoderParams(noise=1e-4, velocity_cutoff=50.0))
    loop = linear_loop(noisy, noisy, gains_of(), Timing(2e-3, 0.0), STILL)
    reported = margins.jitter(loop, noisy.encoder)
    run = closed_loop.run(noisy, noisy, gains_of(), builders.hold(STILL), duration=60.0)
    assert reported.torque[0] == pytest.approx(run.command[1000:].std(), rel=0.03)
    assert reported.angle[0] == pytest.approx(run.true[1000:, 0].std(), rel=0.1)


def test_a_constant_torque_moves_the_link_as_far_as_is_reported(flexible):
    push = effect_on('axis', 'constant_link_torque', 0.02)
    run = closed_loop.run(replace(flexible, effects=(push,)), flexible, gains_of(),
                          builders.hold(STILL), duration=6.0)
    reported = compliance(flexible, flexible, gains_of(), Timing(2e-3, 0.0), STILL)
    assert 0.02 * reported[0, 0] == pytest.approx(run.true[-1, 0, 0], rel=1e-3)
    assert reported[0, 0] > 1.0 / (KD * RATE)


def test_stuck_blocks_hold_a_link_like_a_spring(rigid):
    """Without gains the pole is that of k_i and the inertia."""
    stiff = replace(FRICTIONLESS, stiffness=[[30.0 / 8.0] * 8])
    robot = replace(rigid, friction=stiff)
    idle = gains_of(kd_link=0.0, lambda_link=0.0)
    loop = linear_loop(robot, robot, idle, Timing(1e-3, 0.0), STILL, stuck=True)
    poles = np.linalg.eigvals(loop.closed)
    swinging = np.abs(np.log(poles[np.abs(poles.imag) > 1e-6])) / 1e-3
    assert swinging == pytest.approx(math.sqrt(30.0 / INERTIA), rel=1e-6)


def test_a_proposal_holds_what_was_asked_and_is_stiffer_than_the_paper(arm):
    robot, base = arm
    demands = Demands(Timing(4e-3, 0.0), base.torque_limit, delay=2e-3)
    found = propose(robot, base, demands)
    assert found.unmet == ()
    again = judged(robot, robot, found.gains, demands.timing)
    assert again.conditions.met and again.delay >= 2e-3
    for one, noise in zip(again.joints, again.jitter.torque, strict=True):
        assert one.gain_up >= 2.0 and one.gain_down <= 0.5 and one.phase >= math.pi / 6
        assert noise <= 0.1 * 2.0
    stiffness = found.gains.kd_link * found.gains.lambda_link
    assert np.all(stiffness > 1.2 * 0.8 * 0.5)


def test_a_torque_that_may_rise_but_slowly_asks_for_gentle_gains(arm):
    """As docs/tuning.md says, and the tutorial with a robot does."""
    robot, paper = arm
    values, _ = files.read_values([robot_file().with_name('bridge.yaml')])
    limits = limits_from_values(values, robot.joints)
    for rate in (200.0, 500.0):
        assert 'moves at' in ended_by(limits, robot, paper, rate, 3.0)
    demands = Demands(timing=Timing(5e-3, 5e-3), torque_limit=paper.torque_limit,
                      bandwidth=np.full(2, 3.0), gain=3.0, delay=5e-3)
    gentle = propose(robot, paper, demands)
    assert not gentle.unmet
    assert ended_by(limits, robot, gentle.gains, 200.0, 8.0) == ''


def test_the_gains_of_a_first_start_hold_the_arm_behind_the_bridge(arm):
    """One sample of delay more; the paper's swing at rest, within two seconds."""
    robot, paper = arm
    values, _ = files.read_values([robot_file().with_name('bridge.yaml')])
    limits, rest = limits_from_values(values, robot.joints), np.array([0.1234, -0.21])
    gentle = files.load_controller(robot_file().with_name('first_start.yaml'), robot)
    assert all('still holds' in sentence for sentence in violations(gentle, robot))
    for compensation in ('none', 'gms'):
        assert 'moves at' in ended_by(limits, robot, replace(paper, compensation=compensation),
                                      200.0, 2.0, builders.hold(rest), delay=1)
        assert ended_by(limits, robot, replace(gentle, compensation=compensation), 200.0, 60.0,
                        builders.hold(rest), delay=1) == ''


def ended_by(limits, robot, gains, rate, duration, motion=None, delay=0):
    """Return the fault of a motion, a sinusoid of 0.3 rad, behind limits, '' without."""
    motion, torque = motion or builders.sinusoid(np.full(2, 0.3), 6.0), np.zeros(2)
    plant = SteppedPlant(robot, period=1.0 / rate, substeps=20, q_link=motion.sample(0.0)[0])
    controller, waiting = SteppedController(gains, robot), [torque] * delay
    for k in range(round(duration * rate)):
        state = plant.measured
        if fault := violation(robot.joints, state, limits):
            return fault
        for name in ('q_link', 'dq_link', 'q_motor', 'dq_motor'):
            getattr(controller.measured, name)[:] = getattr(state, name)
        asked = controller.tick(motion.sample(k / rate), 1.0 / rate if k else 0.0)
        torque = limited(asked, torque, 1.0 / rate, state.q_link, state.dq_link, limits)
        waiting.append(torque)
        plant.advance(waiting.pop(0))
    return ''


def test_draws_stay_within_the_spread(arm):
    robot, _ = arm
    believed = robot_values(robot)
    drawn = [study.draw(robot, np.random.default_rng(k))[0] for k in range(50)]
    values = [robot_values(one) for one in drawn]
    for key, spread in (('arm.joint1.stiffness', 0.2), ('arm.joint2.mass', 0.3),
                        ('friction.joint2.backward.coulomb', 0.3), ('arm.joint1.length', 0.0),
                        ('arm.joint1.motor_inertia', 0.3)):
        ratios = np.array([one[key] for one in values]) / believed[key]
        assert np.all(np.abs(ratios - 1.0) <= spread + 1e-12)
        assert np.ptp(ratios) >= 1.5 * spread


@pytest.fixture
def axis_file(tmp_path, arm):
    """Return the file of one flexible axis with the paper's friction."""
    axis = single_axis(arm[0].friction.of_joints([0]), 0.3, stiffness=1.5, motor_inertia=0.006)
    axis = replace(axis, encoder=arm[0].encoder)
    files.save_robot(axis, tmp_path / 'axis.yaml')
    return tmp_path / 'axis.yaml'


def test_tune_writes_what_the_controller_loads(tmp_path, axis_file, capsys):
    args = ['tune', '--robot', str(axis_file), '--torque-limit', '2', '--bandwidth', '6',
            '--verify', '3', '--json', '--out']
    assert main([*args, str(tmp_path / 'a')]) == 0
    reported = json.loads(capsys.readouterr().out)
    gains = files.load_controller(tmp_path / 'a' / 'controller.yaml', files.load_robot(axis_file))
    assert gains.kd_link[0] == reported['gains']['gains.axis.kd_link']
    assert gains.compensation == 'gms' and gains.torque_limit[0] == 2.0
    assert reported['met'] and reported['verify']['draws'] == 3 and not reported['verify']['lost']
    assert (tmp_path / 'a' / 'tuning.png').stat().st_size > 10_000
    row, = (line for line in (tmp_path / 'a' / 'controller.yaml').read_text().splitlines()
            if line.startswith('# axis '))
    assert len(row.split()) == 9, 'the table of margins stands in the file as it is printed'


def test_tune_prints_the_error_to_expect_and_that_the_bound_is_none(tmp_path, axis_file, capsys):
    """The larger of both motions, by simulation, beside what friction holds; a linear axis."""
    kind = tmp_path / 'axes.yaml'
    files.save_values({'arm.axes': 'linear'}, kind)
    assert main(['tune', '--robot', str(axis_file), str(kind), '--torque-limit', '2',
                 '--bandwidth', '6', '--out', str(tmp_path)]) == 0
    out = capsys.readouterr().out
    units = set(re.findall(r'\bmrad\b|\bmm\b|\bN m\b|\bN\b(?! m)', out))
    assert units == {'mm', 'N'}
    trials = json.loads((tmp_path / 'tuning.json').read_text())['trials']['gms'].values()
    mse, peak = (max(trial[name][0] for trial in trials) for name in ('mse', 'peak'))
    assert (f'expected error, gms, the worse motion: axis {1e3 * math.sqrt(mse):.3g} mm '
            f'rms, {1e3 * peak:.3g} at most\n' in out)
    assert 'static friction can hold without compensation: axis ' in out
    assert out.count('(43)') == 1 and 'Not a prediction' in out


def test_a_joint_that_is_always_too_fast_gets_the_slowest_gains_tried(axis_file):
    """A chain that is lost whatever a joint does asks it to be slower, round after round."""
    robot, inertia = files.load_robot(axis_file), 0.3
    demands = Demands(timing=Timing(2e-3, 0.0), torque_limit=np.ones(1))
    first = next(_candidates(robot, demands, 0, inertia, 1e-3))
    assert np.sqrt(first['kd_link'] * first['lambda_link'] / inertia) == pytest.approx(
        _SLOWEST, rel=1e-3)


def test_tune_says_no_where_nothing_fits(tmp_path, axis_file, capsys):
    assert main(['tune', '--robot', str(axis_file), '--torque-limit', '2', '--bandwidth', '60',
                 '--rate', '100', '--out', str(tmp_path / 'no')]) == 1
    assert 'NOT MET: axis' in capsys.readouterr().out
    assert not (tmp_path / 'no' / 'controller.yaml').exists()


def test_an_unstable_loop_is_not_simulated_and_the_way_out_is_said(tmp_path, axis_file, capsys):
    assert main(['tune', '--robot', str(axis_file), '--torque-limit', '2', '--bandwidth', '1e9',
                 '--out', str(tmp_path / 'no')]) == 1
    printed = capsys.readouterr().out
    assert 'axis: the sampled loop is unstable; lower --bandwidth' in printed
    assert not re.search(r'\b(nan|inf|lost)\b', printed)
    assert json.loads((tmp_path / 'no' / 'tuning.json').read_text())['trials'] == {}


def test_a_torque_limit_that_is_met_is_reported_by_compensation(tmp_path, capsys):
    assert main(['tune', '--torque-limit', '0.1', '--bandwidth', '4', '--out', str(tmp_path)]) == 1
    reported = [line.partition(';')[0].partition('torque limit for ')
                for line in capsys.readouterr().out.splitlines() if 'at the torque limit' in line]
    where = [(joint, share.partition(' % ')[2]) for joint, _, share in reported]
    assert where and len(set(where)) == len(where)
    assert {place.partition(', ')[2] for _, place in where} == {
        'compensation none', 'compensation gms'}
