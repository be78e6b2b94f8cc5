# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Robots drawn from a seed, and what their user believes of them."""

from dataclasses import replace

from gms_flex_control.errors import ParameterError, SimulationError
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import (
    EncoderParams,
    FrictionParams,
    RobotParams,
    StribeckParams,
)
import numpy as np

NOMINAL_SUPPLY = 24.0  # [V]
PLANTS = ('soft', 'stiff')
COUNTS = (20000, 20000, 65536, 131072, 262144, 524288)  # per revolution, one drawn
_STIFFNESS = {'soft': (1.0, 1.5), 'stiff': (24.0, 36.0)}  # [N m/rad]
_KD_MOTOR = {'soft': 0.2, 'stiff': 0.6}
_SAG = (0.03, 0.3)  # by which the arm's weight may wind up a spring, largest, rad
_GRAVITY = 9.81     # [m/s^2]
_TRIES = 100        # of what is believed of the links
_TO_SPARE = 1.2     # times the largest weight, above the torque that motion takes


def about(rng, value, spread=0.2):
    """Return ``value`` (array) times factors from 1 / (1 + spread) to 1 + spread."""
    value = np.asarray(value, dtype=float)
    return value * (1.0 + spread) ** rng.uniform(-1.0, 1.0, value.shape)


def draw_friction(rng):
    """Return the friction of two joints of a small robot, about 0.1 N m (FrictionParams)."""
    coulomb = about(rng, [0.092, 0.088])
    velocity = about(rng, [0.008, 0.06], 0.5)
    viscous = about(rng, [0.07, 0.02], 0.5)

    def side():
        level = coulomb * rng.uniform(0.97, 1.03, 2)
        return StribeckParams(
            static=level * rng.uniform(1.1, 1.3, 2), coulomb=level,
            velocity=velocity * rng.uniform(0.8, 1.25, 2),
            viscous=viscous * rng.uniform(0.9, 1.1, 2))

    blocks = 10.0 ** rng.uniform(0.0, 2.2, (2, 6))
    return FrictionParams(forward=side(), backward=side(), stiffness=np.sort(blocks, axis=1),
                          weight=np.full((2, 6), 1.0 / 6.0), attraction=about(rng, [1.5, 1.0]))


def draw_robot(rng, plant):
    """
    Return a true robot without effects, and gains that suit it.

    Joint stiffness is about 1 to 1.5 ('soft'), or about 30 N m/rad ('stiff').
    """
    mass, length = about(rng, [2.3, 1.0]), about(rng, [0.35, 0.30], 0.15)
    com = length * rng.uniform(0.45, 0.7, 2)
    arm = ArmParams(
        kind='planar', mass=mass, length=length, com=com,
        inertia=mass * length ** 2 * rng.uniform(0.08, 0.12, 2),
        motor_inertia=about(rng, [0.006, 0.005], 0.3), damping=np.zeros(2),
        stiffness=rng.uniform(*_STIFFNESS[plant], 2))
    counts = float(rng.choice(COUNTS))
    robot = RobotParams(
        joints=('joint1', 'joint2'), motors=('joint1_motor', 'joint2_motor'), arm=arm,
        friction=draw_friction(rng), encoder=EncoderParams(
            counts=counts, noise=2.0 * np.pi / counts * rng.uniform(0.1, 0.5),
            velocity_cutoff=50.0))
    kd_motor = _KD_MOTOR[plant] * arm.motor_inertia / [0.006, 0.005]
    return robot, ControllerParams(
        compensation='gms', kd_link=[0.8, 0.8], lambda_link=[3.0, 3.0], kd_motor=kd_motor,
        lambda_motor=[30.0, 40.0], observer_gain=[1.0, 1.0], sign_slope=[50.0, 50.0],
        filter_bandwidth=[100.0, 100.0], torque_limit=[3.0, 3.0])


def under_gravity(rng, robot, gains):
    """
    Return a robot whose plane is tilted, as far as its springs bear it, and its gains.

    Its first joint reads 0 at any angle from the horizontal; gravity itself is along -y, as robot
    files state it. The weight is added to the torque limit of ``gains``.
    """
    arm = robot.arm
    heaviest = np.cumsum(mass_moments(arm)[::-1])[::-1]  # stretched out across gravity
    sag = np.exp(rng.uniform(*np.log(_SAG)))
    gravity = min(_GRAVITY, sag * np.min(arm.stiffness / heaviest))
    zero = rng.uniform(-np.pi, np.pi)
    arm = replace(arm, gravity=[0.0, -gravity], offset=[-0.5 * np.pi - zero, 0.0])
    return replace(robot, arm=arm), replace(
        gains, torque_limit=gains.torque_limit + _TO_SPARE * gravity * heaviest)


