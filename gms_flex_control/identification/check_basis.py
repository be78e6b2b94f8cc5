# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What the checks of a recording share: limits, faults, and filtered motion against its torque.

A share is one of all samples unless it says otherwise. Where no origin is given, a limit was
chosen on recordings with injected faults (docs/data_checks.md), between healthy and faulty ones.
"""

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.data.recording import Recording
from gms_flex_control.dynamics.chain import inverse_dynamics
from gms_flex_control.params.robot import RobotParams
import numpy as np

# length and channels
FEWEST = 200                    # samples of a recording
SHORTEST, SHORT = 2.0, 4.0      # duration refused and warned about below [s]
MISSING_WARN, MISSING_MOST, MISSING_REFUSE = 0.001, 10, 0.3  # share, samples, share without number
# clock
BURST = 0.2                      # of the mean period: a median below that is one within bursts
BURSTS = 0.02                    # share of longer steps, of which a paused recording has few
FASTEST, SLOWEST = 2e-5, 0.2    # plausible periods [s]
LOST_WARN, LOST_REFUSE = 0.003, 0.3  # share of lost samples
GAP_WARN = 0.05                 # a single gap worth a word [s]
ON_GRID = 0.1                   # a step of a steady clock is this near a multiple of the period
TOO_SOON = 0.55                 # of a period: sooner than jitter puts a sample
CLUSTER = 10                    # short steps near each other are no late message
TOO_SOON_SHARE = 0.001          # share of such steps worth a word
IRREGULAR = 1.0                 # periods between the 10 % and 90 % quantiles of the steps
# motion
STILL_STEPS = 3                 # encoder steps, or standard deviations of noise, of no motion
ONE_WAY = 0.03                  # of the travel is in the other direction
SLOPE, SLOPE_FIT = (0.85, 1.15), 0.9            # velocity over derivative, correlation: right
SLOPE_MILD, SLOPE_MILD_FIT = (0.7, 1.4), 0.8    # likewise: warned about, else refused
FROZEN, FROZEN_WARN, FROZEN_REFUSE = 5, 0.002, 0.3   # samples; shares repeated in motion
FROZEN_LATE = 2e-4              # rms, by which they make angles late: less biases no inertia [s]
BEYOND = 2.0                    # times the limits of a URDF: angles that far out are no radians
TURNS, DEGREES = 4.0 * np.pi, 720.0  # of an angle in rad: between, one is two turns in degrees
# torque
CLIPPED_WARN, CLIPPED_REFUSE = 0.005, 0.5  # shares of the moving samples
CLIP_TRAVEL = 0.05, 0.02        # a joint moves that travels in so long [s] this share of its most
CLIP_TOP = 0.3                  # of the largest torque: a lower extreme of one sign is no limit
CLIP_AT, CLIP_BELOW = 1e-6, 0.01  # of the range: at the extreme, and right below it
CLIP_REPEATS = 5                # samples at the extreme that do not change
CLIP_RARE, CLIP_ALONE = 0.2, 0.3  # of these: as many that stand elsewhere are steps of a torque
CLIP_BETWEEN = 0.01             # of these: with fewer samples between, it is one that is switched
CLIP_DENSE = 4                  # times as many samples at the extreme as right below it
FEWEST_ROWS = 40                # of a fit
TRAVEL = 30                     # encoder steps a joint must move for its torque to be judged
CLEAR = 0.5                     # of the variance a fit must explain to be believed
APART = 0.3                     # of the variance by which one sign must explain more
LOOSE = 0.5                     # of the variance: less explains no reversed torque, gravity free
OTHER_SIDE = 0.1                # of the stiffness: less is no spring with sides as they are
LATE = 0.1                      # of the torsion's variance that goes with the velocity: read late
LATE_FACTOR = 3.0               # times SCALE_STIFFNESS then
EXACT = 0.95                    # a fit as good as this is no delay between encoders
SCALE_STIFFNESS = 4.0           # refused beyond this factor of what the spring says
SCALE_INERTIA = (3.0, 8.0)      # warned about, refused: inertia of a rigid joint is less known
SCALE_SHOWN = 0.6               # of the variance explained, from which a factor is said
SCALE_SLIGHT, NEARLY_ALL = 50.0, 0.9  # refused where friction is more of the variance than this
UNEXPLAINED = 0.2               # of the variance: less than this is no fit at all
# exchanged channels
EXCHANGED = 0.3                 # of the variance left by each torque at the other joint, at most
EXCHANGED_SHARE = 0.25          # of what both leave where they stand
SIDE_SLOPE_ALONE = 5.0          # slope, or its inverse, that no deflection makes, torque unknown
SIDE_FACTOR = 8.0               # torque of the spring over that of the motor that cannot be
SIDE_SLOPE, SIDE_FIT = (0.5, 2.0), 0.9     # motor angle over link angle, correlation


class Fault(NamedTuple):
    """One fault of a recording."""

    kind: str      # see recording_checks
    joint: str     # link name, '' if it concerns all
    severity: str  # 'refuse': a fit would be wrong; 'warn': a fit is possible, less is known
    text: str      # a sentence: what, where, the value, the way out


def sides(recording: Recording, joint: int) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield (name, angle, rate) of each side that was recorded of a joint's number."""
    for name, q, dq in (('link', recording.q_link, recording.dq_link),
                        ('motor', recording.q_motor, recording.dq_motor)):
        if np.isfinite(q[:, joint]).any():
            yield name, q[:, joint], dq[:, joint]


