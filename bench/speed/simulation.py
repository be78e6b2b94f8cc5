# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Speed of the simulation: closed loop, single steps, effects; numpy and MuJoCo beside them."""

from dataclasses import replace

from bench.speed import mujoco_arm, numpy_loop
from bench.speed.timing import interleaved, Measurement
from gms_flex_control.compiled import compiled
from gms_flex_control.control import cascade
from gms_flex_control.control.cascade import SteppedController
from gms_flex_control.params.robot import EffectSpec, EncoderParams
from gms_flex_control.records import boxed
from gms_flex_control.simulation import loop, plant
from gms_flex_control.simulation.loop import SteppedPlant
from gms_flex_control.trajectory.builders import sinusoid
import numpy as np

PERIOD_NS, SUBSTEPS = 1_000_000, 10
PERIOD = PERIOD_NS / 1e9
# name and values of the effects that are added, in this order, to joints in turn
EFFECTS = (
    ('spring_cubic', (2.0,)), ('torque_ripple', (0.01, 7.0, 0.0)), ('motor_coulomb', (0.01,)),
    ('motor_viscous', (0.01,)), ('load_friction', (0.1, 1e-3)), ('quadratic_drag', (0.01,)),
    ('backlash', (1e-4,)), ('kinematic_error', (1e-4, 0.0)), ('actuator_lag', (1e-3,)),
    ('spring_damping', (0.01,)))


def with_effects(robot, count):
    """Return ``robot`` with the first ``count`` of EFFECTS, on its joints in turn."""
    specs = (EffectSpec(name=name, joint=robot.joints[k % robot.n_joints], values=values)
             for k, (name, values) in enumerate(EFFECTS[:count]))
    return replace(robot, effects=tuple(specs))


def reference_motion(robot):
    """Return the paper's sinusoid for every joint, 1 rad in 6 s."""
    return sinusoid(np.ones(robot.n_joints), 6.0)


def measure_loop(robot, gains, quick=False):
    """Time the closed loop at 1 kHz with 10 substeps, compiled, against MuJoCo and numpy."""
    duration, slow = (4.0, 0.02) if quick else (10.0, 0.5)
    motion, repetitions = reference_motion(robot), 3 if quick else 9
    options = {'period_ns': PERIOD_NS, 'substeps': SUBSTEPS}
    cases = {'ours': lambda: loop.run(robot, robot, gains, motion, duration=duration,
                                      **options)}
    amount = {'ours': duration, 'mujoco': duration / 4, 'numpy': slow}
    if mujoco_arm.available():
        reference = motion.sample(np.arange(round(amount['mujoco'] / PERIOD)) * PERIOD)
        cases['mujoco'] = lambda: _mujoco_loop(robot, gains, reference)
    ideal = replace(robot, encoder=EncoderParams())
    paper = replace(gains, compensation='gms_paper')
    shorter = motion.sample(np.arange(round(slow / PERIOD)) * PERIOD)
    cases['numpy'] = lambda: numpy_loop.run(ideal, ideal, paper, shorter, PERIOD, SUBSTEPS)
    times = interleaved(cases, repetitions)
    speed = {name: amount[name] / time for name, time in times.items()}
    rows = [_loop_row('closed loop, compiled', speed['ours'], target=500.0,
                      note=f'mode {gains.compensation}, encoders')]
    if 'mujoco' in speed:
        rows += [_loop_row('closed loop, MuJoCo as plant', speed['mujoco'],
                           note='same mechanism, its own friction, our controller'),
                 Measurement(suite='loop', name='compiled / MuJoCo', unit='times', target=1.0,
                             value=speed['ours'] / speed['mujoco'])]
    return [*rows, _loop_row('closed loop, plain numpy', speed['numpy'],
                             note='mode gms_paper, ideal encoders')]


def _loop_row(name, value, **options):
    return Measurement(suite='loop', name=name, value=value, unit='simulated s / s', **options)