def draw_supply(rng, time):
    """
    Return the voltage (T,) of a supply that others use as well, true and as measured.

    Falling by up to 1 V, with others switching another volt, noise of 10 mV [V].
    """
    turns = np.sort(rng.uniform(0.0, time[-1], max(int(time[-1] / 4.0), 1)))
    switched = np.searchsorted(turns, time) % 2 * rng.uniform(0.5, 1.5)
    true = NOMINAL_SUPPLY - rng.uniform(0.3, 1.0) * time / time[-1] - switched
    return true, true + 0.01 * rng.standard_normal(len(time))


def mass_moments(arm):
    """Return the mass moment of each link about its joint, what it carries included [kg m]."""
    return arm.mass * arm.com + carried_masses(arm) * arm.length


def carried_masses(arm):
    """Return the mass of all links beyond each, shape (n_joints,) [kg]."""
    return np.array([arm.mass[j + 1:].sum() for j in range(arm.n_joints)])


def with_base_parameters(arm, factors):
    """
    Return a chain of two links in a plane, same masses and lengths, base parameters scaled.

    ``factors`` (4,) are of the inertia of link 1 with the mass it carries, of the coupling l1 m2
    c2, of the inertia of link 2 about its joint, and of the mass moment of link 1 with the mass it
    carries.
    """
    carried = arm.mass[1] * arm.length[0] ** 2
    about_joint = arm.inertia + arm.mass * arm.com ** 2
    com = arm.com * [1.0, factors[1]]
    com[0] += (factors[3] - 1.0) * mass_moments(arm)[0] / arm.mass[0]
    whole = np.array([(about_joint[0] + carried) * factors[0] - carried,
                      about_joint[1] * factors[2]])
    return replace(arm, com=com, inertia=whole - arm.mass * com ** 2)


def base_parameters(arm):
    """
    Return the inertia of each link about its joint with the mass it carries, and the coupling.

    Of two links in a plane: shape (2,), and l1 m2 c2, scalar [kg m^2].
    """
    about_joint = arm.inertia + arm.mass * arm.com ** 2
    return (about_joint + carried_masses(arm) * arm.length ** 2,
            arm.length[0] * arm.mass[1] * arm.com[1])


def uniform_errors(rng, low=0.01, high=0.03):
    """Return a function (kind, *shape) that draws relative errors of a size, either way."""
    def draw(kind, *shape):
        return rng.uniform(low, high, shape) * rng.choice([-1.0, 1.0], shape)
    return draw


def draw_belief(rng, robot, errors=uniform_errors):
    """
    Return the robot, without its effects, as its user believes it to be.

    ``errors`` returns, given ``rng``, a function that draws the relative errors of a kind of
    parameters; by default each is 1 to 3 % off.
    """
    drawn = errors(rng)

    def factors(kind, *shape):
        return 1.0 + drawn(kind, *shape)

    arm = replace(_believed_links(robot.arm, factors),
                  motor_inertia=robot.arm.motor_inertia * factors('motor_inertia', 2),
                  stiffness=robot.arm.stiffness * factors('stiffness', 2))
    friction, sides = robot.friction, []
    for steady in (friction.forward, friction.backward):
        level = factors('level', 2)
        sides.append(StribeckParams(
            static=steady.static * level, coulomb=steady.coulomb * level,
            velocity=steady.velocity * factors('velocity', 2),
            viscous=steady.viscous * factors('viscous', 2)))
    return replace(robot, arm=arm, effects=(), friction=replace(
        friction, forward=sides[0], backward=sides[1],
        stiffness=friction.stiffness * factors('blocks', 2, 1),
        attraction=friction.attraction * factors('attraction', 2)))


def _believed_links(arm, factors):
    """Return the arm with base parameters believed; those that no links can have are refused."""
    for _ in range(_TRIES):
        base = factors('inertia', 3)
        heavy = factors('inertia', 1) if np.any(arm.gravity) else [1.0]
        try:
            return with_base_parameters(arm, np.append(base, heavy))
        except ParameterError:
            continue
    raise SimulationError(f'none of {_TRIES} beliefs on the inertia of the links is that of links')
