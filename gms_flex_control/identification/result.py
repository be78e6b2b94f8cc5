# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What an identification found, and how far each number can be trusted."""

from dataclasses import dataclass
from typing import NamedTuple

from gms_flex_control.identification.steady import FrictionMap
from gms_flex_control.params.robot import RobotParams
import numpy as np

CONFIDENT = 1.959964  # standard deviations of a normal distribution: 95 %, two-sided


class Interval(NamedTuple):
    """Where a parameter lies with 95 % confidence."""

    low: float
    high: float


class Estimate(NamedTuple):
    """One parameter as the data have it."""

    name: str              # as in parameter files, 'friction.joint1.forward.static'; blocks by
    #                        their place in the array, 'friction.joint1.stiffness[0]'
    unit: str
    value: float
    interval: Interval     # NaN where a flag says that the data give none
    flags: tuple           # of 'at bound', 'not identifiable', 'depends on the model'; empty: good
    note: str              # a sentence on the flags and what motion would tell; '' without


class Loop(NamedTuple):
    """One piece of presliding motion: torque over displacement, measured and of the model."""

    displacement: np.ndarray  # (L,) [rad], measured
    torque: np.ndarray        # (L,) friction torque by the link equation [N m]
    model_displacement: np.ndarray  # (L,) [rad], of the model under the same torque
    label: str


class Trace(NamedTuple):
    """Friction torque over time, measured and of the model driven by the measured motion."""

    time: np.ndarray      # (T,) [s]
    velocity: np.ndarray  # (T,) [rad/s]
    measured: np.ndarray  # (T,) [N m]
    model: np.ndarray     # (T,) [N m]
    held_out: np.ndarray  # (T,) bool
    label: str


class HeldOut(NamedTuple):
    """Errors on data that took no part in the fit."""

    torque_rms: float              # of the drive torque, while moving if encoders count [N m]
    relative: float                # of the rms of the drive torque
    coulomb_viscous: float         # the same, inertia and gravity with Coulomb + viscous alone
    free_run_rms: float            # link angle after free simulation of `horizon` [rad]
    free_run_coulomb_viscous: float  # the same of Coulomb + viscous alone [rad]
    horizon: float                 # [s]
    innovation_rms: float          # of the one-step prediction [rad]
    noise_floor: float             # of the torque, measurement noise alone [N m]
    repeatability: float           # of the torque, equal motion repeated [N m]; NaN without
    bandwidth: float = float('nan')  # below which torques are compared [Hz]


class Candidate(NamedTuple):
    """One number of blocks that was tried."""

    n_blocks: int
    cost: float        # per held-out sample, lower is better
    error: float       # standard error of the difference to the best
    chosen: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class JointResult:
    """
    The identification of one joint.

    Parameters
    ----------
    joint : str
        Link name.
    side : {'spring', 'motor'}
        What the friction torque was taken from.
    estimates : tuple of Estimate
        Steady parameters of both directions, attraction, block stiffnesses and weights; further
        ones where they were estimated.
    curve : tuple of ndarray
        Presliding curve: displacement [rad], torque [N m], low and high of its 95 % interval;
        as far as blocks are identifiable, empty where none is.
    friction_map : FrictionMap
        Measured.
    steady_velocity, steady_torque : ndarray, shape (V,)
        Fitted curve of Eq. (6) over velocities of both signs.
    loops : tuple of Loop
        Presliding, for Fig. 4.
    traces : tuple of Trace
        Sliding and other motion.
    candidates : tuple of Candidate
        Numbers of blocks that were tried.
    held_out : HeldOut
        Errors.
    warnings : tuple of str
        Sentences.

    """

    joint: str
    side: str
    estimates: tuple
    curve: tuple
    friction_map: FrictionMap
    steady_velocity: np.ndarray
    steady_torque: np.ndarray
    loops: tuple
    traces: tuple
    candidates: tuple
    held_out: HeldOut
    warnings: tuple


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """
    Outcome of `gms_flex identify`.

    Parameters
    ----------
    method : {'default', 'paper'}
        How the parameters were fitted.
    robot : RobotParams
        The robot with what was identified.
    believed : RobotParams
        The robot as it was described.
    joints : tuple of JointResult
        In the robot's order.
    sources : tuple of str
        Recordings used.
    holdouts : tuple of str
        Recordings set aside whole; empty where blocks of time were held out.
    duration : float
        Of all data [s].
    period : float
        Sample [s].
    warnings : tuple of str
        Of the data as a whole.
    seconds : float
        How long the fit took [s].
    recorded : str
        When the data were recorded, such as '2026-03-01 14:05 UTC'; '' if not known.
    described : bool
        Whether ``believed`` is what a file says, not a placeholder.

    """

    method: str
    robot: RobotParams
    believed: RobotParams
    joints: tuple
    sources: tuple
    holdouts: tuple
    duration: float
    period: float
    warnings: tuple
    seconds: float
    recorded: str = ''
    described: bool = True
