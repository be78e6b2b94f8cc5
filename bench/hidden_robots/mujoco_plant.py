# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The hidden robot in MuJoCo: its links and motors, its integrator, its gravity.

Springs, friction and effects are torques from the kernels of this package, held over a step. Its
steps are semi-implicit, positions lead by half of one: they are read that much earlier, lest every
robot had recordings late by 50 microseconds.
Two effects are left out, see `truth.CARRIED` and `truth.BASE`: they change the mass matrix.
"""

from importlib.util import find_spec

from bench.hidden_robots.kernels import loop
from gms_flex_control.control import cascade
from gms_flex_control.effects import table as effect_table
from gms_flex_control.errors import ConfigError
from gms_flex_control.records import boxed
import numpy as np

STEP = 1e-4  # of the integration, about [s]


def available():
    """Return whether the optional package mujoco is installed."""
    return find_spec('mujoco') is not None


def mjcf(arm, timestep):
    """
    Return links and motors as MuJoCo's XML (str): the links' angles first, then the motors'.

    ConfigError if the arm is no chain in a plane with flexible joints; ``timestep`` in s.
    """
    if arm.kind != 'planar' or arm.rigid.any():
        raise ConfigError('MuJoCo takes the place of a planar arm with flexible joints only, '
                          f'this one is {arm.kind} with stiffness {arm.stiffness}')
    links = ''
    for j in reversed(range(arm.n_joints)):
        links = _body(arm.length[j - 1] if j else 0.0, arm.com[j], arm.mass[j], arm.inertia[j],
                      links)
    motors = ''.join(_body(0.0, 0.0, 1e-3, inertia) for inertia in arm.motor_inertia)
    gx, gy = arm.gravity
    return (f'<mujoco><option timestep="{timestep:.17g}" gravity="{gx:.17g} {gy:.17g} 0" '
            'integrator="implicitfast"><flag contact="disable"/></option>'
            f'<worldbody>{links}{motors}</worldbody></mujoco>')


def _body(place, com, mass, inertia, carried=''):
    return (f'<body pos="{place:.17g} 0 0"><joint type="hinge" axis="0 0 1"/><inertial '
            f'pos="{com:.17g} 0 0" mass="{mass:.17g}" diaginertia="{inertia:.17g} {inertia:.17g} '
            f'{inertia:.17g}"/>{carried}</body>')


def under_cascade(robot, model, gains, reference, period, scene, angles, torques):
    """Run T samples under the cascade in MuJoCo, as `truth.under_cascade` does without it."""
    if not available():
        raise ConfigError('these robots move in MuJoCo, which is not installed: install the '
                          'extra bench, or mujoco alone')
    from mujoco import mj_step, MjData, MjModel

    steps = round(period / STEP)
    dt = period / steps
    physics = MjModel.from_xml_string(mjcf(effect_table.with_changes(robot).arm, dt))
    data = MjData(physics)
    n, forces = robot.n_joints, data.qfrc_applied
    box, constants, strange = (boxed(one) for one in scene[:3])
    x, c = box[0], constants[0]
    data.qpos[:n], data.qpos[n:] = x.q + c.offset, x.q_motor
    state, gains, work = (cascade.init(model), cascade.constants_of(gains, model),
                          cascade.workspace(n))
    for k in range(len(reference)):
        time = loop.begin_sample(k, period, x, scene.supply, scene.noise)
        lead, lead_motor = 0.5 * dt * x.v, 0.5 * dt * x.v_motor
        x.q[:] -= lead
        x.q_motor[:] -= lead_motor
        loop.sense(x, time, period, c, scene.sensed, scene.encoders, scene.rng)
        cascade.tick(state, scene.sensed.output, reference[k], period if k else 0.0, gains, work)
        loop.write_sample(k, x, c, scene.sensed.output, state, angles, torques)
        x.q[:] += lead
        x.q_motor[:] += lead_motor
        x.applied[:] = 0.0
        for i in range(steps):
            loop.load_held(box, constants, strange, state.command, time + i * dt, dt,
                           scene.drawn[k], forces)
            mj_step(physics, data)
            loop.follow_held(box, constants, data.qpos, data.qvel, data.qacc, dt)
        x.applied[:] /= steps
        if not np.isfinite(x.q).all():
            angles[k + 1:] = np.nan
            return
