# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The hidden robot where others integrate it: torques held over a step; records come boxed."""

from bench.hidden_robots.kernels import compiled, friction, loop
from gms_flex_control.effects import signals as sig


@compiled
def load(boxed_x, boxed_c, boxed_strange, command, time, dt, drawn, forces):
    """Write the torques on links, then motors, into ``forces`` (2 n,), inertia left out."""
    x, n = boxed_x[0], command.shape[0]
    loop.load(x, x.q, x.v, x.q_motor, x.v_motor, command, time, dt, x.memory, boxed_c[0],
              boxed_strange[0], drawn)
    for j in range(n):
        x.applied[j] += x.signals[j, sig.TORQUE]
        forces[j], forces[n + j] = x.link_torque[j], x.motor_torque[j]


@compiled
def follow(boxed_x, boxed_c, angles, rates, accelerations, dt):
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
