# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The motion of a recording as a model would have made it: the data if nothing were missing.

The model is simulated under the recorded torque plus what keeps its motors on the recorded motion,
and a gentle push that keeps links that are seen there: a link that stood stands, one that crept
creeps. Torque, push and motion then fit the model exactly, whatever it lacks. Read through the
same encoders and put through the same filters, such a run shows what a residual looks like where
nothing is missing: noise, rounding, and the filters' own errors at every reversal.
"""

from dataclasses import replace

from gms_flex_control.compiled import compiled
from gms_flex_control.data.signals import quantum
from gms_flex_control.discrepancy.motion import encoder_step, make_motion
from gms_flex_control.discrepancy.residuals import fresh_state
from gms_flex_control.dynamics.chain import own_inertia
from gms_flex_control.effects import signals as sig
from gms_flex_control.errors import SimulationError
from gms_flex_control.simulation import plant
import numpy as np

BANDWIDTH = 30.0      # of the motors' hold on the motion [rad/s]
_ALONE = 60.0         # likewise, where nothing but the motor holds the link
_OF_LINKS = 15.0      # likewise, of the push [rad/s]
_DAMPED = 1.4         # twice the damping ratio of both
_OF_RATE = 0.3        # of the sample rate: so much it is at most [rad]
_STEP = 4e-4          # of the integration [s]


@compiled
def simulate_along(states, command, supply, time, period, substeps, gains, constants, state, work,
                   held, pushed, link, motor):
    """
    Fill torques and angles (T, n) of a run along ``motion`` (T, 6, n).

    ``held`` are those of the actuators, ``pushed`` those that links are held with; of ``gains``
    (4, n) the first two hold motors, the others links: per angle and per rate.
    """
    samples, n = command.shape
    flexible = constants.chain.flexible
    ahead = 0.5 * period / substeps  # semi-implicit angles run half a step ahead of their rates
    for k in range(samples):
        work.signals[:, sig.SUPPLY] = supply[k]
        plant.sensed(state, state.applied, time[k], period, constants, work)
        for j in range(n):
            link[k, j] = work.signals[j, sig.SENSED_LINK] - ahead * state.dq_link[j]
            motor[k, j] = work.signals[j, sig.SENSED_MOTOR] - ahead * state.dq_motor[j]
            rows = 3 if flexible[j] else 0
            held[k, j] = (command[k, j] + gains[0, j] * (states[k, rows, j] - state.q_motor[j])
                          + gains[1, j] * (states[k, rows + 1, j] - state.dq_motor[j]))
            pushed[k, j] = (gains[2, j] * (states[k, 0, j] - state.q_link[j])
                            + gains[3, j] * (states[k, 1, j] - state.dq_link[j]))
            work.outside[j] = pushed[k, j]
        plant.advance(state, held[k], time[k], period, substeps, constants, work)


def null_simulation(motion, constants, rng):
    """
    Return a Motion the model makes of a recording, read through encoders like those of it.

    Parameters
    ----------
    motion : Motion
        The recording.
    constants : numpy.record
        The model, of simulation.plant.constants_of.
    rng : numpy.random.Generator
        For noise, and for where within a count the robot stands.

    Returns
    -------
    Motion

    Raises
    ------
    SimulationError
        If the model runs away.

    """
    links, n = constants.chain, len(motion.joints)
    carried, motors = own_inertia(links)
    inertia = np.where(links.flexible, links.motor_inertia, carried + motors)
    own, bandwidth = carried * links.flexible, np.full(n, BANDWIDTH)
    for link in motion.unseen:
        own[link.joint] = 0.0
        bandwidth[link.joint] = np.clip(_OF_RATE / motion.fine_period, BANDWIDTH, _ALONE)
    gains = np.stack([inertia * bandwidth ** 2, _DAMPED * inertia * bandwidth,
                      own * _OF_LINKS ** 2, _DAMPED * own * _OF_LINKS])
    state, first = fresh_state(constants), motion.fine_states[0]
    state.q_link[:], state.dq_link[:], state.q_motor[:], state.dq_motor[:] = first[[0, 1, 3, 4]]
    held, pushed, link, motor = np.empty((4, *motion.command.shape))
    simulate_along(motion.fine_states, motion.command, motion.supply, motion.fine_time,
                   motion.fine_period, max(1, round(motion.fine_period / _STEP)), gains,
                   constants, state, plant.workspace(n), held, pushed, link, motor)
    readings = np.stack([link, motor], axis=1)
    if not np.all(np.isfinite(readings)):
        raise SimulationError(f'{motion.source}: the model runs away along the recorded motion; '
                              'its inertia, stiffness and friction are not those of this robot')
    for side in range(2):
        for j in range(n):
            readings[:, side, j] = read(readings[:, side, j], motion.readings[:, side, j],
                                        motion.noise[side, j], rng)
    made = make_motion(motion.joints, motion.fine_time, motion.fine_period, readings, held,
                       motion.supply, motion.commanded, motion.source, motion.unseen)
    return replace(made, known=motion.known, pushed=pushed)


def read(angle, like, noise, rng):
    """Return an angle (T,) as an encoder gives it that gave ``like`` (T,)."""
    step = encoder_step(like, noise)
    own = np.sqrt(max(noise ** 2 - quantum(like) ** 2 / 12.0, 0.0))
    shift = step * rng.uniform()
    noisy = angle + own * rng.standard_normal(len(angle))
    return np.round((noisy + shift) / step) * step - shift if step > 0.0 else noisy
