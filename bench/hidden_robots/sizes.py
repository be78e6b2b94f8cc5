# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""How large a hidden effect is: drawn as the main one or as one of many, and by its torque."""

from dataclasses import replace
from typing import NamedTuple

from bench.hidden_robots.plants import carried_masses, mass_moments, NOMINAL_SUPPLY
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.effects.registry import find
from gms_flex_control.params.robot import EffectSpec, WHOLE_ARM
from gms_flex_control.simulation import plant
import numpy as np
from scipy.ndimage import uniform_filter1d

_GRAVITY = 9.81
REACH = 1e-3  # over which friction by load changes its direction [rad]
_OVER = 0.06  # time over which torque is averaged: quicker it hardly moves an arm [s]


class Figures(NamedTuple):
    """What a run without effects looks like on one joint; rms unless said otherwise."""

    stiffness: float     # K [N m/rad]
    motor_inertia: float  # [kg m^2]
    static: float        # F_s [N m]
    coulomb: float       # F_c [N m]
    viscous: float       # [N m s/rad]
    moment: float        # mass moment about the joint [kg m]
    inertia: float       # seen by the joint, the others at rest [kg m^2]
    reach: float         # distance of the tip from the joint, arm stretched [m]
    torsion: float       # [rad]
    torsion_cubed: float  # [rad^3]
    torsion_rate: float  # [rad/s]
    speed: float         # of the link [rad/s]
    speed_squared: float
    acceleration: float  # of the link [rad/s^2]
    motor_speed: float   # [rad/s]
    torque: float        # [N m]
    peak: float          # torque exceeded in 0.5 % of the time [N m]
    lowest: float        # link angle [rad]
    highest: float
    duration: float      # [s]


def rms(signal):
    """Return the root mean square over the first axis."""
    return np.sqrt(np.mean(np.asarray(signal) ** 2, axis=0))


def figures_of(robot, motion, period):
    """Return the Figures of each joint in the run (Motion) of a robot without effects."""
    arm, friction = robot.arm, robot.friction
    q, v, q_motor, v_motor = np.moveaxis(motion.true, 1, 0)
    torsion, a = q_motor - q, np.gradient(v, period, axis=0)
    reach = np.cumsum(arm.length[::-1])[::-1]
    columns = {
        'stiffness': arm.stiffness, 'motor_inertia': arm.motor_inertia,
        'static': friction.forward.static, 'coulomb': friction.forward.coulomb,
        'viscous': friction.forward.viscous, 'moment': mass_moments(arm),
        'inertia': arm.inertia + arm.mass * arm.com ** 2 + carried_masses(arm) * arm.length ** 2,
        'reach': reach,
        'torsion': rms(torsion), 'torsion_cubed': rms(torsion ** 3),
        'torsion_rate': rms(v_motor - v),
        'speed': rms(v), 'speed_squared': rms(v * v), 'acceleration': rms(a),
        'motor_speed': rms(v_motor),
        'torque': rms(motion.command), 'peak': np.quantile(np.abs(motion.command), 0.995, axis=0),
        'lowest': q.min(axis=0), 'highest': q.max(axis=0),
        'duration': np.full(robot.n_joints, len(q) * period)}
    return [Figures(**{name: float(column[j]) for name, column in columns.items()})
            for j in range(robot.n_joints)]


