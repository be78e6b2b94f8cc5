# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""An identification made up by hand, from the paper's arm: what reports are tested with."""

from dataclasses import replace

from core_runs import padded
from gms_flex_control.experiment.simulated import scaled_friction
from gms_flex_control.file_io import robot_file
from gms_flex_control.friction import steady_friction
from gms_flex_control.identification import outcome
from gms_flex_control.identification.outcome import BlockCandidate
from gms_flex_control.params.key import of_joints
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.files import load_robot
import numpy as np

WIGGLE = 0.02  # of the values: how far the estimates are off
UNITS = {'static': 'N m', 'coulomb': 'N m', 'velocity': 'rad/s', 'viscous': 'N m s/rad',
         'attraction': 'N m/s', 'stiffness': 'N m/rad', 'weight': '1'}
FLAGGED = {'friction.joint2.stiffness[0]': (
    ('not identifiable', 'at bound'), 'slips only after 0.149 rad; presliding with larger '
    'amplitude would show it')}
ERRORS = outcome.HeldOutErrors(torque_rms=0.004, relative=0.05, coulomb_viscous=0.12,
                               free_run_rms=1.1e-3, free_run_coulomb_viscous=6.4e-3, horizon=0.5,
                               innovation_rms=5e-5, noise_floor=0.001, repeatability=0.0035)


def identification(joints=2, **changes):
    """Return an Identification of the paper's arm, or of its first axis alone."""
    truth = load_robot(robot_file())
    if joints == 1:
        truth = one_axis(truth)
    robot = replace(truth, friction=padded(scaled_friction(truth.friction, 1.0 + WIGGLE)))
    believed = replace(truth, friction=padded(scaled_friction(truth.friction, 0.8)))
    fields = {
        'robot': robot, 'believed': believed, 'sources': ('bags/a', 'bags/b'),
        'joints': tuple(joint_result(robot, truth, j) for j in range(joints)), 'holdouts': (),
        'duration': 412.5, 'period': 2e-3, 'warnings': ('3 samples were lost.',),
        'seconds': 21.7}
    return outcome.Identification(**fields | changes)


def one_axis(robot):
    """Return the first joint alone, as a rigid decoupled axis."""
    rigid = replace(of_joints(robot.arm, [0], kind='decoupled'), stiffness=[np.inf])
    return replace(robot, joints=robot.joints[:1], motors=('',), arm=rigid,
                   friction=robot.friction.of_joints([0]))


def joint_result(robot, truth, j):
    """Return the JointResult of one joint whose parameters are those of ``robot``."""
    rng = np.random.default_rng(7 + j)
    speed = np.geomspace(2e-3, 1.0, 60)
    velocity = np.concatenate([-speed[::-1], speed])
    moving = rng.choice(velocity, 240)
    torque = steady(truth, moving, j) + 2e-3 * rng.standard_normal(240)
    x = np.geomspace(1e-5, 0.1, 40)
    curve = presliding(robot, j, x)
    return outcome.JointResult(
        joint=robot.joints[j], side='motor' if robot.arm.rigid[j] else 'spring',
        estimates=tuple(estimates(robot, j)), curve=(x, curve, 0.97 * curve, 1.03 * curve),
        friction_map=outcome.FrictionMap(moving, torque, rng.random(240) < 0.7),
        steady_velocity=velocity, steady_torque=steady(robot, velocity, j),
        loops=tuple(loop(truth, j, share) for share in (0.4, 0.8)),
        traces=(trace(robot, truth, j, rng),), held_out=ERRORS, warnings=(),
        candidates=(BlockCandidate(2, 1.31, 0.05, False), BlockCandidate(4, 1.02, 0.01, True),
                    BlockCandidate(6, 1.015, 0.0, False)))


def estimates(robot, j):
    """Yield an Estimate of each friction parameter, 4 % wide."""
    prefix = f'friction.{robot.joints[j]}.'
    for name, values in robot_values(robot).items():
        if not name.startswith(prefix):
            continue
        array = isinstance(values, list)
        for i, value in enumerate(values if array else [values]):
            if array and i >= 6:
                continue
            full = f'{name}[{i}]' if array else name
            flags, note = FLAGGED.get(full, ((), ''))
            yield outcome.Estimate(full, UNITS[name.split('.')[-1]], value,
                                   outcome.Interval(0.96 * value, 1.04 * value), flags, note)


def steady(robot, velocity, j):
    """Return the steady friction of one joint (V,)."""
    return steady_friction(np.tile(velocity[:, None], robot.n_joints), robot.friction)[:, j]


def presliding(robot, j, x):
    """Return Eq. (2) from rest: each block a spring up to its share of F_s (D,)."""
    friction = robot.friction
    static = 0.5 * (friction.forward.static[j] + friction.backward.static[j])
    return np.minimum(friction.stiffness[j] * x[:, None], friction.weight[j] * static).sum(axis=1)


def loop(truth, j, share):
    """Return a closed Masing loop up to a share of F_s, measured and modelled."""
    reach = np.interp(share * truth.friction.forward.static[j],
                      presliding(truth, j, np.geomspace(1e-6, 0.3, 4000)),
                      np.geomspace(1e-6, 0.3, 4000))
    x = reach * np.sin(np.linspace(0.0, 2.5 * np.pi, 400))
    way = np.sign(np.gradient(x))
    torque = way * (2.0 * presliding(truth, j, 0.5 * (reach + way * x)) - presliding(
        truth, j, np.array([reach])))
    read = x + 1e-5 * np.sin(np.arange(400))
    return outcome.PreslidingLoop(read, torque, 1.03 * x, f'{share:g} F_s')


def trace(robot, truth, j, rng):
    """Return 8 s of sliding with varying velocity, every fourth second held out."""
    time = 2e-3 * np.arange(4000)
    velocity = 0.3 + 0.2 * np.sin(5.0 * time)
    torque = steady(truth, velocity, j) + 2e-3 * rng.standard_normal(4000)
    return outcome.Trace(time, velocity, torque, steady(robot, velocity, j), time % 4.0 >= 3.0,
                         'sliding 1')
