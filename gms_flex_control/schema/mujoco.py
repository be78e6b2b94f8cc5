# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A robot as MuJoCo's XML (MJCF), in the elements that MuJoCo has for its parts.

A flexible joint is two hinges, link and motor, with a fixed tendon as spring between them; a
motor turns beside its link, as in Eq. (1). A friction block is a tendon on the link that yields
at the Coulomb level. Passive DC motors, which have no input, add the rest: the Stribeck curve as
LuGre friction with a Coulomb level of zero, viscous friction of one direction as braking that is
clamped in the other, ripple as cogging. A constant torque is a weak joint spring with its rest
far away: an actuator would add an input.
"""

from dataclasses import dataclass, field
from functools import partial
import math
from operator import attrgetter
from xml.etree import ElementTree
from xml.etree.ElementTree import Comment, SubElement

from gms_flex_control.effects.registry import find
from gms_flex_control.errors import ConfigError
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema.target import Target
import numpy as np

TIMESTEP = 5e-4      # [s]
_LARGEST_PHASE = 1.0  # of the stiffest spring in a step: 2 is where semi-implicit Euler breaks
_FAR = 1e6           # where the spring of a constant torque rests, and a stop of one side ends
_LEAST_MASS = 1e-9   # MuJoCo wants a mass where the robot file gives inertia alone [kg]
_HARD = {'solreffriction': '0.001 1', 'solimpfriction': '0.99 0.999 1e-6'}  # dry friction
_CLAMPS = {'forward': (-_FAR, 0.0), 'backward': (0.0, _FAR)}  # of torques against the motion
_SIGNS = np.array([1.0, -1.0])  # forward, backward
_FINER = 10.0 ** -0.5  # reach of an element of friction_hysteresis over that of the one before


@dataclass
class _Spring:
    """What stands between motor and link."""

    stiffness: float
    damping: float
    cubic: float = 0.0
    rest: tuple = (0.0, 0.0)   # torsion of the unloaded spring, from and to
    parallel: list = field(default_factory=list)  # beside the spring: (force, yield)


@dataclass
class _Drive:
    """What an actuator makes of the torque that is asked."""

    gain: float = 1.0
    asked: float = math.inf    # largest torque that can be asked of it
    given: float = math.inf    # largest torque behind its lag
    lag: float = 0.0
    delay: float = 0.0


@dataclass
class _Joint:
    """What MuJoCo's elements of one joint say; filled by effects, [N m, rad, s]."""

    viscous: np.ndarray        # forward, backward
    elements: list             # of friction: (stiffness, levels forward and backward)
    loss: np.ndarray           # dry friction without stiffness: forward, backward
    excess: np.ndarray         # static friction above Coulomb: forward, backward
    stribeck: np.ndarray       # velocity: forward, backward
    bristle: float             # stiffness of the excess
    spring: _Spring
    drive: _Drive = field(default_factory=_Drive)
    drag: float = 0.0
    link_torque: float = 0.0
    motor_torque: float = 0.0
    motor_viscous: float = 0.0
    motor_loss: float = 0.0
    stops: list = field(default_factory=list)    # (angle, stiffness)
    ripples: list = field(default_factory=list)  # (amplitude, order, phase)


def _friction_hysteresis(joint, force, reach):
    for _ in range(4):
        if force and reach:
            joint.elements.append((0.25 * force / reach, 0.25 * force * np.ones(2)))
        reach *= _FINER


def _actuator_saturation(joint, limit):
    drive = joint.drive
    before = limit / abs(drive.gain) if drive.gain else math.inf
    if drive.lag:
        drive.given = min(drive.given, before)
    else:
        drive.asked = min(drive.asked, before)


def _add(name, part=lambda joint: joint):
    def add(joint, value):
        setattr(part(joint), name, getattr(part(joint), name) + value)
    return add


def _torque_gain(joint, error):
    joint.drive.gain *= 1.0 + error


def _widen(joint, down, up):
    """Move the ends of the range in which the spring is unloaded."""
    low, high = joint.spring.rest
    joint.spring.rest = low - down, high + up


def _spring_hysteresis(joint, force, reach):
    if force and reach:
        joint.spring.parallel.append((force, reach))


