# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
A first model of one recorded axis: decoupled flexible joint, Coulomb and viscous friction.

Eq. (1) of one decoupled axis, ``M ddq + F + K (q1 - q2) = 0`` and ``J ddq2 = tau + K (q1 - q2)``,
with ``F = sgn(dq) Fc + sigma dq``. Inertia and friction come from the torque by least squares,
the stiffness is given; how well the deflection of the spring then explains the measured torsion,
and how well a mere delay between the two encoders does, is the outcome.
"""

from dataclasses import dataclass, replace

from gms_flex_control.dynamics.chain import matrices
from gms_flex_control.effects.catalogue.spring import SpringOffset
from gms_flex_control.errors import BagError, ParameterError
from gms_flex_control.friction import steady_friction
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import (
    EffectSpec,
    EncoderParams,
    FrictionParams,
    RobotParams,
    StribeckParams,
)
import numpy as np
from scipy.signal import savgol_filter

WINDOW = 0.084       # of the derivatives [s]
MOVING = 0.01        # below this part of the top speed the direction of friction is not known
_POLYNOMIAL = 3
_FEWEST = 50         # moving samples
# What torque at speed does not determine, and a robot file needs all the same:
ASSUMED_MOTOR_SHARE = 0.5  # of M + J, where J is not given
PRESLIDING = 1e-4          # displacement to break-away [rad]
PRESLIDING_SPEED = 1e-3    # Stribeck velocity; without effect, static = coulomb [rad/s]
PRESLIDING_TIME = 1e-2     # of the slipping block towards its level [s]


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """How much of the measured torsion one explanation leaves over."""

    name: str         # in words
    stiffness: float  # of the spring in it [N m/rad]; infinite without a spring
    delay: float      # how much older the link encoder's reading is than the motor's [s]
    rms_error: float  # measured less modelled torsion, without its mean [rad]
    relative_error: float  # that over the rms of the measured torsion


@dataclass(frozen=True, kw_only=True, eq=False)
class TorsionStudy:
    """One axis, measured and modelled, at the T samples whose derivatives are known."""

    joint: str
    source: str
    time: np.ndarray          # (T,) [s], as all below
    velocity: np.ndarray      # of the motor side, seen at the joint [rad/s]
    acceleration: np.ndarray  # [rad/s^2]
    torque: np.ndarray        # measured at the motor [N m]
    torque_model: np.ndarray  # of inertia and friction [N m]
    torsion: np.ndarray       # motor less link angle, without its mean [rad]
    torsion_model: np.ndarray  # spring torque over stiffness, without its mean [rad]
    torsion_offset: float     # the mean taken off: zero error of the encoders [rad]
    inertia: float            # M + J, from the torque [kg m^2]
    motor_inertia: float      # J as given; this part of the torque does not load the spring
    moving: np.ndarray        # bool, samples used for the fit
    robot: RobotParams        # the axis of `first_model`, zero error as its spring_offset
    explanations: tuple       # Explanations, the given spring first

    @property
    def coulomb(self) -> tuple:
        """Return Coulomb friction forward and backward [N m]."""
        friction = self.robot.friction
        return float(friction.forward.coulomb[0]), float(friction.backward.coulomb[0])

    @property
    def viscous(self) -> float:
        """Return viscous friction [N m s/rad]."""
        return float(self.robot.friction.forward.viscous[0])

    @property
    def torque_error(self) -> tuple:
        """Return (rms measured, rms error) of the torque over the moving samples [N m]."""
        return (float(np.std(self.torque[self.moving])),
                rms((self.torque - self.torque_model)[self.moving]))


def study(recording, joint, stiffness, motor_inertia=0.0) -> TorsionStudy:
    """
    Return the TorsionStudy of one joint of a recording with angles of both sides and motor torque.

    ``stiffness`` is K [N m/rad]; ``motor_inertia`` J, reflected to the joint [kg m^2], 0 if not
    known: the spring then carries all torque. BagError if the joint, its motor side or the torque
    is missing, or it hardly moves.
    """
    if not (np.isfinite(stiffness) and stiffness > 0):
        raise BagError(f'stiffness must be above 0 and finite [N m/rad], got {stiffness}')
    time, q_link, q_motor, torque = _channels(recording, joint)
    dt = float(time[1] - time[0])
    samples = max(2 * round(WINDOW / dt / 2) + 1, _POLYNOMIAL + 2)
    edge = slice(samples // 2, len(time) - samples // 2)
    if len(time[edge]) < _FEWEST:
        raise BagError(f'{recording.source}: {len(time)} samples are too few for derivatives '
                       f'over {samples} samples')
    velocity, acceleration = (
        savgol_filter(q_motor, samples, _POLYNOMIAL, deriv=k, delta=dt)[edge] for k in (1, 2))
    torque, torsion = torque[edge], (q_motor - q_link)[edge]
    moving = np.abs(velocity) > MOVING * np.abs(velocity).max()
    columns = np.stack([acceleration, np.where(velocity > 0, 1.0, 0.0),
                        np.where(velocity < 0, -1.0, 0.0), velocity], axis=1)
    if moving.sum() < _FEWEST or np.linalg.matrix_rank(columns[moving]) < columns.shape[1]:
        raise BagError(f'{recording.source}: {joint} must move both ways, at changing speed, to '
                       'separate inertia from friction')
    fit, *_ = np.linalg.lstsq(columns[moving], torque[moving], rcond=None)
    robot = first_model(joint, stiffness, motor_inertia, fit, recording.source)
    torque_model = motor_torque(robot, velocity, acceleration)
    load = torque - motor_inertia * acceleration  # what the spring carries, Eq. (1), motor
    zero = EffectSpec(name=SpringOffset.name, joint=joint,
                      values=(float(load.mean() / stiffness - torsion.mean()),))
    return TorsionStudy(
        joint=joint, source=recording.source, time=time[edge], velocity=velocity,
        acceleration=acceleration, torque=torque, torque_model=torque_model,
        torsion=torsion - torsion.mean(), torsion_model=(load - load.mean()) / stiffness,
        torsion_offset=float(torsion.mean()), inertia=float(fit[0]),
        motor_inertia=float(motor_inertia), moving=moving,
        robot=replace(robot, effects=(zero,)),
        explanations=tuple(_explain(torsion, load, velocity, stiffness)))


def first_model(joint, stiffness, motor_inertia, fit, source) -> RobotParams:
    """
    Return the fitted axis as a robot that plant and controller can use: decoupled, one joint.

    ``fit`` is M + J [kg m^2], Coulomb friction forward and backward [N m] and viscous [N m s/rad],
    in one stiff block; where J is 0, ASSUMED_MOTOR_SHARE of M + J is the motor's. BagError, naming
    ``source``, if the fit is not physical.
    """
    whole, forward, backward, viscous = (float(value) for value in fit)
    motor = motor_inertia or ASSUMED_MOTOR_SHARE * whole
    try:
        steady = [StribeckParams(static=[level], coulomb=[level], velocity=[PRESLIDING_SPEED],
                                 viscous=[viscous]) for level in (forward, backward)]
        friction = FrictionParams(
            forward=steady[0], backward=steady[1], weight=[[1.0]],
            stiffness=[[max(forward, backward) / PRESLIDING]],
            attraction=[max(forward, backward) / PRESLIDING_TIME])
        zero = [0.0]
        arm = ArmParams(kind='decoupled', mass=zero, length=zero, com=zero,
                        inertia=[whole - motor], motor_inertia=[motor], stiffness=[stiffness],
                        damping=zero)
    except ParameterError as error:
        raise BagError(f'{source}: the torque of {joint} fits no axis with inertia, Coulomb and '
                       f'viscous friction ({error}); is its sign or scale wrong?') from error
    return RobotParams(joints=(joint,), motors=(f'{joint}_motor',), arm=arm, friction=friction,
                       encoder=EncoderParams())


def motor_torque(robot, velocity, acceleration) -> np.ndarray:
    """Return the motor torque (T,) of a one-joint robot sliding at given rates, Eqs. (1), (6)."""
    still = np.zeros(1)
    inertia = matrices(still, still, still, still, robot.arm).mass[0, 0]
    whole = inertia + robot.arm.motor_inertia[0]
    return whole * acceleration + steady_friction(velocity[:, None], robot.friction)[:, 0]


def _channels(recording, joint):
    """Return time, both angles and the torque of a joint on an even grid."""
    if joint not in recording.joints:
        known = ', '.join(recording.joints)
        raise BagError(f'{recording.source}: has no joint {joint!r}; it has {known}')
    j = recording.joints.index(joint)
    channels = {'motor angle': recording.q_motor[:, j], 'link angle': recording.q_link[:, j],
                'motor torque': recording.tau_motor[:, j]}
    known = np.all([np.isfinite(values) for values in channels.values()], axis=0)
    if known.sum() < _FEWEST:
        missing = min(channels, key=lambda name: np.isfinite(channels[name]).sum())
        raise BagError(f'{recording.source}: {joint} has {known.sum()} samples with both angles '
                       f'and torque, mostly the {missing} is missing; a torsion study needs '
                       'encoders on both sides and the torque of the motor')
    time = recording.time[known]
    grid = time[0] + recording.period * np.arange(
        int((time[-1] - time[0]) / recording.period * (1 + 1e-9)) + 1)
    return grid, *(np.interp(grid, time, channels[name][known])
                   for name in ('link angle', 'motor angle', 'motor torque'))


def _explain(torsion, load, velocity, stiffness):
    """Yield what is left of the torsion after one explanation and the other."""
    measured = torsion - torsion.mean()
    spring = (load - load.mean()) / stiffness
    speed = velocity - velocity.mean()

    def delay_of(rest):
        return float(speed @ rest / (speed @ speed))

    both = delay_of(measured - spring)
    free = np.stack([load - load.mean(), speed], axis=1)
    (compliance, lag), *_ = np.linalg.lstsq(free, measured, rcond=None)
    for name, k, delay, model in (
            ('spring of the given stiffness', stiffness, 0.0, spring),
            ('delay between the encoders alone', np.inf, delay_of(measured),
             delay_of(measured) * speed),
            ('given spring and delay', stiffness, both, spring + both * speed),
            ('free spring and delay', 1.0 / compliance, float(lag),
             free @ [compliance, lag])):
        error = rms(measured - model)
        yield Explanation(name=name, stiffness=float(k), delay=delay, rms_error=error,
                          relative_error=error / rms(measured))


def rms(values) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
