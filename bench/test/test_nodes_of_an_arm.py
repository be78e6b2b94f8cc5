# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The arm of a URDF in closed loop, in one process and by nodes, and not beyond its limits."""

from dataclasses import replace
from pathlib import Path

from gms_flex_control.experiment.simulated import read_plan, run_plan
from node_harness import compile_the_loop, Lab, write_parameters
import numpy as np
from test_nodes_lockstep import assert_equal, both
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

EXAMPLES = Path(__file__).parents[2] / 'examples' / 'industrial_arm'
FILES = [EXAMPLES / f'{name}.yaml' for name in ('robot', 'controller', 'trajectory')]
ROBOT, GAINS = FILES[:2]


def test_an_arm_of_a_urdf_runs(tmp_path, monkeypatch):
    """The nodes find the URDF beside the parameter file that names it; its springs carry links."""
    extra = write_parameters(tmp_path / 'extra.yaml', 'trajectory: {ramp_time: 1.0}')
    driven, simulated, _ = both(tmp_path, monkeypatch, [*FILES, extra], duration=0.8,
                                compensation='gms', rate=1000.0)
    assert len(driven.time) == 800
    assert np.abs(driven.tau_motor[:, 1]).max() > 10.0  # gravity
    assert_equal(driven, simulated)


def test_the_closed_loop_follows_a_motion_of_all_joints():
    """Model, gravity and friction compensation together; gravity left out is missed."""
    plan = read_plan(FILES, duration=4.0)
    light = replace(plan.model, arm=replace(plan.model.arm, gravity=np.zeros(3)))
    errors = {}
    for name, model in (('right', plan.model), ('without gravity', light)):
        run = run_plan(replace(plan, model=model))
        errors[name] = np.sqrt(np.mean((run.true[:, 0] - run.reference[:, 0]) ** 2, axis=0))
    assert np.ptp(run.reference[:, 0], axis=0).min() > 0.4
    assert errors['right'].max() < 0.002
    assert errors['without gravity'][1] > 5.0 * errors['right'][1]


def test_a_day_long_motion_beyond_the_limits_is_refused_while_the_loop_goes_on(tmp_path):
    """It is checked where it may bend, without the lock that each sample of the loop takes."""
    compile_the_loop(ROBOT, GAINS)  # longer than one waits for a node
    points = [JointTrajectoryPoint(positions=[0.1 * (k % 2)] * 6) for k in range(1, 1001)]
    for k, point in enumerate(points):
        point.time_from_start.sec = 86 * (k + 1)
    points[-1].positions[0] = 50.0
    goal = JointTrajectory(joint_names=[f'joint{j}' for j in range(1, 7)], points=points)
    with Lab(tmp_path) as lab:
        states = lab.hear('states')
        goals = lab.speak(JointTrajectory, '/trajectory/joint_trajectory')
        loop = lab.start('loop_node', files=[ROBOT, GAINS])
        lab.until(lambda: states and goals.get_subscription_count())
        lab.more(states, 100)  # the node knows the publisher as well by then
        goals.publish(goal)
        lab.until(lambda: 'joint trajectory refused: joint1 goes to 50' in loop.printed())
        lab.more(states, 10)
