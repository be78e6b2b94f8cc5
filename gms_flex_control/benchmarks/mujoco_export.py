# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How well the exported MJCF moves as the robot: free runs in MuJoCo beside our own.

A robot with one effect hidden in it is recorded by an integrator that neither shares. From its
measured states both models run freely under the recorded torques; the error against the
measured angles of one is divided by that of the other.
"""

from collections.abc import Iterator
from dataclasses import replace

from gms_flex_control.benchmarks.mujoco_arm import available
from gms_flex_control.benchmarks.timing import Measurement
from gms_flex_control.discrepancy.free_run import free_runs, HORIZON, STRIDE
from gms_flex_control.discrepancy.motion import Motion, motion_of
from gms_flex_control.effects.base import Change
from gms_flex_control.effects.registry import find
from gms_flex_control.effects.table import with_changes
from gms_flex_control.exports.mujoco import EFFECTS, MUJOCO
from gms_flex_control.exports.target import export, simplified
from gms_flex_control.hidden.cases import available_effects, make_case
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.simulation import plant
import numpy as np

LEFT_OUT = ('stribeck', 'viscous_direction')  # what MuJoCo lacks of every robot's friction
TARGET = 1.2         # times our own free-run error
_DURATION = 20.0     # of a recording [s]


def exportable() -> list[str]:
    """Return the effects that the bench can hide and MuJoCo can express, in a fixed order."""
    return [name for name in available_effects()
            if name in EFFECTS or issubclass(find(name), Change)]


def measure(_robot, _gains, quick: bool = False) -> Iterator[Measurement]:
    """Yield the ratio of free-run errors of each exportable effect; nothing without MuJoCo."""
    if not available():
        return
    for seed, name in enumerate(exportable()):
        whole, exported = ratios(name, seed, 0.3 * _DURATION if quick else _DURATION)
        yield Measurement(
            suite='export', name=f'{name}: MuJoCo / our free run', value=whole, unit='',
            target=TARGET, at_least=False,
            note=f'{exported:.3f} of the same model without {" and ".join(LEFT_OUT)}')


def ratios(name: str, seed: int, duration: float) -> tuple[float, float]:
    """
    Return free-run errors of the MJCF over ours, for one hidden effect.

    Parameters
    ----------
    name : str
        The effect.
    seed : int
        Of the robot.
    duration : float
        Of the recording [s].

    Returns
    -------
    whole, exported : float
        Over ours of the whole model, and of the model with what MuJoCo lacks left out.

    """
    case = make_case('single', seed, effect=name, duration=duration, plant='soft')
    robot = replace(case.nominal, effects=case.truth.effects)
    motion = motion_of(case.recording, robot)
    reduced = simplified(with_changes(robot), LEFT_OUT)
    theirs = rms(*mujoco_runs(motion, reduced, export(robot, MUJOCO, LEFT_OUT)))
    return tuple(theirs / rms(*free_runs(motion, plant.constants_of(one))[1:])
                 for one in (robot, reduced))


def rms(*errors: np.ndarray) -> float:
    """Return the root mean square of arrays together."""
    return float(np.sqrt(np.mean([np.mean(error ** 2) for error in errors])))


def mujoco_runs(motion: Motion, robot: RobotParams, mjcf: str) -> tuple[np.ndarray, np.ndarray]:
    """
    Return how far free runs in MuJoCo stray from a recording.

    Parameters
    ----------
    motion : Motion
        The recording, of n joints.
    robot : RobotParams
        Names the joints.
    mjcf : str
        The exported model.

    Returns
    -------
    link, motor : ndarray, shape (S, H, n)
        Measured minus simulated angles [rad], from the starts of `free_runs` on.

    """
    import mujoco
    model = mujoco.MjModel.from_xml_string(mjcf)
    data = mujoco.MjData(model)
    period, step = motion.fine_period, model.opt.timestep
    horizon, stride = round(HORIZON / period), round(STRIDE / period)
    starts = np.arange(stride, len(motion.fine_time) - horizon, stride)
    sides = [model.joint(name).qposadr[0] for name in robot.joints]
    motors = [model.joint(motor or joint).qposadr[0]
              for joint, motor in zip(robot.joints, robot.motors, strict=True)]
    q, v = np.zeros((2, len(motion.fine_time), model.nq))
    for columns, first in ((sides, 0), (motors, 3)):
        q[:, columns], v[:, columns] = motion.fine_states[:, first], motion.fine_states[:, first + 1]
    rests, lagged = _yielded(model, q), _lagged(model, motion.command, period)
    out = np.empty((2, len(starts), horizon, robot.n_joints))
    ahead = 0.5 * step                # positions of semi-implicit Euler lead by half a step
    for run, start in enumerate(starts):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel = q[start] + ahead * v[start], v[start]
        data.plastic, data.act = rests[start], lagged[start]
        _remember(mujoco, model, data, motion.command, start, period)
        for k in range(horizon):
            place = data.qpos - ahead * data.qvel
            out[:, run, k] = place[sides], place[motors]
            data.ctrl = motion.command[start + k]
            mujoco.mj_step(model, data, round(period / step))
    rows = starts[:, None] + np.arange(horizon)
    return motion.readings[rows, 0] - out[0], motion.readings[rows, 1] - out[1]


def _yielded(model, q):
    """Return where yielding tendons rest along a motion (T, nq), shape (T, 2 x tendons)."""
    tendons = np.flatnonzero(model.tendon_plasticadr >= 0)
    pull = np.zeros((len(tendons), model.nq))
    for row, tendon in enumerate(tendons):
        wraps = slice(model.tendon_adr[tendon],
                      model.tendon_adr[tendon] + model.tendon_num[tendon])
        pull[row, model.jnt_qposadr[model.wrap_objid[wraps]]] = model.wrap_prm[wraps]
    length, reach = q @ pull.T, model.tendon_springyield[tendons]
    rest, rests = np.zeros(len(tendons)), np.zeros((len(q), model.nplastic))
    for k, now in enumerate(length):
        rest = np.clip(rest, now - reach, now + reach)
        rests[k, model.tendon_plasticadr[tendons]] = rest
        rests[k, model.tendon_plasticadr[tendons] + 1] = rest
    return rests


def _lagged(model, command, period):
    """Return the activations of lagging actuators before each command, shape (T, na)."""
    lagging = np.flatnonzero(model.actuator_actadr >= 0)
    out = np.zeros((len(command), model.na))
    share = -np.expm1(-period / model.actuator_dynprm[lagging, 0])
    for k in range(1, len(command)):
        out[k] = out[k - 1] + share * (_clipped(model, command[k - 1])[lagging] - out[k - 1])
    return out


def _clipped(model, command):
    limited = model.actuator_ctrllimited.astype(bool)
    return np.where(limited, np.clip(command, *model.actuator_ctrlrange.T), command)


def _remember(mujoco, model, data, command, start, period):
    """Fill the histories of delayed actuators with the commands before ``start``."""
    for j in np.flatnonzero(model.actuator_delay > 0.0):
        count = model.actuator_history[j, 0]
        times = model.opt.timestep * np.arange(-count, 0.0)
        rows = np.maximum(start + np.floor(times / period + 1e-6).astype(int), 0)
        mujoco.mj_initCtrlHistory(model, data, int(j), times, command[rows, j])