def between(rng, low, high):
    """Return a number between two, uniform in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def either(rng, low, high):
    """Return `between` with a sign drawn as well."""
    return between(rng, low, high) * float(rng.choice([-1.0, 1.0]))


def angle(rng):
    """Return a phase [rad]."""
    return float(rng.uniform(-np.pi, np.pi))


def end_stop(rng, k):
    """Return a stop that the motion runs into on one side of zero."""
    side = k.highest if rng.random() < 0.5 else k.lowest
    side = side if abs(side) > 0.3 else (k.highest if k.highest > -k.lowest else k.lowest)
    return {'angle': side * float(rng.uniform(0.75, 0.95)), 'stiffness': between(rng, 2.0, 20.0)}


# name: values of a main effect, in the ranges labs meet, drawn for figures k of its joint
MAIN = {
    'backlash': lambda r, k: {'half_gap': between(r, 0.02, 0.3) * k.torsion},
    'spring_cubic': lambda r, k: {
        'cubic': between(r, 0.05, 0.5) * k.stiffness / (2.0 * k.torsion) ** 2},
    'spring_damping': lambda r, k: {'damping': between(r, 3e-3, 3e-2)},
    'spring_hysteresis': lambda r, k: {'force': between(r, 3e-3, 20e-3),
                                       'yield': between(r, 0.05, 0.5) * k.torsion},
    'stiffness_error': lambda r, k: {'ratio': either(r, 0.06, 0.25)},
    'stiffness_drift': lambda r, k: {'ratio': either(r, 0.06, 0.25), 'duration': k.duration},
    'spring_offset': lambda r, k: {'offset': either(r, 0.03, 0.2) * k.torsion},
    'motor_viscous': lambda r, k: {'viscous': between(r, 2e-3, 30e-3)},
    'motor_coulomb': lambda r, k: {'coulomb': between(r, 2e-3, 30e-3)},
    'torque_ripple': lambda r, k: {'amplitude': between(r, 2e-3, 15e-3),
                                   'order': float(r.integers(4, 37)), 'phase': angle(r)},
    'torque_gain': lambda r, k: {'gain_error': either(r, 0.06, 0.25)},
    'actuator_lag': lambda r, k: {'time_constant': between(r, 3e-3, 20e-3)},
    'input_delay': lambda r, k: {'delay': between(r, 3e-3, 20e-3)},
    'actuator_deadzone': lambda r, k: {'deadzone': between(r, 4e-3, 40e-3)},
    'actuator_saturation': lambda r, k: {'limit': between(r, 0.3, 0.75) * k.peak},
    'motor_torque_bias': lambda r, k: {'bias': either(r, 6e-3, 40e-3)},
    'constant_link_torque': lambda r, k: {'bias': either(r, 6e-3, 40e-3)},
    'coulomb_error': lambda r, k: {'ratio': either(r, 0.15, 0.5)},
    'viscous_error': lambda r, k: {
        'slope': between(r, 0.15, 0.5) * max(k.viscous, 0.5 * k.coulomb / k.speed)},
    'stribeck_error': lambda r, k: {'ratio': between(r, 0.15, 0.5)},
    'presliding_error': lambda r, k: {'stiffness': -between(r, 0.3, 0.7)},
    'friction_asymmetry': lambda r, k: {'ratio': either(r, 0.04, 0.25)},
    'position_friction': lambda r, k: {'ratio': between(r, 0.05, 0.35),
                                       'order': float(r.integers(1, 6)), 'phase': angle(r)},
    'load_friction': lambda r, k: {
        'ratio': between(r, 0.02, 0.15) * k.static / (k.stiffness * k.torsion), 'reach': REACH},
    'friction_drift': lambda r, k: {'ratio': either(r, 0.1, 0.5), 'duration': k.duration},
    'quadratic_drag': lambda r, k: {'drag': between(r, 8e-3, 8e-2)},
    'gravity_tilt': lambda r, k: {'tilt': np.radians(between(r, 0.1, 1.5)),
                                  'direction': angle(r)},
    'tip_payload': lambda r, k: {'mass': between(r, 0.03, 0.3)},
    'link_inertia_error': lambda r, k: {'ratio': either(r, 0.1, 0.5)},
    'motor_inertia_error': lambda r, k: {'ratio': either(r, 0.1, 0.5)},
    'motor_inertia_coupling': lambda r, k: {'inertia': between(r, 0.3, 1.5) * k.motor_inertia},
    'base_flexibility': lambda r, k: {'frequency': between(r, 4.0, 12.0),
                                      'inertia': between(r, 0.5, 3.0) * k.inertia,
                                      'damping': between(r, 0.02, 0.1)},
    'end_stop': end_stop,
    'kinematic_error': lambda r, k: {'amplitude': between(r, 0.02, 0.2) * k.torsion,
                                     'phase': angle(r)},
    'link_encoder_eccentricity': lambda r, k: {'amplitude': between(r, 0.02, 0.2) * k.torsion,
                                               'phase': angle(r)},
    'encoder_skew': lambda r, k: {'delay': either(r, 0.5e-3, 5e-3)},
    'supply_sag': lambda r, k: {'ratio': between(r, 0.03, 0.1), 'nominal': NOMINAL_SUPPLY},
}
# likewise, of those that are only hidden where they are asked for: seeds keep their robots
ASKED = {
    'low_speed_friction': lambda r, k: {'ratio': either(r, 0.15, 0.5),
                                        'velocity': between(r, 0.05, 0.4) * k.speed},
    'shear_thinning': lambda r, k: {'torque': between(r, 0.1, 0.4) * k.static,
                                    'velocity': between(r, 0.2, 1.5) * k.speed,
                                    'speed': 2.0 * k.speed},
    'viscous_asymmetry': lambda r, k: {
        'slope': either(r, 0.15, 0.5) * max(k.viscous, 0.5 * k.coulomb / k.speed)},
}

# name: values with which the torque of the effect is t [N m], about, for figures k of its joint
SMALL = {
    'backlash': lambda r, k, t: {'half_gap': t / k.stiffness},
    'spring_cubic': lambda r, k, t: {'cubic': t / k.torsion_cubed},
    'spring_damping': lambda r, k, t: {'damping': t / k.torsion_rate},
    'spring_hysteresis': lambda r, k, t: {'force': t, 'yield': 0.3 * k.torsion},
    'stiffness_error': lambda r, k, t: {'ratio': either(r, 1, 1) * t / k.stiffness / k.torsion},
    'stiffness_drift': lambda r, k, t: {'ratio': 1.7 * t / k.stiffness / k.torsion,
                                        'duration': k.duration},
    'spring_offset': lambda r, k, t: {'offset': either(r, 1, 1) * t / k.stiffness},
    'motor_viscous': lambda r, k, t: {'viscous': t / k.motor_speed},
    'motor_coulomb': lambda r, k, t: {'coulomb': t},
    'torque_ripple': lambda r, k, t: {'amplitude': 1.4 * t, 'order': float(r.integers(4, 37)),
                                      'phase': angle(r)},
    'torque_gain': lambda r, k, t: {'gain_error': either(r, 1, 1) * t / k.torque},
    'actuator_lag': lambda r, k, t: {
        'time_constant': min(t / k.stiffness / k.torsion_rate, 2e-3)},
    'actuator_deadzone': lambda r, k, t: {'deadzone': t},
    'motor_torque_bias': lambda r, k, t: {'bias': either(r, 1, 1) * t},
    'constant_link_torque': lambda r, k, t: {'bias': either(r, 1, 1) * t},
    'friction_asymmetry': lambda r, k, t: {'ratio': either(r, 1, 1) * t / k.static},
    'position_friction': lambda r, k, t: {'ratio': 1.4 * t / k.static,
                                          'order': float(r.integers(1, 6)), 'phase': angle(r)},
    'load_friction': lambda r, k, t: {'ratio': t / (k.stiffness * k.torsion), 'reach': REACH},
    'friction_drift': lambda r, k, t: {'ratio': either(r, 1, 1) * 1.7 * t / k.static,
                                       'duration': k.duration},
    'quadratic_drag': lambda r, k, t: {'drag': t / k.speed_squared},
    'gravity_tilt': lambda r, k, t: {'tilt': t / (_GRAVITY * k.moment), 'direction': angle(r)},
    'tip_payload': lambda r, k, t: {'mass': min(t / (k.reach ** 2 * k.acceleration), 0.03)},
    'motor_inertia_error': lambda r, k, t: {
        'ratio': either(r, 1, 1) * min(t / (k.motor_inertia * k.acceleration), 0.1)},
    'kinematic_error': lambda r, k, t: {'amplitude': 1.4 * t / k.stiffness, 'phase': angle(r)},
    'link_encoder_eccentricity': lambda r, k, t: {'amplitude': 1.4 * t / k.stiffness,
                                                  'phase': angle(r)},
    'encoder_skew': lambda r, k, t: {
        'delay': either(r, 1, 1) * min(t / k.stiffness / k.motor_speed, 0.5e-3)},
}
_JOINT_OF = {'motor_inertia_coupling': 1, 'base_flexibility': 0}  # where there is only one


def place(rng, name, joints):
    """Return the index of the joint an effect stands on, drawn where there is a choice."""
    drawn = int(rng.integers(len(joints)))
    return 0 if find(name).whole_arm else _JOINT_OF.get(name, drawn)


def spec(name, joint, joints, given):
    """Return the EffectSpec of an effect with values by name on the joint of an index."""
    kind = find(name)
    where = WHOLE_ARM if kind.whole_arm else joints[joint]
    return EffectSpec(name=name, joint=where,
                      values=kind.values(given, f'effects.{where}.{name}'))


class Torques:
    """What effects make of the Recording of a robot without effects."""

    def __init__(self, recording, robot):
        self._robot, self._motion = robot, motion_of(recording, robot)
        self._without = self._residual(robot)

    def _residual(self, robot):
        return unexplained(self._motion, plant.constants_of(robot))

    def of(self, spec):
        """Return the rms torque of an EffectSpec, of the larger equation [N m]."""
        change = self._residual(replace(self._robot, effects=(spec,))) - self._without
        width = max(round(_OVER / self._motion.period), 1)
        slow = uniform_filter1d(change, width, axis=0, mode='nearest')
        return float(rms(slow).max())
