# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A rigid arm whose links are not those of its URDF, moved by MuJoCo, which is independent."""

from dataclasses import replace
from pathlib import Path
import tempfile
import xml.etree.ElementTree as ElementTree

from gms_flex_control import load_robot, Recording
from gms_flex_control.data.recording import Operation
from gms_flex_control.dynamics.chain import mass_matrices
from gms_flex_control.identification.inertial_parameters import all_parameters, base_of
from gms_flex_control.params.arm import ArmParams, Body
from gms_flex_control.schema.urdf_arm import read_links
import numpy as np

ARM = Path(__file__).parents[2] / 'examples' / 'industrial_arm' / 'robot.yaml'
STEP, EVERY = 5e-4, 4   # s; steps of a sample
MOTORS = 1.2             # times the motor inertia believed
HELD = 1e4               # stiffness over inertia of joints that do not move [1/s^2]
COUNTS = 2e6            # of the encoders, per revolution
TOOL = 'tool_centre'     # link at the end of the arm, in whose frame loads are given


def believed():
    """Return the robot of the example, its joints rigid."""
    robot = load_robot(ARM)
    return replace(robot, motors=('',) * 6, arm=replace(
        robot.arm, stiffness=np.full(6, np.inf), damping=np.zeros(6)))


def hidden_urdf(seed=0):
    """Return the URDF with mass, centre of mass and inertia of each link 10 to 30 % off."""
    rng = np.random.default_rng(seed)
    root = ElementTree.parse(ARM.with_name('industrial_arm.urdf')).getroot()
    for inertial in root.iter('inertial'):
        def off(text):
            factor = 1.0 + rng.uniform(0.1, 0.3) * rng.choice([-1.0, 1.0])
            return ' '.join(repr(float(factor * float(one))) for one in text.split())
        inertial.find('mass').set('value', off(inertial.find('mass').get('value')))
        inertial.find('origin').set('xyz', off(inertial.find('origin').get('xyz')))
        inertia = inertial.find('inertia')
        scaled = off(' '.join(inertia.attrib.values())).split()
        for name, value in zip(list(inertia.attrib), scaled, strict=True):
            inertia.set(name, value)
    return ElementTree.tostring(root, encoding='unicode')


def hidden_arm(seed=0):
    """Return the robot as believed, the true arm and its URDF."""
    robot, text = believed(), hidden_urdf(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'arm.urdf'
        path.write_text(text)
        links = read_links(path, robot.joints)
    return robot, replace(
        robot.arm, mass=links.mass, com=links.com, inertia=links.inertia,
        motor_inertia=MOTORS * robot.arm.motor_inertia), text


def base_values(arm: ArmParams) -> np.ndarray:
    """Return the base parameters (B,) of an arm of rigid joints."""
    return base_of(arm)[1] @ all_parameters(arm)


def loaded(urdf, load: Body | None):
    """Return a URDF whose tool carries a load as a link of its own."""
    if load is None:
        return urdf
    root = ElementTree.fromstring(urdf)
    numbers = dict(zip(('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'),
                       map(repr, map(float, load.inertia[np.triu_indices(3)])), strict=True))
    link = ElementTree.SubElement(root, 'link', name='load')
    inertial = ElementTree.SubElement(link, 'inertial')
    ElementTree.SubElement(inertial, 'mass', value=repr(float(load.mass)))
    ElementTree.SubElement(inertial, 'origin', xyz=' '.join(map(repr, map(float, load.com))))
    ElementTree.SubElement(inertial, 'inertia', **numbers)
    joint = ElementTree.SubElement(root, 'joint', name='load_mount', type='fixed')
    ElementTree.SubElement(joint, 'parent', link=TOOL)
    ElementTree.SubElement(joint, 'child', link='load')
    return ElementTree.tostring(root, encoding='unicode')


def friction_of(arm: ArmParams) -> np.ndarray:
    """Return Coulomb [N m] and viscous friction [N m s/rad] of `moved`, (n,) each."""
    mass = np.diag(mass_matrices(np.zeros((1, arm.n_joints)), arm)[0])
    return np.array([0.02 * mass + 4.0, 0.05 * mass + 2.0])


def moved(urdf, arm: ArmParams, seconds, seed=0, noise=0.002, load=None, per_load=0.0, warm=1.0,
          moving=1.0):
    """
    Return a Recording of PD control along sinusoids, friction in the joints.

    ``noise`` is white noise of the recorded torque, of its standard deviation. Friction is
    ``warm`` times what it is and grows by ``per_load`` (n,) of the torque that moves the link.
    Joints move by ``moving`` (n,) times as far; those with 0 are held.
    """
    import mujoco
    model = mujoco.MjModel.from_xml_string(loaded(urdf, load))
    model.opt.gravity[:], model.opt.timestep = arm.gravity, STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4  # others lag by half a step, which shows
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.dof_armature[:] = MOTORS * arm.motor_inertia
    data, n, rng = mujoco.MjData(model), arm.n_joints, np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.1, 0.6, (3, n)), rng.uniform(0.0, 2.0 * np.pi, (3, n))
    size = 0.25 * moving * np.minimum(arm.frames.upper - arm.frames.lower, 2.0 * np.pi) / 2.0

    def reference(t):
        turn = 2.0 * np.pi * frequency * t + phase
        return (size * np.sin(turn)).sum(axis=0), (
            size * 2.0 * np.pi * frequency * np.cos(turn)).sum(axis=0)
    data.qpos[:], data.qvel[:] = reference(0.0)
    mujoco.mj_forward(model, data)
    mass = np.diag(mass_matrices(np.zeros((1, n)), arm)[0])
    stiff = np.broadcast_to(np.where(moving, 400.0, HELD), n) * mass
    damping, (coulomb, viscous) = 1.6 * np.sqrt(stiff * mass), friction_of(arm)
    samples = round(seconds / STEP / EVERY)
    angle, torque = np.empty((2, samples, n))
    applied = np.zeros(n)
    for k in range(samples):
        angle[k], torque[k] = data.qpos, applied
        wanted, rate = reference(k * EVERY * STEP)
        applied = stiff * (wanted - data.qpos) + damping * (rate - data.qvel) + (
            data.qfrc_bias)
        for _ in range(EVERY):
            turning = data.qvel + 0.5 * STEP * data.qacc  # in the middle of the step
            friction = warm * (coulomb * np.tanh(turning / 0.005) + viscous * turning)
            friction += per_load * np.abs(applied - friction) * np.tanh(turning / 0.005)
            data.qfrc_applied[:] = applied - friction
            mujoco.mj_step(model, data)
    torque += noise * torque.std(axis=0) * rng.standard_normal(torque.shape)
    count, nothing = 2.0 * np.pi / COUNTS, np.full(angle.shape, np.nan)
    return Recording(
        joints=tuple(f'joint{j + 1}' for j in range(n)), time=STEP * EVERY * np.arange(samples),
        q_link=count * np.round(angle / count), dq_link=nothing, q_motor=nothing,
        dq_motor=nothing, tau_motor=torque, command=torque,
        reference=np.full((samples, 5, n), np.nan), friction_hat=nothing, source='hidden',
        operation=Operation(load=load))
