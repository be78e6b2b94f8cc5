# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Healthy recordings of many robots, and the faults that data have: put into them by name."""

from dataclasses import replace
from functools import cache
from pathlib import Path

from bench.identification_simulated import read_identification_plan, simulate_identification
from gms_flex_control.experiment.simulated import read_plan, simulate
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
JOINTS = ('joint1', 'joint2')
CHANNELS = ('q_link', 'dq_link', 'q_motor', 'dq_motor', 'tau_motor', 'command', 'friction_hat')
RIGID = {'motors': ['', ''], 'arm.joint1.stiffness': np.inf, 'arm.joint2.stiffness': np.inf}
GRAVITY = {'arm.gravity': 2.0, 'gains.joint1.torque_limit': 20.0,
           'gains.joint2.torque_limit': 20.0}


def both(name, value):
    """Return a parameter of both joints."""
    return {name.format(joint): value for joint in JOINTS}


def swing(**values):
    """Return parameters of the reference of both joints."""
    return {f'trajectory.{joint}.{name}': value for joint in JOINTS
            for name, value in values.items()}


UNLIKE = {'trajectory.joint1.amplitude': 0.5, 'trajectory.joint2.amplitude': 0.6,
          'trajectory.joint2.period': 3.7}
HEALTHY = {
    'sinusoid': ('sinusoid', {}), '1 kHz': ('sinusoid', {'rate': 1000.0}),
    'noise': ('sinusoid', {'encoder.noise': 1e-4}),
    'noise above the counts': ('sinusoid', UNLIKE | {
        'encoder.noise': 1e-4, 'encoder.counts': 1e5, 'rate': 1000.0}),
    'ideal encoders': ('sinusoid', {'encoder.counts': 0.0, 'encoder.velocity_cutoff': 0.0}),
    'polynomial': ('polynomial', {}),
    'fast moves': ('polynomial', {'trajectory.move_time': 2.0, 'trajectory.hold_time': 1.0}),
    'slow': ('sinusoid', swing(amplitude=0.1, period=20.0)),
    'stick-slip': ('sinusoid', swing(amplitude=0.02, period=20.0)),
    'unlike': ('sinusoid', UNLIKE),
    'gravity': ('sinusoid', GRAVITY | both('arm.{}.stiffness', 60.0)),
    'stiff': ('sinusoid', both('arm.{}.stiffness', 300.0) | UNLIKE),
    'decoupled': ('sinusoid', {'arm.kind': 'decoupled'}),
    'damped': ('sinusoid', both('arm.{}.damping', 0.05)),
    'no compensation': ('polynomial', {'compensation': 'none'}),
    'rigid': ('sinusoid', RIGID | UNLIKE), 'rigid gravity': ('sinusoid', RIGID | GRAVITY),
    'rigid slow': ('sinusoid', RIGID | swing(amplitude=0.1, period=20.0)),
    'rigid 100 Hz': ('sinusoid', RIGID | {'rate': 100.0, 'substeps': 100,
                                          'compensation': 'none'})}


@cache
def healthy(name):
    """Return a healthy recording and its robot; by name also that of an identification."""
    if name == 'experiment':
        robot = load_robot(ROOT / 'config' / 'robot.yaml')
        gains = load_controller(ROOT / 'config' / 'controller.yaml', robot)
        plan = read_identification_plan(
            [ROOT / 'bench' / 'demos' / 'identification.yaml'], robot, gains)
        return simulate_identification(plan, robot, gains, 3)[0], robot
    motion, overrides = HEALTHY[name]
    plan = read_plan([ROOT / 'config' / f'{stem}.yaml' for stem in (
        'robot', 'controller', motion)], overrides=overrides)
    return simulate(plan, name), plan.robot


def taken(recording, rows, time=None):
    """Return a recording of some samples, at their own or other times."""
    time = recording.time[rows] if time is None else time
    return replace(recording, time=time - time[0], **{
        name: getattr(recording, name)[rows] for name in (*CHANNELS, 'reference', 'supply')})


def with_columns(recording, order, names=CHANNELS):
    """Return a recording with the joints of some channels in another order."""
    return replace(recording, **{name: getattr(recording, name)[:, order] for name in names})


def changed(recording, **functions):
    """Return a recording with channels changed by functions of (channel, time as a column)."""
    return replace(recording, **{name: function(getattr(recording, name), recording.time[:, None])
                                 for name, function in functions.items()})


def chosen(recording, share, burst=1):
    """Return whether each sample belongs to randomly chosen bursts."""
    rng, count = np.random.default_rng(3), len(recording.time)
    hit = np.zeros(count, dtype=bool)
    for first in rng.choice(count - burst - 1, int(share * count / burst), replace=False):
        hit[first + 1:first + 1 + burst] = True
    return hit


def dropped(recording, share, burst=1):
    """Return a recording that lacks samples."""
    return taken(recording, np.flatnonzero(~chosen(recording, share, burst)))


