# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Disturbances that no effect of the catalogue explains."""

from bench.hidden_robots.kernels import compiled
import numpy as np

NAMES = ('none', 'periodic_link_torque', 'periodic_motor_torque', 'local_bump',
         'random_link_torque', 'random_motor_torque', 'friction_step', 'sliding_cogging',
         'stick_at_angle', 'knocks', 'two_state_bias', 'speed_band')
(NONE, PERIODIC_LINK, PERIODIC_MOTOR, BUMP, RANDOM_LINK, RANDOM_MOTOR, FRICTION_STEP, COGGING,
 STICK, KNOCKS, TWO_STATE, SPEED_BAND) = range(len(NAMES))
PARAMETERS = 5


@compiled
def outside_torques(kind, p, time, q, v, q_motor, friction, drawn):
    """
    Return what a disturbance adds to the torque of link and motor of its joint, scalars.

    ``kind`` is the index into `NAMES`, ``p`` (PARAMETERS,) has the torque first, see outsiders;
    then time, motion of the joint, its friction torque and a random number held for a sample.
    """
    if kind == PERIODIC_LINK:
        return p[0] * np.sin(p[1] * time + p[2]), 0.0
    if kind == PERIODIC_MOTOR:
        return 0.0, p[0] * np.sin(p[1] * time + p[2])
    if kind == BUMP:
        return p[0] * np.exp(-((q - p[1]) / p[2]) ** 2), 0.0
    if kind == RANDOM_LINK or kind == KNOCKS or kind == TWO_STATE:
        return p[0] * drawn, 0.0
    if kind == RANDOM_MOTOR:
        return 0.0, p[0] * drawn
    if kind == FRICTION_STEP:
        return (-p[0] * friction if time > p[1] else 0.0), 0.0
    if kind == COGGING:
        return 0.0, p[0] * np.sin(p[1] * q_motor + p[2] + p[3] * time)
    if kind == STICK:
        return -p[0] * np.tanh(v / 0.01) * np.exp(-((q - p[1]) / p[2]) ** 2), 0.0
    if kind == SPEED_BAND:
        return -p[0] * np.sign(v) * np.exp(-((abs(v) - p[1]) / p[2]) ** 2), 0.0
    return 0.0, 0.0
