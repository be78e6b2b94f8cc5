# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A simulated axis of known friction and its experiment, for tests of the identification."""

from dataclasses import replace
from functools import cache

from bench import coverage
from bench.identification_simulated import simulate_identification
from core_runs import padded
from gms_flex_control.data.recording import Recording
from gms_flex_control.experiment.identification_plan import plan_identification
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import (
    EncoderParams,
    FrictionParams,
    RobotParams,
    StribeckParams,
)
import numpy as np

JOINT = coverage.JOINT
YIELDS = np.array([0.15, 4.4e-3, 1.3e-3, 4.4e-4])  # rad; the first slips in sliding only
STATIC = 0.5 * (0.10697 + 0.09470)  # N m, mean of both directions
PLAN = coverage.PLAN | {'speeds': 6, 'dwell_time': 1.0, 'sliding_duration': 5.0}
GAINS = coverage.GAINS


def axis(*, rigid=False, yields=tuple(YIELDS)):
    """Return an axis like link 2 of the paper, its stiffnesses farther apart."""
    steady = (
        StribeckParams(static=[0.10697], coulomb=[0.09087], velocity=[0.07819], viscous=[0.00374]),
        StribeckParams(static=[0.09470], coulomb=[0.08363], velocity=[0.05795], viscous=[0.00530]))
    arm = ArmParams(kind='decoupled', mass=[0.0], length=[0.0], com=[0.0], inertia=[0.03],
                    motor_inertia=[0.005], stiffness=[np.inf if rigid else 1.5], damping=[0.0])
    friction = FrictionParams(forward=steady[0], backward=steady[1], attraction=[1.0],
                              weight=np.full((1, 4), 0.25),
                              stiffness=0.25 * STATIC / np.array([yields]))
    return RobotParams(joints=(JOINT,), motors=('' if rigid else f'{JOINT}_motor',), arm=arm,
                       friction=padded(friction),
                       encoder=EncoderParams(counts=20000.0, velocity_cutoff=50.0))


@cache
def experiment(seed=1, *, rigid=False, yields=tuple(YIELDS)):
    """Return (Recording, phases) of the experiment at 250 Hz, a minute and a half long."""
    robot = axis(rigid=rigid, yields=yields)
    plan = plan_identification({f'identification.{name}': value for name, value in PLAN.items()},
                               robot, GAINS)
    return simulate_identification(plan, robot, GAINS, seed, rate=250)


def without_phases(recorded):
    """Return a recording whose phases were not recorded."""
    return recorded[0], ()


def part(recorded, begin, end):
    """Return the part of a recording between two times [s], the clock from zero again."""
    recording, phases = recorded
    rows = slice(*np.searchsorted(recording.time, [begin - 1e-9, end - 1e-9]))
    cut = recording.of_samples(rows)
    cut = replace(cut, time=cut.time - cut.time[0])
    shift = round(1e9 * recording.time[rows][0])
    kept = [phase for phase in phases if phase.time_ns < 1e9 * end - 1]
    early = [phase for phase in kept if phase.time_ns <= shift][-1:]
    late = [phase for phase in kept if phase.time_ns > shift]
    return cut, tuple(phase._replace(time_ns=max(phase.time_ns - shift, 0))
                      for phase in (*early, *late))


def pendulum(inertia=0.02, pull=0.5, offset=-1.2, constant=0.0, seconds=40.0, rate=200.0, seed=0,
             ripple=(0.0, 0.0, 0.0), pace=1.0, per_load=0.0, early=0.0):
    """
    Return a Recording of a pendulum with Coulomb and viscous friction, in closed form.

    Its torques are stamped ``early`` [s].
    """
    stamps = np.arange(int(seconds * rate)) / rate
    parts = [(0.9, 0.31 * pace, 0.0), (0.5, 0.83 * pace, 1.0), (0.25, 1.7 * pace, 2.0)]
    read = sum(a * np.sin(2 * np.pi * f * stamps + p) for a, f, p in parts)
    time = stamps + early
    q = sum(a * np.sin(2 * np.pi * f * time + p) for a, f, p in parts)
    dq = sum(a * 2 * np.pi * f * np.cos(2 * np.pi * f * time + p) for a, f, p in parts)
    ddq = -sum(a * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time + p) for a, f, p in parts)
    torque = (inertia * ddq + pull * np.cos(q + offset) + 0.06 * np.tanh(dq / 0.01) + 0.01 * dq
              + constant - ripple[0] * np.sin(ripple[1] * q + ripple[2]))
    torque /= 1.0 - per_load * np.tanh(dq / 0.01) * np.sign(torque)  # of all that is carried
    torque = torque + 2e-3 * np.random.default_rng(seed).standard_normal(len(time))
    held = np.append(torque[0], 0.5 * (torque[1:] + torque[:-1]))
    return Recording(joints=('swing',), time=stamps, q_link=read[:, None], tau_motor=held[:, None],
                     source='pendulum')
