# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
An arm in space as MuJoCo moves it: links of a URDF, motors on springs, hidden effects.

MuJoCo reads the URDF itself and integrates links and motors. Springs and effects are written out
here a second time; friction is the GMS kernel of the package, which has tests of its own. Steps
are semi-implicit, positions lead by half of one: they are read that much earlier.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

from bench.hidden_robots.kernels.outside import NAMES, outside_torques, PARAMETERS
from bench.hidden_robots.truth import Disturbance
from gms_flex_control import friction as gms
from gms_flex_control.data.recording import Recording
from gms_flex_control.dynamics.chain import mass_matrices
from gms_flex_control.params.robot import RobotParams, WHOLE_ARM
import numpy as np

STEP = 2.5e-4         # of the integration [s]
PERIOD = 2e-3         # of samples and control [s]
COUNTS = 2 ** 20      # of every encoder, per turn
_BANDWIDTH = 12.0     # of the control of the motors [rad/s]
_WAVES = 4            # sinusoids of each joint
_SLOW, _FAST = 0.04, 0.5  # their frequencies [Hz]


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """One effect, its joint or the whole arm, and its parameters."""

    name: str
    joint: str
    values: dict

    def at(self, robot: RobotParams) -> int:
        """Return the number of its joint, -1 of the whole arm."""
        return -1 if self.joint == WHOLE_ARM else robot.joints.index(self.joint)


def with_change(robot: RobotParams, hidden: Hidden) -> RobotParams:
    """Return a robot with a hidden effect if that is another value of a parameter."""
    arm, friction, j = robot.arm, robot.friction, hidden.at(robot)
    factor = np.ones(robot.n_joints)
    factor[j] += hidden.values.get('ratio', 0.0)
    if hidden.name == 'stiffness_error':
        return replace(robot, arm=replace(arm, stiffness=factor * arm.stiffness))
    if hidden.name == 'motor_inertia_error':
        return replace(robot, arm=replace(arm, motor_inertia=factor * arm.motor_inertia))
    if hidden.name == 'link_inertia_error':
        return replace(robot, arm=arm.scaled(factor))
    if hidden.name == 'tip_payload':
        mass, com, inertia = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
        extra, end = hidden.values['mass'], arm.frames.end
        mass[-1] += extra
        com[-1] = (arm.mass[-1] * arm.com[-1] + extra * end) / mass[-1]
        for m, place in ((arm.mass[-1], arm.com[-1]), (extra, end)):
            away = place - com[-1]
            inertia[-1] += m * (away @ away * np.eye(3) - np.outer(away, away))
        return replace(robot, arm=replace(arm, mass=mass, com=com, inertia=inertia))
    if hidden.name == 'gravity_tilt':
        tilt, way = hidden.values['tilt'], hidden.values['direction']
        down = np.array([np.sin(tilt) * np.cos(way), np.sin(tilt) * np.sin(way), -np.cos(tilt)])
        return replace(robot, arm=replace(arm, gravity=np.linalg.norm(arm.gravity) * down))
    if hidden.name in ('coulomb_error', 'viscous_error'):
        names = ('static', 'coulomb') if hidden.name == 'coulomb_error' else ('viscous',)
        return replace(robot, friction=friction.each_way(
            lambda steady: steady.scaled(**dict.fromkeys(names, factor))))
    return robot


def model_of(robot: RobotParams):
    """Return MuJoCo's model: links in the order of the joints, then motors of flexible ones."""
    import mujoco

    arm = robot.arm
    spec = mujoco.MjSpec.from_file(arm.frames.source)
    spec.option.timestep, spec.option.gravity = STEP, arm.gravity
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    for inertia in arm.motor_inertia[~arm.rigid]:
        body = spec.worldbody.add_body(mass=1e-9, inertia=np.full(3, inertia),
                                       explicitinertial=True)
        body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    model = spec.compile()
    model.dof_armature[:robot.n_joints] = np.where(arm.rigid, arm.motor_inertia, 0.0)
    return model


