# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What else may be recorded next: below break-away, with a weight at the tip, to identify."""

from dataclasses import replace
import json
from pathlib import Path

from gms_flex_control.cli.main import main
from gms_flex_control.data.conditions import conditions_of, repeat_conditions
from gms_flex_control.data.recording import Operation
from gms_flex_control.data.writer import write_recording
from gms_flex_control.design import determination
from gms_flex_control.design.determination import missing_of
from gms_flex_control.design.motions import below_break_away, by_hand, candidates
from gms_flex_control.design.plan import plan_next
from gms_flex_control.design.separation import beliefs_of, loaded, loop_of, predicted, Prediction
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.dynamics.chain import mass_matrices
from gms_flex_control.errors import BagError
from gms_flex_control.experiment.simulated import Plan, simulate
from gms_flex_control.friction import gms
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.arm import Body, carrying
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.simulation.plant import constants_of
from gms_flex_control.trajectory import builders
import numpy as np
import pytest

PERIOD = 0.002
JOINTS = ('joint1', 'joint2')
LIMITS = Limits(torque=[2.0, 2.0], torque_rate=[50.0, 50.0], velocity=[1.5, 2.0],
                velocity_margin=[0.5, 0.5], lower=[-1.2, -1.5], upper=[1.0, 1.5],
                position_margin=[0.1, 0.1], torsion=[0.9, 0.9])
CONFIG = Path(__file__).parents[1] / 'config'
SOFTER = frozenset({('stiffness_error', 'joint2')})
WEAKER = frozenset({('torque_gain', 'joint2')})
WEIGHT = Body(0.5, np.zeros(3), np.zeros((3, 3)))


def _recording(robot, model, gains, trajectory, duration=6.0):
    """Return the closed loop of a robot that the controller believes to be ``model``."""
    return simulate(Plan(robot=robot, model=model, gains=gains, trajectory=trajectory,
                         motion='test', duration=duration, period_ns=2_000_000, substeps=20,
                         seed=5, q_link=np.zeros(2)))


@pytest.fixture(scope='module')
def swings(robot, gains):
    """Return swings of a robot whose drive of joint2 gives 8 % more than it believes."""
    weaker = replace(robot, effects=(
        EffectSpec(name='torque_gain', joint='joint2', values=(0.08,)),))
    return _recording(weaker, robot, gains, builders.sinusoid(
        [0.3, 0.3], [4.0, 5.0], ramp_time=2.0))


def test_ramps_below_break_away_load_friction_to_half_of_it_at_most(robot):
    reach = below_break_away(robot)
    one, = (one for one in candidates(LIMITS, JOINTS, stuck=reach)
            if one.name == 'below_break_away')
    angle, rate = np.moveaxis(one.trajectory(JOINTS).sample(PERIOD * np.arange(4000))[:, :2], 1, 0)
    assert np.abs(angle).max(axis=0) == pytest.approx(reach, rel=0.05)
    torque = gms.replay(angle, rate, PERIOD, gms.constants_of(robot.friction))
    assert (np.abs(torque).max(axis=0) < 0.55 * robot.friction.forward.static).all()


def test_a_planar_arm_carries_a_point_mass_as_its_jacobian_has_it(robot):
    """M of the arm with a mass m at the tip is M + m J^T J."""
    load, poses = Body(0.5, np.array([0.1, 0.0, 0.0]), np.zeros((3, 3))), np.array(
        [[0.3, -0.7], [-1.0, 0.4]])
    first, second = robot.arm.length[0], robot.arm.length[1] + 0.1
    for pose, without, with_load in zip(poses, mass_matrices(poses, robot.arm), mass_matrices(
            poses, carrying(robot.arm, load)), strict=True):
        a, b = pose[0], pose.sum()
        jacobian = np.array([[-first * np.sin(a) - second * np.sin(b), -second * np.sin(b)],
                             [first * np.cos(a) + second * np.cos(b), second * np.cos(b)]])
        assert with_load == pytest.approx(without + 0.5 * jacobian.T @ jacobian)


def test_a_stated_load_of_a_planar_arm_leaves_no_torque_and_one_beside_it_is_refused(
        robot, gains):
    recording = _recording(loaded(robot, WEIGHT), robot, gains, builders.sinusoid(
        [0.3, 0.3], [3.0, 2.0], ramp_time=1.0))
    left = []
    for load in (None, WEIGHT):
        torque = unexplained(motion_of(replace(recording, operation=Operation(load)), robot),
                             constants_of(robot))[:, 1]
        left.append(np.std(np.convolve(torque, np.full(50, 0.02), 'valid')))  # without noise
    assert left[1] < 0.3 * left[0]
    with pytest.raises(BagError, match='0.1 m beside the line of the last link'):
        motion_of(replace(
            recording, operation=Operation(WEIGHT._replace(com=np.array([0.0, 0.1, 0.0])))), robot)