_DRIVE, _SPRING = attrgetter('drive'), attrgetter('spring')
# what each effect changes; the order is that of the robot file within a stage
EFFECTS = {
    'actuator_lag': _add('lag', _DRIVE), 'actuator_saturation': _actuator_saturation,
    'backlash': lambda joint, half_gap: _widen(joint, half_gap, half_gap),
    'constant_link_torque': _add('link_torque'),
    'end_stop': lambda joint, *stop: joint.stops.append(stop),
    'friction_hysteresis': _friction_hysteresis,
    'input_delay': _add('delay', _DRIVE), 'motor_coulomb': _add('motor_loss'),
    'motor_torque_bias': _add('motor_torque'), 'motor_viscous': _add('motor_viscous'),
    'quadratic_drag': _add('drag'), 'spring_cubic': _add('cubic', _SPRING),
    'spring_damping': _add('damping', _SPRING),
    'spring_hysteresis': _spring_hysteresis,
    'spring_offset': lambda joint, offset: _widen(joint, offset, -offset),
    'torque_gain': _torque_gain,
    **dict.fromkeys(
        ('torque_ripple', 'torque_ripple_2', 'torque_ripple_3'),
        lambda joint, *ripple: joint.ripples.append(ripple)),
    'viscous_asymmetry': lambda joint, slope: _add('viscous')(joint, slope * _SIGNS),
    'viscous_error': _add('viscous'),
}
# what MuJoCo cannot put behind the one before on the same joint: a spring acts behind any play
_CLASHES = (('backlash', 'spring_offset'), ('backlash', 'spring_hysteresis'),
            ('actuator_lag', 'actuator_lag'))


def _also_lacks(robot):
    """Yield (name, where) of effects that MuJoCo has alone but not together on a joint."""
    for joint in robot.joints:
        names = sorted((spec.name for spec in robot.effects if spec.joint == joint),
                       key=lambda name: find(name).stage)
        for first, second in _CLASHES:
            if first in names and second in names[names.index(first) + 1:]:
                yield second, f'{joint} (behind {first})'


def mjcf(robot: RobotParams, without: tuple = (), timestep: float = TIMESTEP) -> str:
    """
    Return a robot with effects among `EFFECTS` as MJCF for MuJoCo 4 (str).

    Joints and actuators have the names of links and motors, in their order: first all links, then
    the motors of flexible joints; one input each [N m or N]. ``without`` ``presliding`` friction
    has no blocks: MuJoCo's dry friction takes their place. ConfigError if the ``timestep`` [s] is
    too long for the stiffest spring.
    """
    joints = [_joint(robot, j, 'presliding' in without) for j in range(robot.n_joints)]
    for spec in robot.effects:
        EFFECTS[spec.name](joints[robot.joints.index(spec.joint)], *spec.values)
    _require_short(robot, joints, timestep)
    root = ElementTree.Element('mujoco', model='arm')
    root.append(Comment(' Written by gms_flex export for MuJoCo 4 or later, in SI units. '))
    SubElement(root, 'compiler', angle='radian', autolimits='true')
    option = SubElement(root, 'option', timestep=_text(timestep),
                        gravity=_text(*robot.arm.gravity, 0.0), integrator='implicitfast')
    SubElement(option, 'flag', contact='disable')
    classes = SubElement(root, 'default')
    for name, clamp in _CLAMPS.items():
        SubElement(SubElement(classes, 'default', {'class': name}), 'general',
                   forcerange=_text(*clamp))
    world = SubElement(root, 'worldbody')
    tendons = SubElement(root, 'tendon')
    actuators = SubElement(root, 'actuator')
    parent = world
    for j, joint in enumerate(joints):
        parent = _link(parent if robot.arm.kind == 'planar' else world, robot, j, joint)
        _frictions(tendons, robot.joints[j], joint)
        _actuator(actuators, robot, j, joint, timestep)
    for j, joint in enumerate(joints):
        _passive(actuators, robot, j, joint)
    for j in np.flatnonzero(~robot.arm.rigid):
        _motor(world, robot, j, joints[j])
        _springs(tendons, robot, j, joints[j])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def target(timestep: float = TIMESTEP) -> Target:
    """Return MuJoCo as a `Target`, integrating with a step [s]."""
    return Target(title='MuJoCo', write=partial(mjcf, timestep=timestep),
                  parts=('attraction', 'stribeck_direction'), effects=tuple(EFFECTS),
                  also_lacks=_also_lacks)