def repeated(recording, share, burst=1):
    """Return a recording that repeats samples instead of the true ones."""
    hit = chosen(recording, share, burst)
    rows = np.maximum.accumulate(np.where(hit, 0, np.arange(len(hit))))
    return taken(recording, rows, recording.time)


def clock_set(recording, at, by):
    """Return a recording whose clock was set at some time, sorted by its stamps as read."""
    stamps = recording.time + np.where(recording.time > at, by, 0.0)
    order = np.argsort(stamps, kind='stable')
    order = order[np.concatenate([[True], np.diff(stamps[order]) > 1e-9])]
    return taken(recording, order, stamps[order])


def clipped(recording, quantile):
    """Return a recording whose torque was cut off."""
    limit = np.quantile(np.abs(recording.tau_motor), quantile, axis=0)
    return replace(recording, tau_motor=np.clip(recording.tau_motor, -limit, limit))


def exchanged_sides(recording):
    """Return a recording with motor and link under each other's names."""
    return replace(recording, q_link=recording.q_motor, q_motor=recording.q_link,
                   dq_link=recording.dq_motor, dq_motor=recording.dq_link)


def one_way(recording):
    """Return the part of a sinusoid in which both joints move forward only."""
    forward = (recording.time > 10.7) & (recording.time < 13.2)
    return taken(recording, np.flatnonzero(forward))


def stuck(channel, time):
    """Return a channel whose first joint does not change."""
    return channel * np.array([0.0, 1.0])


FAULTS = {
    'too short': ('too_short', 'refuse', lambda r: taken(r, np.arange(500))),
    'short': ('too_short', 'warn', lambda r: taken(r, np.arange(1000, 2700))),
    'clipped hard': ('saturated', 'warn', lambda r: clipped(r, 0.7)),
    'clipped': ('saturated', 'warn', lambda r: clipped(r, 0.95)),
    'clock ahead': ('dropped', 'warn', lambda r: clock_set(r, 12.0, 1.0)),
    'clock back': ('clock', 'warn', lambda r: clock_set(r, 12.0, -0.0507)),
    'milliseconds': ('clock', 'refuse', lambda r: replace(r, time=1e3 * r.time)),
    '1 % dropped': ('dropped', 'warn', lambda r: dropped(r, 0.01)),
    '10 % dropped': ('dropped', 'warn', lambda r: dropped(r, 0.1)),
    'bursts dropped': ('dropped', 'warn', lambda r: dropped(r, 0.05, 50)),
    'half dropped': ('dropped', 'refuse', lambda r: dropped(r, 0.5, 50)),
    '5 % repeated': ('frozen', 'warn', lambda r: repeated(r, 0.05)),
    'bursts repeated': ('frozen', 'warn', lambda r: repeated(r, 0.05, 20)),
    'hole': ('missing', 'warn', lambda r: changed(
        r, q_link=lambda q, t: np.where((t > 3) & (t < 4), np.nan, q))),
    'no link angle': ('missing', 'refuse', lambda r: changed(r, q_link=lambda q, t: q * np.nan)),
    'still': ('still', 'warn', lambda r: changed(r, q_link=stuck, dq_link=stuck)),
    'degrees per second': ('velocity', 'refuse', lambda r: changed(
        r, dq_link=lambda v, t: v * 57.3)),
    'velocity reversed': ('velocity', 'refuse', lambda r: changed(
        r, dq_link=lambda v, t: -v)),
    'slipped': ('jump', 'refuse', lambda r: changed(
        r, q_link=lambda q, t: q + 0.05 * (t > 8))),
    'spikes': ('jump', 'refuse', lambda r: changed(
        r, q_link=lambda q, t: q + 0.2 * (np.arange(len(q)) % 997 == 500)[:, None])),
    'torque reversed': ('torque_sign', 'refuse', lambda r: changed(
        r, tau_motor=lambda u, t: -u)),
    'one torque reversed': ('torque_sign', 'refuse', lambda r: changed(
        r, tau_motor=lambda u, t: u * [1.0, -1.0])),
    'motor side torque': ('torque_scale', 'refuse', lambda r: changed(
        r, tau_motor=lambda u, t: u / 100)),
    'kN m': ('torque_scale', 'refuse', lambda r: changed(r, tau_motor=lambda u, t: u * 1e3)),
    'torques exchanged': ('swapped_torques', 'refuse', lambda r: with_columns(
        r, [1, 0], ('tau_motor',))),
    'other names': ('joint_names', 'refuse', lambda r: replace(r, joints=('a', 'b')))}
SIDES = {
    'sides exchanged': ('swapped_sides', 'refuse', exchanged_sides),
    'motor angle not reflected': ('side_scale', 'refuse', lambda r: changed(
        r, q_motor=lambda q, t: 50 * q, dq_motor=lambda v, t: 50 * v)),
    'motor angle reversed': ('side_scale', 'refuse', lambda r: changed(
        r, q_motor=lambda q, t: -q, dq_motor=lambda v, t: -v))}
