# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How fast arms in space are simulated as joints are added, beside planar chains and MuJoCo.

    .venv/bin/python -m bench joints

Chains of 1 to 7 flexible joints with six Maxwell blocks each, axes turned by 90 degrees from one
joint to the next (planar chains: all alike), at 1 kHz with 10 substeps: plant, encoders and
controller. MuJoCo steps the same links, motors and springs, ten steps a millisecond, without
friction and controller.
"""

from dataclasses import replace
import json
from pathlib import Path
import tempfile

from bench.speed.timing import interleaved
from gms_flex_control.answer import align
from gms_flex_control.errors import ConfigError, SimulationError
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.friction import FrictionParams, StribeckParams
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import EncoderParams, RobotParams
from gms_flex_control.schema.urdf import robot_urdf
from gms_flex_control.schema.urdf_arm import read_links
from gms_flex_control.simulation import loop
from gms_flex_control.trajectory import builders
import numpy as np

_BLOCKS, _PERIOD_NS, _SUBSTEPS = 6, 1_000_000, 10
_DURATION, _REPEATS = 4.0, 5     # simulated [s], the median of so many
_TURN = 'rpy="0.0 0.0 0.0"', 'rpy="1.5707963267948966 0.0 0.0"'


def planar_robot(n):
    """Return a RobotParams, a planar chain of n flexible joints under gravity."""
    one = np.ones(n)
    steady = StribeckParams(static=1.2 * one, coulomb=one, velocity=0.05 * one, viscous=0.5 * one)
    friction = FrictionParams(
        forward=steady, backward=steady, attraction=20.0 * one,
        stiffness=np.tile(np.geomspace(100.0, 3000.0, _BLOCKS), (n, 1)),
        weight=np.full((n, _BLOCKS), 1.0 / _BLOCKS))
    arm = ArmParams(kind='planar', mass=one, length=0.2 * one, com=0.1 * one, inertia=0.02 * one,
                    motor_inertia=0.2 * one, stiffness=500.0 * one, damping=0.0 * one,
                    gravity=9.81)
    return RobotParams(
        joints=tuple(f'joint{j}' for j in range(n)), motors=tuple(f'motor{j}' for j in range(n)),
        arm=arm, friction=friction, encoder=EncoderParams(counts=0, noise=0, velocity_cutoff=0))


def spatial_robot(robot, path):
    """Return a planar robot with its axes turned out of the plane, its URDF in ``path``."""
    path.write_text(robot_urdf(robot, motors=False).replace(*_TURN))
    links, n = read_links(path, robot.joints), robot.n_joints
    return replace(robot, arm=replace(
        robot.arm, kind='urdf', frames=links.frames, mass=links.mass, com=links.com,
        inertia=links.inertia, length=np.zeros(n), gravity=[0.0, -9.81, 0.0]))


def gains_of(n):
    """Return ControllerParams of n joints."""
    one = np.ones(n)
    return ControllerParams(
        compensation='gms', kd_link=20.0 * one, lambda_link=10.0 * one, kd_motor=20.0 * one,
        lambda_motor=80.0 * one, observer_gain=one, sign_slope=50.0 * one,
        filter_bandwidth=100.0 * one, torque_limit=1e3 * one)


def loop_of(robot):
    """Return a function that runs the closed loop once; raise SimulationError if it diverges."""
    gains, motion = gains_of(robot.n_joints), builders.sinusoid(np.full(robot.n_joints, 0.3), 3.0)

    def run():
        return loop.run(robot, robot, gains, motion, duration=_DURATION,
                        period_ns=_PERIOD_NS, substeps=_SUBSTEPS)
    end = run().true[-1, 0]
    if not np.isfinite(end).all():
        raise SimulationError(f'{robot.n_joints} joints: the simulation diverged')
    return run


def mujoco_of(robot):
    """Return a function that runs MuJoCo once: links, motors and springs alone."""
    import mujoco

    spec = mujoco.MjSpec.from_file(robot.arm.frames.source)
    spec.option.timestep = 1e-9 * _PERIOD_NS / _SUBSTEPS
    spec.option.gravity = robot.arm.gravity
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT
    for joint, motor, inertia, stiffness in zip(
            robot.joints, robot.motors, robot.arm.motor_inertia, robot.arm.stiffness, strict=True):
        body = spec.worldbody.add_body(mass=1e-9, inertia=np.full(3, inertia),
                                       explicitinertial=True)
        body.add_joint(name=motor, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        spring = spec.add_tendon(name=f'{joint}_spring', stiffness=stiffness)
        spring.springlength = [0.0, 0.0]
        spring.wrap_joint(joint, 1.0)
        spring.wrap_joint(motor, -1.0)
    model = spec.compile()
    data = mujoco.MjData(model)

    def run():
        for _ in range(round(_DURATION * 1e9 / _PERIOD_NS)):
            mujoco.mj_step(model, data, nstep=_SUBSTEPS)
    return run


def add_parser(subparsers):
    """Add the verb to the tool's parser."""
    parser = subparsers.add_parser(
        'joints', help='speed of arms in space as joints are added, beside MuJoCo',
        description='Simulate planar chains and chains in space of 1 to 7 flexible joints, and '
                    'the links of the latter with MuJoCo; print simulated seconds per second.')
    parser.add_argument('--most', type=int, default=7, metavar='N',
                        help='joints at most, 1 to 7 (default: %(default)s)')
    parser.add_argument('--json', action='store_true', help='print the numbers as JSON')
    parser.set_defaults(run=run)


def run(args):
    """Measure and print simulated seconds per second, one core; return 0."""
    if not 1 <= args.most <= 7:
        raise ConfigError(f'--most {args.most}: must be from 1 to 7')
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for n in range(1, args.most + 1):
            planar = planar_robot(n)
            robot = spatial_robot(planar, Path(folder) / f'{n}.urdf')
            times = interleaved({
                'planar': loop_of(planar), 'in space': loop_of(robot),
                'MuJoCo, no friction and controller': mujoco_of(robot)}, _REPEATS)
            rows.append({'joints': n} | {name: _DURATION / each for name, each in times.items()})
    print(json.dumps(rows, indent=2) if args.json else align(
        list(rows[0]), [[f'{value:.0f}' for value in row.values()] for row in rows]))
    return 0