def test_a_weight_at_the_tip_separates_stiffness_from_torque_gain(robot, gains, swings):
    """Along every motion both predict the same torque; a known mass gives torque its scale."""
    beliefs = beliefs_of([swings], robot, [SOFTER, WEAKER])
    loop = loop_of(beliefs, gains, LIMITS, period=PERIOD)
    motion = next(one for one in candidates(LIMITS, JOINTS, 2.0) if one.name == 'medium_swings')
    weighted, = by_hand([motion], 0.5)
    assert '0.5 kg are hung at the tip' in weighted.words
    without, with_weight = (predicted(beliefs, one, 6.0, loop) for one in (motion, weighted))
    assert with_weight.runs[0].operation.load.mass == 0.5
    assert without.runs[0].operation.load is None
    assert with_weight.odds[0, 1] > without.odds[0, 1] + 3.0
    assert with_weight.odds[1, 0] > without.odds[1, 0] + 3.0


def test_a_weight_costs_minutes_and_is_chosen_where_motions_do_not_do(
        robot, gains, swings, monkeypatch):
    beliefs = replace(beliefs_of([swings], robot, [SOFTER, WEAKER]), odds=np.zeros((2, 2)))
    for alone, by_person in ((60.0, False), (1.0, True)):
        monkeypatch.setattr(
            'gms_flex_control.design.plan.predicted',
            lambda beliefs, one, duration, loop, alone=alone: Prediction(one, duration, (
                60.0 if one.load else alone if one.name == 'tones' else 0.0)
                * np.array([[0.0, 1.0], [1.0, 0.0]]), ()))
        plan = plan_next(beliefs, gains, LIMITS, period=PERIOD, longest=6.0, weight=0.5)
        assert (plan.best.candidate.load is not None) == by_person
        assert ('(by hand, 2 min)' in plan.sentence()) == by_person


def test_a_new_bag_states_the_load_of_the_last_and_the_weight_together(tmp_path):
    for name in ('old', 'new'):
        (tmp_path / name).mkdir()
    (tmp_path / 'old' / 'recording.yaml').write_text('load: {mass: 1.5}\ntemperature: warm\n')
    repeat_conditions(tmp_path / 'old', tmp_path / 'new', ('load', 'temperature'), WEIGHT)
    known = conditions_of(tmp_path / 'new').operation
    assert known.load.mass == pytest.approx(2.0) and known.temperature == 'warm'


def test_information_about_what_is_missing_has_all_else_eliminated():
    """The variance is the inverse of a - b^2 / (c + prior), and of a determinant its logarithm."""
    information = np.array([[5.0, 3.0], [3.0, 2.0]])
    worth = determination._worth(None, information, {0: ('blocks', 'joint1')}, np.array([0.1, 1.]))
    left = 5.0 + 1e-4 - 9.0 / 3.0
    assert worth.information == pytest.approx(np.log(left))
    assert worth.sd == pytest.approx(0.1 / np.sqrt(left))


def test_what_identify_left_open_is_determined_by_the_motion_planned(
        robot, gains, swings, tmp_path, capsys):
    write_recording(tmp_path / 'bag', swings, robot.motors)
    names = {'friction.joint2.stiffness[0]': 'not identifiable',
             'friction.joint2.attraction': 'doubtful', 'friction.joint2.forward.coulomb': 'good'}
    (tmp_path / 'report.json').write_text(json.dumps({
        'sources': [str(tmp_path / 'bag')], 'joints': [{
            'joint': 'joint2', 'estimates': [
                {'name': name, 'standing': standing} for name, standing in names.items()]}]}))
    assert missing_of(json.loads((tmp_path / 'report.json').read_text())) == [
        ('blocks', 'joint2'), ('attraction', 'joint2')]
    arguments = ['next', tmp_path, '--robot', CONFIG / 'robot.yaml', '--limits',
                 CONFIG / 'bridge.yaml', '--longest', '8', '--out', tmp_path / 'plan']
    assert main(list(map(str, arguments))) == 0
    values = json.loads((tmp_path / 'plan' / 'plan.json').read_text())
    assert set(values['missing']) == {'blocks of joint2', 'attraction of joint2'}
    best = values['compared'][0]
    assert best['log_determinant'] == max(one['log_determinant'] for one in values['compared'])
    assert (np.array(best['sd']) < values['sd_before']).all()
    assert 'attraction of joint2 to' in capsys.readouterr().out
    assert (tmp_path / 'plan' / 'trajectory.yaml').is_file()
    assert main([*map(str, arguments), '--weight', '1']) == 2
    assert 'separate explanations of discrepancy' in capsys.readouterr().err