def _mujoco_loop(robot, gains, reference):
    """Run the compiled controller on MuJoCo's plant, which reads its angles without encoders."""
    arm = mujoco_arm.MujocoArm(robot, PERIOD / SUBSTEPS)
    controller, n = SteppedController(gains, robot), robot.n_joints
    measured = controller.measured
    views = [getattr(measured, name) for name in ('q_link', 'q_motor', 'dq_link', 'dq_motor')]
    q, dq = arm.data.qpos, arm.data.qvel
    for k in range(len(reference)):
        views[0][:], views[1][:] = q[:n], q[n:]
        views[2][:], views[3][:] = dq[:n], dq[n:]
        arm.advance(controller.tick(reference[k], PERIOD if k else 0.0), SUBSTEPS)


@compiled
def advance_many(count, state, command, dt, constants, work):
    """Take ``count`` substeps; records come boxed."""
    for k in range(count):
        plant.substep(state[0], command, k * dt, dt, constants[0], work[0])


@compiled
def tick_many(references, dt, state, measured, constants, work):
    """Answer ``references`` (T, 5, n) one after the other, the link following them; boxed."""
    for k in range(references.shape[0]):
        for j in range(references.shape[2]):
            measured[0].q_link[j] = references[k, 0, j] + 1e-3
            measured[0].dq_link[j] = references[k, 1, j]
        cascade.tick(state[0], measured[0], references[k], dt, constants[0], work[0])


def measure_step(robot, gains, quick=False):
    """Time one substep of the plant, with effects and in MuJoCo, side by side."""
    count, repetitions = (1000, 3) if quick else (20_000, 15)
    command = np.full(robot.n_joints, 0.15)  # above break-away: the blocks slip
    cases = {}
    for effects in (0, 3, 10):
        robot_k = with_effects(robot, effects)
        cases[effects] = _substeps(robot_k, command, count)
    steps = dict.fromkeys(cases, count)
    if mujoco_arm.available():
        arm = mujoco_arm.MujocoArm(robot, PERIOD / SUBSTEPS)
        steps['mujoco'] = max(count // 10, 100)
        cases['mujoco'] = lambda: arm.advance(command, steps['mujoco'])
    times = {name: 1e9 * time / steps[name]
             for name, time in interleaved(cases, repetitions).items()}
    rows = [Measurement(suite='step', name=f'plant substep, {name} effects', value=time,
                        unit='ns') for name, time in times.items() if name != 'mujoco']
    if 'mujoco' in times:
        rows += [Measurement(suite='step', name='MuJoCo step', value=times['mujoco'], unit='ns'),
                 Measurement(suite='step', name='MuJoCo step / plant substep', unit='times',
                             value=times['mujoco'] / times[0], target=1.0)]
    return rows


def _substeps(robot, command, count):
    arguments = [boxed(plant.init(robot)), command, PERIOD / SUBSTEPS,
                 boxed(plant.constants_of(robot)), boxed(plant.workspace(robot.n_joints))]
    return lambda: advance_many(count, *arguments)


def measure_tick(robot, gains, quick=False):
    """Time one tick of the controller and of the plant, in a compiled loop and from Python."""
    count, repetitions = (200, 3) if quick else (5000, 15)
    references = reference_motion(robot).sample(np.arange(count) * PERIOD)
    state, measured = boxed(cascade.init(robot)), boxed(cascade.measurement(robot.n_joints))
    cases = {}
    for mode in ('none', 'gms_paper', 'gms'):
        constants = boxed(cascade.constants_of(replace(gains, compensation=mode), robot))
        work = boxed(cascade.workspace(robot.n_joints))
        cases[f'controller tick in a compiled loop, {mode}'] = (
            lambda constants=constants, work=work: tick_many(
                references, PERIOD, state, measured, constants, work))
    controller = SteppedController(gains, robot)
    stepped = SteppedPlant(robot, period=PERIOD, substeps=SUBSTEPS)
    command = np.full(robot.n_joints, 0.15)

    def ticks():
        for reference in references:
            controller.tick(reference, PERIOD)

    def samples():
        for _ in range(count):
            stepped.advance(command)

    cases['controller tick from Python'] = ticks
    cases[f'plant sample of {SUBSTEPS} substeps and encoders from Python'] = samples
    times = interleaved(cases, repetitions)
    return [Measurement(suite='tick', name=name, value=1e6 * time / count, unit='us')
            for name, time in times.items()]