def absent_joints(recording: Recording, robot: RobotParams) -> list[Fault]:
    """Return a fault for the first joint of a robot that a Recording lacks."""
    for joint in robot.joints:
        if joint not in recording.joints:
            return [Fault('joint_names', joint, 'refuse', (
                f'{recording.source}: has no joint {joint!r}, it has '
                f'{", ".join(recording.joints)}; use the names of the recording in the robot '
                'file, or choose its joints when it is read'))]
    return []


class FilteredChannels(NamedTuple):
    """Filtered channels of all joints, arrays (S, n), on the rows without gaps."""

    q_link: np.ndarray
    dq_link: np.ndarray
    ddq_link: np.ndarray
    q_motor: np.ndarray
    dq_motor: np.ndarray
    ddq_motor: np.ndarray
    tau: np.ndarray
    moved: np.ndarray  # (n,), joints that move far enough for their torque to be judged


def filtered(signals: Recording, robot: RobotParams) -> FilteredChannels:
    """Return the FilteredChannels of a recording."""
    window = max(analysis.derivative_window(signals.time, q) for q in signals.q_link.T)
    sides = [signals.q_link.T, np.where(robot.arm.rigid, signals.q_link, signals.q_motor).T,
             signals.tau_motor.T]
    known = np.all(np.isfinite(signals.q_link), axis=1)
    time, gap = signals.time, 3 * signals.period
    rows = analysis.smoothed(
        time, [time, *(channel for side in sides for channel in side)], window)
    at, n = rows[0].value, len(signals.joints)
    stamps = time[known]
    wide = np.flatnonzero(np.diff(stamps) > max(gap, window / 8))
    good = np.ones(len(at), dtype=bool)
    for k in wide:
        good[np.searchsorted(at, stamps[k] - window / 2):
             np.searchsorted(at, stamps[k + 1] + window / 2)] = False
    link, motor, tau = rows[1:n + 1], rows[n + 1:2 * n + 1], rows[2 * n + 1:]
    columns = [[getattr(part, name)[good] for part in side] for side in (link, motor)
               for name in ('value', 'first', 'second')]
    unknown = ~np.isfinite(signals.tau_motor[2:]).any(axis=0)
    torque = np.stack([part.value[good] for part in tau], axis=1)
    torque[:, unknown] = np.nan
    moved = [len(at) and np.ptp(part.value) > TRAVEL * analysis.quantum(q)
             for part, q in zip(link, signals.q_link.T, strict=True)]
    result = FilteredChannels(*(np.stack(column, axis=1) for column in columns), torque,
                              np.array(moved, dtype=bool))
    blind = ~np.isfinite(sides[1]).any(axis=1)
    for values in result[3:6]:
        values[:, blind] = np.nan
    return result


class Balance:
    """Joints of a recording against the equations of motion of a robot; rows S are filtered."""

    def __init__(self, signals: Recording, robot: RobotParams):
        self.source, self.joints, self.arm = signals.source, signals.joints, robot.arm
        self.motion = filtered(signals, robot)

    @cached_property
    def springs(self) -> list[int]:
        """Return the numbers of the joints whose deflection is recorded."""
        return [j for j in range(len(self.joints))
                if not self.arm.rigid[j] and np.isfinite(self.motion.q_motor[:, j]).all()]

    @cached_property
    def driven(self) -> list[int]:
        """Return the numbers of the joints whose torque is recorded and can be judged."""
        tau, moved = self.motion.tau, self.motion.moved
        return [j for j in range(len(self.joints)) if np.isfinite(tau[:, j]).all()
                and np.ptp(tau[:, j]) > 0 and moved[j]]

    @cached_property
    def _total(self):
        """Return the frictionless torque (S, n) at the motors, ``M(q) ddq + C dq + g`` and own."""
        motion, inertia = self.motion, np.where(self.arm.rigid, 0.0, self.arm.motor_inertia)
        motor = np.where(np.isfinite(motion.ddq_motor), motion.ddq_motor, motion.ddq_link)
        return inverse_dynamics(*motion[:3], self.arm) + inertia * motor

    def torsion(self, j: int) -> np.ndarray:
        """Return the deflection of a joint's spring (S,) [rad]."""
        return self.motion.q_motor[:, j] - self.motion.q_link[:, j]

    def spring_share(self, tau, j: int) -> float:
        """Return what a joint's spring and motor explain of the variance of a torque (S,)."""
        return spring_fit(tau, self.motion.ddq_motor[:, j], self.torsion(j))[0]

    def fits(self, tau, j: int) -> tuple[analysis.Fit, analysis.Fit] | None:
        """Return fits of a torque (S,) by bodies and friction, gravity fixed and free, or None."""
        rate = self.motion.dq_link[:, j]
        rows = analysis.is_moving(rate)
        if rows.sum() < FEWEST_ROWS:
            return None
        angle, constant = self.motion.q_link[rows, j], np.ones(int(rows.sum()))
        columns = [self._total[rows, j], *analysis.friction_columns(rate[rows])]
        return (analysis.sign_fit(tau[rows], columns, [constant]),
                analysis.sign_fit(tau[rows], columns, [constant, np.sin(angle), np.cos(angle)]))


def spring_fit(tau, acceleration, torsion) -> tuple[float, float]:
    """Return what inertia and spring explain of a torque (S,), and the share the spring adds."""
    free = [np.ones_like(tau)]
    both = analysis.sign_fit(tau, [acceleration, torsion], free).as_is
    alone = analysis.sign_fit(tau, [acceleration], free).as_is
    return both, (both - alone) / max(1.0 - alone, 1e-12)
