# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Integrator and closed loop of the hidden robots.

Velocity Verlet of second order: angles with the acceleration at the begin of a step, velocities
with the mean of those at begin and end, the latter at a predicted velocity. Effects are asked at
both ends; what they remember moves on once a step.
"""

from functools import cache

from bench.hidden_robots.kernels import compiled, friction, mechanics, outside, pid
from gms_flex_control import records
from gms_flex_control.control import cascade
from gms_flex_control.effects import base as sig
from gms_flex_control.effects import table as effect_table
from gms_flex_control.effects.base import Stage
from gms_flex_control.records import FLAG, FLOAT
from gms_flex_control.simulation import encoder
import numpy as np

_ACTUATOR, _TORSION, _SPRING, _FRICTION, _LINK, _MOTOR, _SENSOR = (int(stage) for stage in Stage)


@cache
def state_layout(n, n_blocks):
    """
    Return the dtype of state and work space.

    Angles in it are absolute; ``base`` is angle and rate of the base under joint 1; ``noise`` is
    what the drives add to the torque of the motors over a sample [N m].
    """
    vectors = ('q', 'v', 'q_motor', 'v_motor', 'a', 'a_motor', 'a_end', 'a_motor_end', 'v_end',
               'v_motor_end', 'link_torque', 'motor_torque', 'applied', 'noise')
    return records.layout(
        *((name, FLOAT, (n,)) for name in vectors), ('base', FLOAT, (2,)), ('push', FLOAT, (1,)),
        ('supply', FLOAT, (1,)),
        ('torque', FLOAT, (n, n_blocks)), ('sticking', FLAG, (n, n_blocks)),
        ('direction', FLOAT, (n,)), ('signals', FLOAT, (n, sig.WIDTH)),
        ('memory', FLOAT, (effect_table.MEMORY_SIZE,)),
        ('scratch', FLOAT, (effect_table.MEMORY_SIZE,)))


@compiled
def fill(x, q, v, q_motor, v_motor, command, time):
    """Write what the effects may read; angles of joint 1 count from its base."""
    s = x.signals
    for j in range(q.shape[0]):
        lean, lean_rate = (x.base[0], x.base[1]) if j == 0 else (0.0, 0.0)
        s[j, sig.TIME], s[j, sig.JOINT], s[j, sig.JOINTS] = time, j, q.shape[0]
        s[j, sig.Q_LINK], s[j, sig.DQ_LINK] = q[j] - lean, v[j] - lean_rate
        s[j, sig.Q_MOTOR], s[j, sig.DQ_MOTOR] = q_motor[j] - lean, v_motor[j] - lean_rate
        s[j, sig.TORQUE], s[j, sig.SUPPLY] = command[j], x.supply[0]
        s[j, sig.TORSION] = q_motor[j] - q[j]
        s[j, sig.TORSION_RATE] = v_motor[j] - v[j]
        s[j, sig.LINK_TORQUE], s[j, sig.MOTOR_TORQUE] = 0.0, 0.0


@compiled
def load(x, q, v, q_motor, v_motor, command, time, dt, memory, c, strange, drawn):
    """Write what acts on links and motors at a state (four of (n,)), all but the inertia."""
    s, effects, n = x.signals, c.effects, q.shape[0]
    fill(x, q, v, q_motor, v_motor, command, time)
    effect_table.run_stage(_ACTUATOR, s, memory, dt, effects)
    for j in range(n):
        s[j, sig.TORQUE] += x.noise[j]
    effect_table.run_stage(_TORSION, s, memory, dt, effects)
    for j in range(n):
        s[j, sig.SPRING] = (c.stiffness[j] * s[j, sig.TORSION]
                            + c.damping[j] * s[j, sig.TORSION_RATE])
    effect_table.run_stage(_SPRING, s, memory, dt, effects)
    for j in range(n):
        s[j, sig.FRICTION] = friction.friction_torque(j, s[j, sig.DQ_LINK], x.torque,
                                                      x.direction, c.friction)
    effect_table.run_stage(_FRICTION, s, memory, dt, effects)
    effect_table.run_stage(_LINK, s, memory, dt, effects)
    effect_table.run_stage(_MOTOR, s, memory, dt, effects)
    for j in range(n):
        on_link, on_motor = 0.0, 0.0
        if strange.kind[0] > 0 and strange.joint[0] == j:
            on_link, on_motor = outside.outside_torques(
                strange.kind[0], strange.values, time, s[j, sig.Q_LINK], s[j, sig.DQ_LINK],
                s[j, sig.Q_MOTOR], s[j, sig.FRICTION], drawn)
        x.motor_torque[j] = s[j, sig.TORQUE] + s[j, sig.MOTOR_TORQUE] + on_motor
        x.link_torque[j] = s[j, sig.LINK_TORQUE] + on_link - s[j, sig.FRICTION]
        if c.flexible[j]:
            x.motor_torque[j] -= s[j, sig.SPRING]
            x.link_torque[j] += s[j, sig.SPRING]
        else:
            x.link_torque[j] += x.motor_torque[j]
    x.push[0] = s[0, sig.FRICTION] - s[0, sig.TORQUE]


@compiled
def evaluate(x, q, v, q_motor, v_motor, command, time, dt, memory, c, strange, drawn, a,
             a_motor):
    """Write the accelerations at a state (four of (n,)) into ``a`` and ``a_motor`` (n,)."""
    load(x, q, v, q_motor, v_motor, command, time, dt, memory, c, strange, drawn)
    mechanics.accelerate(c, q, v, x.link_torque, x.motor_torque, a, a_motor)
    for j in range(q.shape[0]):
        x.signals[j, sig.DDQ_LINK], x.signals[j, sig.DDQ_MOTOR] = a[j], a_motor[j]


@compiled
def base_acceleration(base, push, c):
    """Return the acceleration of the base under the torque ``push``, scalar."""
    omega = c.base[1]
    return push / c.base[0] - omega * (2.0 * c.base[2] * base[1] + omega * base[0])


@compiled
def step(x, command, time, dt, c, strange, drawn):
    """Advance the state by ``dt`` under a held command (n,)."""
    evaluate(x, x.q, x.v, x.q_motor, x.v_motor, command, time, dt, x.memory, c, strange, drawn,
             x.a, x.a_motor)
    for j in range(x.q.shape[0]):
        x.applied[j] += x.signals[j, sig.TORQUE] * dt
    for i in range(x.memory.shape[0]):
        x.scratch[i] = x.memory[i]
    lean, lean_rate, a_base = 0.0, 0.0, 0.0
    if c.base[0] > 0.0:
        lean, lean_rate = x.base[0], x.base[1]
        a_base = base_acceleration(x.base, x.push[0], c)
        x.base[0] = lean + dt * (lean_rate + 0.5 * dt * a_base)
        x.base[1] = lean_rate + dt * a_base
    for j in range(x.q.shape[0]):
        under, a_under = (lean_rate, a_base) if j == 0 else (0.0, 0.0)
        friction.move(j, x.v[j] - under, x.a[j] - a_under, dt, x.torque, x.sticking,
                      x.direction, c.friction)
        x.q[j] += dt * (x.v[j] + 0.5 * dt * x.a[j])
        x.q_motor[j] += dt * (x.v_motor[j] + 0.5 * dt * x.a_motor[j])
        x.v_end[j] = x.v[j] + dt * x.a[j]
        x.v_motor_end[j] = x.v_motor[j] + dt * x.a_motor[j]
    evaluate(x, x.q, x.v_end, x.q_motor, x.v_motor_end, command, time + dt, dt, x.scratch, c,
             strange, drawn, x.a_end, x.a_motor_end)
    if c.base[0] > 0.0:
        x.base[1] = lean_rate + 0.5 * dt * (a_base + base_acceleration(x.base, x.push[0], c))
    for j in range(x.q.shape[0]):
        x.v[j] += 0.5 * dt * (x.a[j] + x.a_end[j])
        x.v_motor[j] += 0.5 * dt * (x.a_motor[j] + x.a_motor_end[j])


@compiled
def advance(x, command, time, period, substeps, c, strange, drawn):
    """Advance by one sample; ``x.applied`` is then the mean torque of the actuators."""
    dt = period / substeps
    x.applied[:] = 0.0
    for k in range(substeps):
        step(x, command, time + k * dt, dt, c, strange, drawn)
    for j in range(command.shape[0]):
        x.applied[j] /= period


@compiled
def begin_sample(k, period, x, supply, noise):
    """Set voltage and torque noise of sample ``k``; return its time [s]."""
    x.supply[0] = supply[k]
    for j in range(x.noise.shape[0]):
        x.noise[j] = noise[k, j]
    return k * period


@compiled
def sense(x, time, period, c, sensed, encoders, rng):
    """Read the encoders, which count from the base, through the effects on sensors."""
    s = x.signals
    fill(x, x.q, x.v, x.q_motor, x.v_motor, x.applied, time)
    for j in range(x.q.shape[0]):
        s[j, sig.SENSED_LINK], s[j, sig.SENSED_LINK_RATE] = s[j, sig.Q_LINK], s[j, sig.DQ_LINK]
        s[j, sig.SENSED_MOTOR] = s[j, sig.Q_MOTOR]
        s[j, sig.SENSED_MOTOR_RATE] = s[j, sig.DQ_MOTOR]
    effect_table.run_stage(_SENSOR, s, x.memory, period, c.effects)
    encoder.draw(sensed, encoders, rng)
    encoder.measure(sensed, s, period, encoders)


@compiled
def write_sample(k, x, c, measured, control_state, angles, torques):
    """Write sample ``k`` of a run into ``angles`` (T, 8, n) and ``torques`` (T, 4, n)."""
    for j in range(x.q.shape[0]):
        angles[k, 0, j], angles[k, 1, j] = measured.q_link[j], measured.dq_link[j]
        angles[k, 2, j], angles[k, 3, j] = measured.q_motor[j], measured.dq_motor[j]
        angles[k, 4, j], angles[k, 5, j] = x.q[j], x.v[j]
        angles[k, 6, j], angles[k, 7, j] = x.q_motor[j], x.v_motor[j]
        torques[k, 0, j], torques[k, 1, j] = control_state.command[j], x.applied[j]
        torques[k, 2, j] = friction.friction_torque(j, x.v[j], x.torque, x.direction, c.friction)
        torques[k, 3, j] = control_state.friction_hat[j]


@compiled
def run(reference, period, substeps, x, c, strange, drawn, supply, noise, sensed, encoders, rng,
        control_state, control, control_work, angles, torques):
    """Run T samples under the cascade; fills ``angles`` and ``torques``, see write_sample."""
    for k in range(reference.shape[0]):
        time = begin_sample(k, period, x, supply, noise)
        sense(x, time, period, c, sensed, encoders, rng)
        cascade.tick(control_state, sensed.output, reference[k], period if k > 0 else 0.0, control,
                     control_work)
        write_sample(k, x, c, sensed.output, control_state, angles, torques)
        advance(x, control_state.command, time, period, substeps, c, strange, drawn[k])


@compiled
def run_pid(reference, period, substeps, x, c, strange, drawn, supply, noise, sensed, encoders,
            rng, control, angles, torques):
    """Run T samples as `run` does, under PID controllers."""
    for k in range(reference.shape[0]):
        time = begin_sample(k, period, x, supply, noise)
        sense(x, time, period, c, sensed, encoders, rng)
        pid.tick(control, sensed.output, reference[k], period if k > 0 else 0.0)
        write_sample(k, x, c, sensed.output, control, angles, torques)
        advance(x, control.command, time, period, substeps, c, strange, drawn[k])


@compiled
def run_open(command, period, substeps, x, c, strange, drawn, states):
    """Run T samples under given torques (T, n); fills ``states`` (T + 1, 4, n), the truth."""
    for k in range(command.shape[0] + 1):
        for j in range(x.q.shape[0]):
            states[k, 0, j], states[k, 1, j] = x.q[j], x.v[j]
            states[k, 2, j], states[k, 3, j] = x.q_motor[j], x.v_motor[j]
        if k < command.shape[0]:
            advance(x, command[k], k * period, period, substeps, c, strange, drawn[k])


STRANGE_LAYOUT = records.layout(('kind', np.intp, (1,)), ('joint', np.intp, (1,)),
                                ('values', FLOAT, (outside.PARAMETERS,)))


@compiled
def load_held(boxed_x, boxed_c, boxed_strange, command, time, dt, drawn, forces):
    """
    Write the torques on links, then motors, into ``forces`` (2 n,), inertia left out.

    For those who integrate the robot elsewhere and hold torques over a step; records come boxed.
    """
    x, n = boxed_x[0], command.shape[0]
    load(x, x.q, x.v, x.q_motor, x.v_motor, command, time, dt, x.memory, boxed_c[0],
         boxed_strange[0], drawn)
    for j in range(n):
        x.applied[j] += x.signals[j, sig.TORQUE]
        forces[j], forces[n + j] = x.link_torque[j], x.motor_torque[j]


@compiled
def follow_held(boxed_x, boxed_c, angles, rates, accelerations, dt):
    """Take over where links and motors are after the step, (2 n,) each, and move the blocks."""
    x, c = boxed_x[0], boxed_c[0]
    n = x.q.shape[0]
    for j in range(n):
        friction.move(j, x.v[j], (rates[j] - x.v[j]) / dt, dt, x.torque, x.sticking, x.direction,
                      c.friction)
        x.q[j], x.v[j] = angles[j] - c.offset[j], rates[j]
        x.q_motor[j], x.v_motor[j] = angles[n + j], rates[n + j]
        x.signals[j, sig.DDQ_LINK] = accelerations[j]
        x.signals[j, sig.DDQ_MOTOR] = accelerations[n + j]