def _joint(robot, j, dry):
    arm, friction = robot.arm, robot.friction
    coulomb, static, velocity, viscous = (
        np.array([getattr(side, name)[j] for side in (friction.forward, friction.backward)])
        for name in ('coulomb', 'static', 'velocity', 'viscous'))
    blocks = [(stiffness, weight * coulomb) for stiffness, weight in zip(
        friction.stiffness[j], friction.weight[j], strict=True) if stiffness * weight > 0.0]
    bristle = (1.0 - coulomb.sum() / static.sum()) * sum(block[0] for block in blocks)
    return _Joint(viscous=viscous, elements=[] if dry else blocks,
                  loss=coulomb if dry else np.zeros(2), excess=static - coulomb,
                  stribeck=velocity, bristle=bristle,
                  spring=_Spring(arm.stiffness[j], arm.damping[j]))


def _require_short(robot, joints, timestep):
    """Raise ConfigError if a step is too long for the springs of a joint."""
    arm = robot.arm
    link = arm.link_inertia + np.where(arm.rigid, arm.motor_inertia, 0.0)
    for j, joint in enumerate(joints):
        on_link = joint.bristle + sum(element[0] for element in joint.elements) + sum(
            stop[1] for stop in joint.stops)
        spring = 0.0 if arm.rigid[j] else joint.spring.stiffness + sum(
            force / reach for force, reach in joint.spring.parallel)
        fastest = (on_link + spring) / link[j]
        if not arm.rigid[j]:
            fastest = max(fastest, spring * (1.0 / link[j] + 1.0 / arm.motor_inertia[j]))
        if math.sqrt(fastest) * timestep > _LARGEST_PHASE:
            raise ConfigError(f'--timestep {timestep:g}: the springs of {robot.joints[j]} need '
                              f'{_LARGEST_PHASE / math.sqrt(fastest):.1g} s or less')


def _link(parent, robot, j, joint):
    """Add a link with its joint; return its body."""
    arm = robot.arm
    rigid = bool(arm.rigid[j])
    place = arm.length[j - 1] if j and arm.kind == 'planar' else 0.0
    body = SubElement(parent, 'body', name=f'{robot.joints[j]}_link', pos=_text(place, 0.0, 0.0),
                      euler=_text(0.0, 0.0, arm.offset[j]))
    bias = 0.5 * _SIGNS @ (joint.loss + sum(levels for _, levels in joint.elements))
    moves = _moving(body, arm, robot.joints[j],
                    joint.viscous.min() + rigid * joint.motor_viscous,
                    joint.loss.mean() + rigid * joint.motor_loss,
                    joint.link_torque + rigid * joint.motor_torque - bias, joint.drag)
    if rigid:
        moves.set('armature', _text(arm.motor_inertia[j]))
    slides = arm.axes == 'linear'
    mass, inertia = (arm.inertia[j], 0.0) if slides else (arm.mass[j], arm.inertia[j])
    SubElement(body, 'inertial', pos=_text(arm.com[j], 0.0, 0.0),
               mass=_text(max(mass, _LEAST_MASS)),
               diaginertia=_text(*[max(inertia, _LEAST_MASS)] * 3))
    length = arm.length[j] or 2.0 * arm.com[j] or 0.2
    SubElement(body, 'geom', type='capsule', size=_text(0.05 * abs(length)),
               fromto=_text(0.0, 0.0, 0.0, length, 0.0, 0.0), mass='0')
    return body


def _motor(world, robot, j, joint):
    """Add the rotor of a flexible joint; its inertia is the armature of its own joint."""
    body = SubElement(world, 'body', name=f'{robot.motors[j]}_rotor')
    moves = _moving(body, robot.arm, robot.motors[j], joint.motor_viscous, joint.motor_loss,
                    joint.motor_torque)
    moves.set('armature', _text(robot.arm.motor_inertia[j]))
    SubElement(body, 'inertial', pos='0 0 0', mass=_text(_LEAST_MASS),
               diaginertia=_text(*[_LEAST_MASS] * 3))


