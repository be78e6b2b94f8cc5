# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The same mechanism in MuJoCo, with MuJoCo's own friction, as a yardstick for speed.

Links are hinges in a row, motors are hinges of their own beside them, and a fixed tendon of
given stiffness is the joint's spring: exactly Eq. (1). Friction is what MuJoCo has: dry
friction by constraint (frictionloss) plus viscous damping, no presliding and no Stribeck curve.
"""

from importlib.util import find_spec

from gms_flex_control.errors import ConfigError
import numpy as np


def available():
    """Return whether the optional package mujoco is installed."""
    return find_spec('mujoco') is not None


def mjcf(robot, timestep):
    """Return a planar chain of flexible joints as MuJoCo's XML (str), else raise ConfigError."""
    arm = robot.arm
    if arm.kind != 'planar' or arm.rigid.any():
        raise ConfigError('the comparison with MuJoCo needs a planar arm with flexible joints '
                          f'only, this one is {arm.kind} with stiffness {arm.stiffness}')
    gx, gy = arm.gravity
    return f"""<mujoco>
      <option timestep="{timestep}" gravity="{gx} {gy} 0" integrator="Euler">
        <flag contact="disable"/>
      </option>
      <worldbody>{_links(robot, 0)}{''.join(_motor(arm, j) for j in range(arm.n_joints))}
      </worldbody>
      <tendon>{''.join(_spring(arm, j) for j in range(arm.n_joints))}</tendon>
      <actuator>{''.join(f'<motor joint="motor{j}"/>' for j in range(arm.n_joints))}</actuator>
    </mujoco>"""


def _links(robot, j):
    """Return link j with those it carries."""
    if j == robot.n_joints:
        return ''
    arm, friction = robot.arm, robot.friction
    offset = arm.length[j - 1] if j else 0.0
    loss = (friction.forward.coulomb[j] + friction.backward.coulomb[j]) / 2
    viscous = (friction.forward.viscous[j] + friction.backward.viscous[j]) / 2
    across = max(arm.inertia[j], 1e-9)  # about the other axes: not moved, must be positive
    return f"""<body pos="{offset} 0 0">
      <joint name="link{j}" type="hinge" axis="0 0 1" frictionloss="{loss}" damping="{viscous}"/>
      <inertial pos="{arm.com[j]} 0 0" mass="{max(arm.mass[j], 1e-9)}"
                diaginertia="{across} {across} {across}"/>{_links(robot, j + 1)}</body>"""


def _motor(arm, j):
    inertia = arm.motor_inertia[j]
    return f"""<body><joint name="motor{j}" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="{inertia} {inertia} {inertia}"/></body>"""


def _spring(arm, j):
    return f"""<fixed stiffness="{arm.stiffness[j]}" damping="{arm.damping[j]}" springlength="0">
      <joint joint="motor{j}" coef="1"/><joint joint="link{j}" coef="-1"/></fixed>"""


class MujocoArm:
    """A MuJoCo simulation with links first and motors after them in its coordinates."""

    def __init__(self, robot, timestep):
        import mujoco

        self._step = mujoco.mj_step
        self.model = mujoco.MjModel.from_xml_string(mjcf(robot, timestep))
        self.data = mujoco.MjData(self.model)
        self._full_m = mujoco.mj_fullM
        self._forward = mujoco.mj_forward
        self._n = robot.n_joints

    def advance(self, command, steps):
        """Hold ``command`` (n_joints,) [N m] for a number of steps."""
        self.data.ctrl[:] = command
        self._step(self.model, self.data, steps)

    def mass_matrix(self, q_link):
        """Return M and J of all coordinates at link angles (n_joints,), shape (2n, 2n)."""
        self.data.qpos[:self._n] = q_link
        self._forward(self.model, self.data)
        out = np.zeros((2 * self._n, 2 * self._n))
        self._full_m(self.model, self.data, out)
        return out
