# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
How well the exported MJCF moves as the robot: free runs in MuJoCo beside our own.

A robot with one effect is recorded by an integrator that neither shares. From its measured states
both models run freely under the recorded torques; the error against the measured angles of one is
divided by that of the other.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

from bench.hidden_robots import sizes, truth
from bench.hidden_robots.cases import make_case
from bench.speed.mujoco_arm import available
from bench.speed.timing import Measurement
from gms_flex_control.data.recording import Recording
from gms_flex_control.discrepancy.gap import free_runs, HORIZON, STRIDE
from gms_flex_control.discrepancy.motion import Motion, motion_of
from gms_flex_control.effects.base import Change
from gms_flex_control.effects.registry import find, names
from gms_flex_control.effects.table import with_changes
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema.mujoco import EFFECTS, target
from gms_flex_control.schema.target import export, simplified
from gms_flex_control.simulation import plant
import numpy as np

COULOMB = ('stribeck',)                            # what is left out for MuJoCo, either of these
LUGRE = ('attraction', 'stribeck_direction')
TARGET = 1.2         # times our own free-run error
_DURATION, _QUICK = 20.0, 4.0  # of a recording [s]
_SEED = 1            # of the robot and of the sizes of effects
# sizes of effects that hidden robots do not have, as in hidden.sizes
_SIZES = sizes.MAIN | {
    'friction_hysteresis': lambda _, k: {'force': 0.3 * k.coulomb, 'reach': 0.05},
    'viscous_asymmetry': lambda _, k: {'slope': 0.5 * k.viscous}}


def exportable() -> list[str]:
    """Return the effects that MuJoCo can express, sorted."""
    return [name for name in names() if name in EFFECTS or issubclass(find(name), Change)]


def measure(_robot, _gains, quick: bool = False) -> Iterator[Measurement]:
    """
    Yield ratios of free-run errors, MuJoCo's over ours; nothing without MuJoCo.

    One of each exportable effect, at Coulomb friction in both models; then those of the whole
    model with its Stribeck curve, on a slow motion, where the curve matters most.
    """
    if not available():
        return
    duration = _QUICK if quick else _DURATION
    for name in exportable():
        yield Measurement(suite='export', name=f'{name}: MuJoCo / our free run', unit='',
                          value=ratio(name, duration, COULOMB, COULOMB), target=TARGET,
                          at_least=False)
    for without, reported in ((LUGRE, 'as LuGre'), (COULOMB, 'left out')):
        yield Measurement(suite='export', name=f'Stribeck curve {reported}, slow motion', unit='',
                          value=ratio('stribeck_error', duration, without, motion='slow'),
                          note='over our whole model')


def ratio(name: str, duration: float, without: tuple, lacking: tuple = (),
          motion: str = 'sinusoid') -> float:
    """
    Return the free-run error of an exported robot with an effect in MuJoCo over ours.

    ``without`` is left out for MuJoCo, ``lacking`` of our own model; ``motion`` is one of
    `hidden_robots.motions.MOTIONS`.
    """
    robot, recording = recorded(name, duration, motion)
    measured = motion_of(recording, robot)
    ours = plant.constants_of(simplified(with_changes(robot), lacking))
    return (rms(mujoco_runs(measured, robot, export(robot, target(), without)))
            / rms(free_runs(measured, ours)[1:]))


@lru_cache(maxsize=1)
def _bare(duration, motion):
    """Return a Case without effects, and the sizes of its motion (Figures of each joint)."""
    case = make_case('clean', _SEED, plant='soft', motion=motion, duration=duration)
    run = truth.simulate(case.truth.robot, case.nominal, case.gains, case.recording.reference,
                         period=case.recording.period)
    return case, sizes.figures_of(case.truth.robot, run, case.recording.period)


@lru_cache(maxsize=1)
def recorded(name: str, duration: float, motion: str) -> tuple[RobotParams, Recording]:
    """Return a robot with an effect, all of it known, and a recording of it."""
    case, figures = _bare(duration, motion)
    rng, given = np.random.default_rng(_SEED), case.recording
    joint = sizes.place(rng, name, given.joints)
    spec = sizes.spec(name, joint, given.joints, _SIZES[name](rng, figures[joint]))
    robot = replace(case.truth.robot, effects=(spec,))
    run = truth.simulate(robot, case.nominal, case.gains, given.reference, period=given.period)
    unknown = np.full_like(given.q_link, np.nan)
    q_link, _, q_motor, _ = np.moveaxis(run.measured, 1, 0)
    return robot, replace(
        given, q_link=q_link, dq_link=unknown, q_motor=q_motor, dq_motor=unknown,
        tau_motor=unknown, command=run.command, friction_hat=run.friction_hat, source=name)


def rms(errors: tuple[np.ndarray, ...]) -> float:
    """
    Return the root mean square of arrays (S, H, n) together, the first run left out.

    In our own first run effects that remember something begin with nothing.
    """
    return float(np.sqrt(np.mean([np.mean(error[1:] ** 2) for error in errors])))


def mujoco_runs(motion: Motion, robot: RobotParams, mjcf: str) -> tuple[np.ndarray, np.ndarray]:
    """
    Return measured minus simulated angles of free runs in MuJoCo, links and motors (S, H, n).

    Of a Motion and the exported model ``mjcf`` (str), from the starts of `free_runs` on [rad].
    """
    import mujoco
    model = mujoco.MjModel.from_xml_string(mjcf)
    led, free = mujoco.MjData(model), mujoco.MjData(model)
    period, step = motion.samples.period, model.opt.timestep
    horizon, stride = round(HORIZON / period), round(STRIDE / period)
    starts = range(stride, len(motion.samples.time) - horizon, stride)
    sides = [[model.joint(name).qposadr[0] for name in names] for names in (
        robot.joints, [motor or joint for joint, motor in zip(
            robot.joints, robot.motors, strict=True)])]
    out = np.empty((2, len(starts), horizon, robot.n_joints))
    ahead = 0.5 * step                # positions of semi-implicit Euler lead by half a step
    for k in range(starts[-1] + 1):   # what yields, lags and waits follows the measured motion
        for side, rows in zip(sides, (slice(0, 2), slice(3, 5)), strict=True):
            angle, rate = motion.samples.states[k, rows]
            led.qpos[side], led.qvel[side] = angle + ahead * rate, rate
        if k in starts:
            mujoco.mj_copyData(free, model, led)
            for i in range(horizon):
                place = free.qpos - ahead * free.qvel
                out[:, starts.index(k), i] = place[sides]
                free.ctrl = motion.samples.command[k + i]
                mujoco.mj_step(model, free, round(period / step))
        led.ctrl = motion.samples.command[k]
        mujoco.mj_step(model, led, round(period / step))
    rows = np.array(starts)[:, None] + np.arange(horizon)
    return motion.samples.readings[rows, 0] - out[0], motion.samples.readings[rows, 1] - out[1]