def with_links(model, robot: RobotParams, described: RobotParams) -> None:
    """Scale and move MuJoCo's bodies as the robot's links differ from those of the URDF."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for j in range(robot.n_joints):
        body = model.jnt_bodyid[j]
        ratio = robot.arm.mass[j] / described.arm.mass[j]
        moved = robot.arm.com[j] - described.arm.com[j]
        tensor = robot.arm.inertia[j]
        model.body_mass[body] *= ratio
        # our frame lies at the joint with the axis along z: turn what is new into the body's
        turn = _frame_turn(model, data, j, described)
        model.body_ipos[body] += turn @ moved
        values, vectors = np.linalg.eigh(turn @ tensor @ turn.T)
        if np.linalg.det(vectors) < 0.0:
            vectors[:, 0] *= -1.0
        model.body_inertia[body] = values
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, vectors.ravel())
        model.body_iquat[body] = quaternion
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _frame_turn(model, data, j, described):
    """Return the rotation from the package's frame of link j to MuJoCo's body frame."""
    frame = np.eye(3)
    for k in range(j + 1):
        frame = frame @ described.arm.frames.rotation[k]
    return data.xmat[model.jnt_bodyid[j]].reshape(3, 3).T @ frame


def recording_of(robot: RobotParams, described: RobotParams, hidden: Sequence[Hidden] = (), *,
                 seconds: float, noise: float, motors_only: bool, seed: int,
                 disturbance: Disturbance | None = None) -> Recording:
    """
    Return the recording of a robot under PD control of its motors along sinusoids.

    ``described`` is the robot of the URDF, from which ``robot`` differs; white torque noise, in
    commands and efforts alike, is ``noise`` of Coulomb friction; with ``motors_only`` links of
    flexible joints are not read.
    """
    import mujoco

    true, rng = reduce(with_change, hidden, robot), np.random.default_rng(seed)
    model = model_of(true)
    with_links(model, true, described)
    data, n, arm = mujoco.MjData(model), robot.n_joints, true.arm
    soft = np.flatnonzero(~arm.rigid)
    reference = reference_of(robot, seconds, rng)
    mass = np.diag(mass_matrices(np.zeros((1, n)), described.arm)[0]) + np.where(
        arm.rigid, 0.0, arm.motor_inertia)
    samples, parts = len(reference), round(PERIOD / STEP)
    link, motor, torque = np.full((3, samples, n), np.nan)
    friction = gms.constants_of(true.friction)
    state, tau = gms.init(true.friction), np.zeros(n)
    data.qpos[:n] = reference[0, 0]
    mujoco.mj_forward(model, data)
    data.qpos[n:] = reference[0, 0][soft] + data.qfrc_bias[soft] / arm.stiffness[soft]
    before, effect = data.qpos[:n].copy(), _Acting(hidden, true, disturbance)
    scale = 2.0 * np.pi / COUNTS
    command = np.zeros(n)
    for k in range(samples):
        now, rate = (np.where(arm.rigid, values[:n], _spread(values[n:], soft, n))
                     for values in (data.qpos - 0.5 * STEP * data.qvel, data.qvel))
        link[k] = data.qpos[:n] - 0.5 * STEP * data.qvel[:n]
        motor[k, soft] = now[soft]
        torque[k] = command
        wanted = reference[k]
        sag = np.where(arm.rigid, 0.0, data.qfrc_bias[:n] / np.where(
            arm.rigid, 1.0, described.arm.stiffness))
        command = (mass * (_BANDWIDTH ** 2 * (wanted[0] + sag - now)
                           + 2.0 * _BANDWIDTH * (wanted[1] - rate) + wanted[2])
                   + data.qfrc_bias[:n])
        for part in range(parts):
            acted = effect.commanded(command)
            turned = data.qpos[:n] - before
            before = data.qpos[:n].copy()
            gms.advance(state, turned, data.qvel[:n].copy(), STEP, friction)
            gms.total(state, data.qvel[:n].copy(), friction, tau)
            torsion = np.zeros(n)
            torsion[soft] = data.qpos[n:] - data.qpos[soft]
            spring = np.where(arm.rigid, 0.0, effect.spring(torsion, np.where(
                arm.rigid, 0.0, arm.stiffness)))
            outside = effect.outside(k, part, data.qpos[:n], data.qvel[:n], now, tau)
            drive = acted + effect.on_motor(now) + outside[1]
            moved = np.where(arm.rigid, drive, spring)
            carried = moved - np.where(arm.rigid, arm.motor_inertia * data.qacc[:n], 0.0)
            data.qfrc_applied[:n] = (moved - effect.friction(tau, data.qpos[:n], carried)
                                     + effect.on_link(data.qvel[:n]) + outside[0])
            data.qfrc_applied[n:] = (drive - spring)[soft]
            mujoco.mj_step(model, data)
    level = 0.5 * (robot.friction.forward.coulomb + robot.friction.backward.coulomb)
    torque += noise * level * rng.standard_normal(torque.shape)
    torque[0] = torque[1]
    nothing = np.full((samples, n), np.nan)
    read = scale * np.round(link / scale)
    if motors_only:
        read[:, soft] = np.nan
    return Recording(
        joints=robot.joints, time=PERIOD * np.arange(samples), q_link=read, dq_link=nothing,
        q_motor=scale * np.round(motor / scale), dq_motor=nothing, tau_motor=torque,
        command=np.concatenate([torque[1:], torque[-1:]]),  # efforts are of the sample that ended
        reference=np.full((samples, 5, n), np.nan), friction_hat=nothing,
        source=f'hidden arm, seed {seed}')


def _spread(values, places, n):
    out = np.zeros(n)
    out[places] = values
    return out


def reference_of(robot, seconds, rng):
    """Return angle, rate and acceleration (T, 3, n) of sinusoids within ranges and speeds."""
    frames, n = robot.arm.frames, robot.n_joints
    time = PERIOD * np.arange(round(seconds / PERIOD))
    frequency = np.exp(rng.uniform(np.log(_SLOW), np.log(_FAST), (_WAVES, n)))
    omega, phase = 2.0 * np.pi * frequency, rng.uniform(0.0, 2.0 * np.pi, (_WAVES, n))
    half = 0.5 * np.minimum(frames.upper - frames.lower, 2.0 * np.pi)
    size = 0.8 * np.minimum(half, 1.2) / _WAVES * np.ones((_WAVES, n))
    fastest = (size * omega).sum(axis=0) / np.minimum(frames.velocity, 1e3)
    size /= np.maximum(1.0, fastest)
    turn = omega * time[:, None, None] + phase
    middle = np.clip(0.0, frames.lower + 0.5 * half, frames.upper - 0.5 * half)
    return np.stack([middle + (size * np.sin(turn)).sum(axis=1),
                     (size * omega * np.cos(turn)).sum(axis=1),
                     (-size * omega ** 2 * np.sin(turn)).sum(axis=1)], axis=1)


class _Acting:
    """What hidden effects add while the robot moves; `with_change` has the others."""

    def __init__(self, hidden, robot, disturbance):
        self._effects = [(one.name, one.at(robot), one.values) for one in hidden]
        self._before, self._turned = None, np.zeros(robot.n_joints)  # -1 to 1, of load friction
        self._disturbance, self._held, self._outside = disturbance, [], np.zeros(PARAMETERS)
        if disturbance:
            self._outside[:len(disturbance.values)] = disturbance.values

    def commanded(self, command):
        """Return the torque (n,) of the drives in the next step."""
        out = command.copy()
        self._held.append(command)
        for name, j, p in self._effects:
            if name == 'torque_gain':
                out[j] *= 1.0 + p['gain_error']
            elif name == 'input_delay':
                out[j] = self._held[max(len(self._held) - 1 - round(p['delay'] / STEP), 0)][j]
        return out

    def on_motor(self, angle):
        """Return further torques (n,) on the motors."""
        out = np.zeros(len(angle))
        for name, j, p in self._effects:
            if name == 'torque_ripple':
                out[j] += p['amplitude'] * np.sin(p['order'] * angle[j] + p['phase'])
        return out

    def spring(self, torsion, stiffness):
        """Return the torques (n,) of the springs."""
        torsion = torsion.copy()
        for name, j, p in self._effects:
            if name == 'backlash':
                torsion[j] -= np.clip(torsion[j], -p['half_gap'], p['half_gap'])
        return stiffness * torsion

    def friction(self, tau, angle, carried):
        """Return the friction of all joints (n,), from ``tau`` of the robot without effects."""
        tau, before, self._before = tau.copy(), self._before, angle.copy()
        for name, j, p in self._effects:
            if name == 'position_friction':
                tau[j] *= 1.0 + p['ratio'] * np.cos(p['order'] * angle[j] + p['phase'])
            elif name == 'load_friction' and before is not None:
                self._turned[j] = np.clip(
                    self._turned[j] + (angle[j] - before[j]) / p['reach'], -1.0, 1.0)
                tau[j] += p['ratio'] * abs(carried[j]) * self._turned[j]
        return tau

    def on_link(self, rate):
        """Return further torques (n,) on the links."""
        out = np.zeros(len(rate))
        for name, j, p in self._effects:
            if name == 'quadratic_drag':
                out[j] -= p['drag'] * abs(rate[j]) * rate[j]
            elif name == 'constant_link_torque':
                out[j] += p['bias']
        return out

    def outside(self, k, part, angle, rate, motor, tau):
        """Return torques (2, n) on links and motors that are outside the catalogue."""
        out, one = np.zeros((2, len(rate))), self._disturbance
        if one:
            j = one.joint
            out[:, j] = outside_torques(
                NAMES.index(one.name), self._outside, k * PERIOD + part * STEP, angle[j], rate[j],
                motor[j], tau[j], one.drawn[k])
        return out
