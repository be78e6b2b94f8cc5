# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
How time and memory of identify and discrepancy grow with joints and with minutes of data.

    .venv/bin/python -m bench growth --out growth

Recordings at 500 Hz of chains of flexible joints with six Maxwell blocks each, axes turned by 90
degrees from one joint to the next, each joint on a sinusoid of its own.
Every case is a process that is given the recording, so that memory is its own.
"""

from dataclasses import replace
from functools import partial
import json
from multiprocessing import get_context
from pathlib import Path
import resource
import tempfile
import time
from typing import NamedTuple

from gms_flex_control.answer import align
from gms_flex_control.cli.options import add_verb, option, Verb
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.errors import ConfigError
from gms_flex_control.experiment.simulated import Plan, simulate
from gms_flex_control.file_io import write_text
from gms_flex_control.identification.identify import identify
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import (
    EncoderParams,
    FrictionParams,
    RobotParams,
    StribeckParams,
)
from gms_flex_control.schema.urdf import robot_urdf
from gms_flex_control.schema.urdf_arm import read_links
from gms_flex_control.trajectory import builders
from matplotlib.figure import Figure
import numpy as np

_BLOCKS, _PERIOD_NS, _SUBSTEPS = 6, 2_000_000, 20
_TURN = 'rpy="0.0 0.0 0.0"', 'rpy="1.5707963267948966 0.0 0.0"'
_AMPLITUDE, _SLOWEST, _FASTEST = 0.5, 7.0, 3.0  # of the motion [rad], periods of joints [s]
_COUNTS = 1e6         # of encoders, per revolution
_JOINTS, _MINUTES = (1, 2, 3, 4, 5, 6), (0.5, 1.0, 2.0, 4.0)
_USUAL_JOINTS, _USUAL_MINUTES = 6, 1.0
VERBS = 'identify', 'discrepancy'


class Cost(NamedTuple):
    """What one case takes."""

    verb: str
    joints: int
    minutes: float
    seconds: float
    processor: float   # s, of all cores
    megabytes: float


def planar_robot(n: int) -> RobotParams:
    """Return a planar chain of n flexible joints under gravity."""
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


def spatial_robot(robot: RobotParams, path: Path) -> RobotParams:
    """Return a planar robot with its axes turned out of the plane, its URDF in ``path``."""
    path.write_text(robot_urdf(robot, motors=False).replace(*_TURN))
    links, n = read_links(path, robot.joints), robot.n_joints
    return replace(robot, arm=replace(
        robot.arm, kind='urdf', frames=links.frames, mass=links.mass, com=links.com,
        inertia=links.inertia, length=np.zeros(n), gravity=[0.0, -9.81, 0.0]))


def gains_of(n: int) -> ControllerParams:
    """Return gains of n joints."""
    one = np.ones(n)
    return ControllerParams(
        compensation='gms', kd_link=10.0 * one, lambda_link=5.0 * one, kd_motor=10.0 * one,
        lambda_motor=40.0 * one, observer_gain=one, sign_slope=50.0 * one,
        filter_bandwidth=50.0 * one, torque_limit=1e3 * one)


def recorded(joints: int, minutes: float):
    """Return a robot in space and a recording of it."""
    with tempfile.TemporaryDirectory() as folder:
        robot = spatial_robot(planar_robot(joints), Path(folder) / 'chain.urdf')
    robot = replace(robot, encoder=replace(robot.encoder, counts=_COUNTS))
    motion = builders.sinusoid(np.full(joints, _AMPLITUDE),
                               np.linspace(_SLOWEST, _FASTEST, joints))
    return robot, simulate(Plan(
        robot=robot, model=robot, gains=gains_of(joints), trajectory=motion, motion='sinusoid',
        duration=60.0 * minutes, q_link=np.zeros(joints), period_ns=_PERIOD_NS,
        substeps=_SUBSTEPS, seed=0))


def cost_of(verb: str, minutes: float, robot, recording) -> Cost:
    """Return the Cost of a verb on one recording."""
    begun, worked = time.monotonic(), time.process_time()
    if verb == 'identify':
        identify([recording], robot)
    else:
        find_discrepancy([recording], robot)
    return Cost(verb, robot.n_joints, minutes, time.monotonic() - begun,
                time.process_time() - worked,
                resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)


def draw(costs, path) -> None:
    """Draw seconds and memory over joints and over minutes as PNG."""
    figure = Figure(figsize=(9.0, 5.0), layout='constrained')
    panels = figure.subplots(2, 2, sharex='col', sharey='row')
    for row, (value, words) in zip(panels, (('seconds', 'time [s]'),
                                            ('megabytes', 'memory [MB]')), strict=True):
        for axes, (over, label, fixed) in zip(row, (
                ('joints', f'joints, {_USUAL_MINUTES:g} min', ('minutes', _USUAL_MINUTES)),
                ('minutes', f'minutes, {_USUAL_JOINTS} joints', ('joints', _USUAL_JOINTS))),
                strict=True):
            for verb in VERBS:
                own = sorted((getattr(one, over), getattr(one, value)) for one in costs
                             if one.verb == verb and getattr(one, fixed[0]) == fixed[1])
                if own:
                    axes.plot(*zip(*own, strict=True), 'o-', label=verb)
            axes.set(xlabel=label, ylabel=words)
            axes.spines[['top', 'right']].set_visible(False)
        row[0].set_ylim(0.0, 1.05 * max(getattr(one, value) for one in costs))
    panels[0][0].legend(frameon=False)
    figure.savefig(path, dpi=100)


VERB = Verb(
    'growth', lambda args: run(args),
    'time and memory of identify and discrepancy by joints and minutes',
    'Measure identify and discrepancy on recordings of 1 to 6 joints in space and of half a '
    'minute to four; print and draw time and memory.', (
        option('--verbs', nargs='+', choices=VERBS, default=list(VERBS)),
        option('--joints', nargs='*', type=int, default=list(_JOINTS), metavar='N'),
        option('--minutes', nargs='*', type=float, default=list(_MINUTES), metavar='M'),
        option('--out', metavar='DIR', help='growth.json and growth.png')), ())
add_parser = partial(add_verb, VERB)


def run(args) -> int:
    """Measure, print and draw; return 0."""
    if not (set(args.joints) <= set(_JOINTS) and all(m > 0.0 for m in args.minutes)):
        raise ConfigError(f'--joints takes 1 to {max(_JOINTS)}, --minutes more than 0; got '
                          f'{args.joints} and {args.minutes}')
    cases = dict.fromkeys((*((n, _USUAL_MINUTES) for n in args.joints),
                           *((_USUAL_JOINTS, m) for m in args.minutes)))
    costs = []
    with get_context('spawn').Pool(1, maxtasksperchild=1) as pool:
        made = pool.apply(recorded, next(iter(cases)))  # compiled once, before time is taken
        for verb in args.verbs:
            pool.apply(cost_of, (verb, 0.0, *made))
        for joints, minutes in cases:
            made = pool.apply(recorded, (joints, minutes))
            costs += [pool.apply(cost_of, (verb, minutes, *made)) for verb in args.verbs]
    costs.sort(key=lambda one: args.verbs.index(one.verb))
    print(align(['verb', 'joints', 'minutes', 'time [s]', 'processor [s]', 'memory [MB]'], [
        [one.verb, f'{one.joints}', f'{one.minutes:g}', f'{one.seconds:.1f}',
         f'{one.processor:.1f}', f'{one.megabytes:.0f}'] for one in costs]))
    if args.out:
        out = Path(args.out)
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / 'growth.json', json.dumps(
            [one._asdict() for one in costs], indent=1) + '\n')
        draw(costs, out / 'growth.png')
    return 0