def _moving(body, arm, name, viscous, loss, torque, drag=0.0):
    """Add the hinge, of a linear axis the slide, of a body."""
    kind, axis = ('slide', '1 0 0') if arm.axes == 'linear' else ('hinge', '0 0 1')
    joint = SubElement(body, 'joint', name=name, type=kind, axis=axis)
    if viscous or drag:
        joint.set('damping', _text(viscous, *([drag] if drag else [])))
    if loss:
        joint.attrib.update(frictionloss=_text(loss), **_HARD)
    if torque:
        joint.attrib.update(stiffness=_text(abs(torque) / _FAR),
                            springref=_text(math.copysign(_FAR, torque)))
    return joint


def _frictions(tendons, name, joint):
    """Add friction blocks and end stops of a link."""
    for k, (stiffness, levels) in enumerate(joint.elements, start=1):
        _tendon(tendons, f'{name}_block{k}', {name: 1.0}, stiffness, springlength=_text(0.0),
                springyield=_text(levels.mean() / stiffness))
    for k, (angle, stiffness) in enumerate(joint.stops, start=1):
        if angle and stiffness:
            free = (-_FAR, angle) if angle > 0.0 else (angle, _FAR)
            _tendon(tendons, f'{name}_stop{k}', {name: 1.0}, stiffness, springlength=_text(*free))


def _springs(tendons, robot, j, joint):
    """Add the spring between motor and link, and what yields beside it."""
    ends, spring = {robot.motors[j]: 1.0, robot.joints[j]: -1.0}, joint.spring
    polynomial = (spring.stiffness, *((0.0, spring.cubic) if spring.cubic else ()))
    _tendon(tendons, f'{robot.joints[j]}_spring', ends, *polynomial,
            springlength=_text(*spring.rest), damping=_text(spring.damping))
    for k, (force, reach) in enumerate(spring.parallel, start=1):
        _tendon(tendons, f'{robot.joints[j]}_hysteresis{k}', ends, force / reach,
                springlength=_text(0.0), springyield=_text(reach))


def _tendon(tendons, name, coefficients, *stiffness, **attributes):
    fixed = SubElement(tendons, 'fixed', name=name, stiffness=_text(*stiffness), **attributes)
    for joint, coefficient in coefficients.items():
        SubElement(fixed, 'joint', joint=joint, coef=_text(coefficient))


def _actuator(actuators, robot, j, joint, timestep):
    name, drive = robot.motors[j] or robot.joints[j], joint.drive
    actuator = SubElement(actuators, 'general', name=name, joint=name, gear=_text(drive.gain))
    for attribute, limit in (('ctrlrange', drive.asked), ('forcerange', drive.given)):
        if limit < math.inf:
            actuator.set(attribute, _text(-limit, limit))
    lag = drive.lag - 0.5 * timestep  # MuJoCo holds the torque at the beginning of a step
    if lag > 0.0:
        actuator.attrib.update(dyntype='filterexact', dynprm=_text(lag))
    if drive.delay:
        actuator.attrib.update(delay=_text(drive.delay), interp='linear',
                               nsample=str(math.ceil(drive.delay / timestep) + 2))


def _passive(actuators, robot, j, joint):
    """Add Stribeck curve, viscous friction of one direction and ripple of a joint."""
    name = robot.joints[j]
    if joint.excess.any():
        _dc_motor(actuators, f'{name}_stribeck', name, lugre=_text(
            joint.bristle, 0.0, 0.0, joint.excess.mean(), joint.stribeck.mean()))
    beyond = joint.viscous - joint.viscous.min()
    for way, viscous in zip(_CLAMPS, beyond, strict=True):
        if viscous:
            motor = _dc_motor(actuators, f'{name}_{way}', name, motorconst=math.sqrt(viscous))
            motor.set('class', way)
    for k, ripple in enumerate(joint.ripples, start=1):
        _dc_motor(actuators, f'{name}_ripple{k}', robot.motors[j] or name, cogging=_text(*ripple))


def _dc_motor(actuators, name, joint, motorconst=0.0, **attributes):
    return SubElement(actuators, 'dcmotor', name=name, joint=joint, input='none', resistance='1',
                      motorconst=_text(motorconst), **attributes)


def _text(*numbers):
    return ' '.join(f'{float(number) + 0.0:.12g}' for number in numbers)
