# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A robot as URDF: links, motors and inertias, for robot_state_publisher, RViz and simulators."""

from xml.etree import ElementTree
from xml.etree.ElementTree import Comment, SubElement

from gms_flex_control.hardware.limits import UNLIMITED
from gms_flex_control.params.arm import in_units
import numpy as np

BASE = 'base'
_LEAST_MASS = 1e-6   # URDF readers want a mass where the robot file gives inertia alone [kg]
_ROD = 0.05          # inertia about the long axis over that about the others
_COLOURS = {'link': '0.35 0.55 0.80 1', 'motor': '0.90 0.55 0.20 1', 'base': '0.5 0.5 0.5 1'}
_NOTE = """
  The plane of motion is x, y; gravity in it is {gravity} m/s^2, which URDF cannot say.
  Friction is the mean of both directions, Coulomb and viscous: presliding and the Stribeck
  curve stand in the robot file alone.
  {motors}
"""
_WITH_MOTORS = """Link and motor of a flexible joint are joints of their own, as in /joint_states.
  URDF has no springs: each is a comment at its motor. Motor inertia is as seen at the joint; a
  simulator turns it with the link before it, which the model of this package does not."""
_WITHOUT_MOTORS = 'Motors and springs are left out; a joint stands for its link side.'


def robot_urdf(robot, *, name='arm', motors=True, limits=None, plugin='') -> str:
    """
    Return a robot as URDF text.

    A planar chain, or decoupled axes, which are put side by side; a robot that has a URDF gets
    that one back, friction put in, its links and limits its own. One joint per link and motor,
    about z, named as in the robot: ``revolute`` where ``limits`` give a range, else
    ``continuous``; of linear axes ``prismatic`` along x. ``motors`` is whether flexible joints get
    a joint of their own for the motor, ``plugin`` the hardware interface of a ``<ros2_control>``
    block, '' for no block.
    """
    if robot.arm.frames is not None:
        return _with_friction(robot)
    root = ElementTree.Element('robot', name=name)
    root.append(Comment(_NOTE.format(
        gravity=' '.join(f'{value + 0.0:g}' for value in robot.arm.gravity),
        motors=_WITH_MOTORS if motors else _WITHOUT_MOTORS)))
    for material, colour in _COLOURS.items():
        SubElement(SubElement(root, 'material', name=material), 'color', rgba=colour)
    size = _sizes(robot.arm)
    base = SubElement(root, 'link', name=BASE)
    _visual(base, 'base', (0.0, 0.0, -0.03), cylinder=(0.3 * size[0], 0.02))
    for j in range(robot.n_joints):
        _add_link(root, robot, j, size)
        if motors and not robot.arm.rigid[j]:
            _add_motor(root, robot, j, size)
    if limits is not None:
        _limit(root, robot, limits)
    if plugin:
        _add_ros2_control(root, robot, name, motors, plugin)
    return _document(root)


def _document(root):
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _with_friction(robot):
    """Return the URDF that a robot comes from with its friction in it."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.parse(robot.arm.frames.source, parser).getroot()
    for joint in root.findall('joint'):
        if joint.get('name') in robot.joints:
            for old in joint.findall('dynamics'):
                joint.remove(old)
            _dynamics(joint, robot, robot.joints.index(joint.get('name')))
    return _document(root)


def _dynamics(joint, robot, j):
    """Write the mean friction of both directions."""
    forward, backward = robot.friction.forward, robot.friction.backward
    SubElement(joint, 'dynamics', damping=_text((forward.viscous[j] + backward.viscous[j]) / 2),
               friction=_text((forward.coulomb[j] + backward.coulomb[j]) / 2))


def _sizes(arm):
    """Return a drawn length for each link (n_joints,) [m]."""
    known = np.where(arm.length > 0.0, arm.length, 2.0 * np.abs(arm.com))
    return np.where(known > 0.0, known, known.max() if known.max() > 0.0 else 0.2)


def _frame(robot, j, size):
    """Return parent link and origin of joint j."""
    if robot.arm.kind == 'decoupled':
        return BASE, (0.0, 1.5 * size.max() * j, 0.0)
    if j == 0:
        return BASE, (0.0, 0.0, 0.0)
    return _link_name(robot, j - 1), (robot.arm.length[j - 1], 0.0, 0.0)


def _link_name(robot, j):
    return f'{robot.joints[j]}_link'


def _add_link(root, robot, j, size):
    arm = robot.arm
    parent, place = _frame(robot, j, size)
    link = SubElement(root, 'link', name=_link_name(robot, j))
    _visual(link, 'link', (0.5 * size[j], 0.0, 0.0), box=(size[j], 0.12 * size[j], 0.02))
    inertia = arm.inertia[j]
    if arm.axes == 'linear':
        _inertial(link, inertia, 0.0, (0.0,) * 3)
    else:
        _inertial(link, arm.mass[j], arm.com[j], (_ROD * inertia, inertia, inertia))
    joint = _joint(root, arm, j, robot.joints[j], parent, _link_name(robot, j), place)
    if arm.rigid[j] and arm.motor_inertia[j] > 0.0:
        joint.append(Comment(
            in_units(arm, f' rigid joint: motor inertia {arm.motor_inertia[j]:g} kg m^2 comes '
                          'on top ')))
    _dynamics(joint, robot, j)


def _add_motor(root, robot, j, size):
    arm, motor = robot.arm, robot.motors[j]
    parent, place = _frame(robot, j, size)
    rotor = SubElement(root, 'link', name=f'{motor}_link')
    _visual(rotor, 'motor', (0.0, 0.0, 0.03), cylinder=(0.12 * size[j], 0.03))
    _visual(rotor, 'motor', (0.15 * size[j], 0.0, 0.05), box=(0.3 * size[j], 0.02, 0.01))
    slides, inertia = arm.axes == 'linear', arm.motor_inertia[j]
    _inertial(rotor, slides * inertia, 0.0, ((not slides) * inertia,) * 3)
    joint = _joint(root, arm, j, motor, parent, f'{motor}_link', place)
    joint.append(Comment(
        f' spring to its link: {arm.stiffness[j]:g} N m/rad, {arm.damping[j]:g} N m s/rad '))


def _limit(root, robot, limits):
    """Limit all joints; a motor has no range of its own, its spring gives way."""
    for joint in root.iter('joint'):
        called = joint.get('name')
        ranged = called in robot.joints
        j = (robot.joints if ranged else robot.motors).index(called)
        limit = {'effort': _text(limits.torque[j]), 'velocity': _text(limits.velocity[j])}
        if ranged and max(-limits.lower[j], limits.upper[j]) < UNLIMITED:
            if joint.get('type') == 'continuous':
                joint.set('type', 'revolute')
            limit |= _range(limits.lower[j], limits.upper[j])
        old = joint.find('limit')
        if old is None:
            joint.insert(4, ElementTree.Element('limit', limit))
        else:
            old.attrib.update(limit)


def _add_ros2_control(root, robot, name, motors, plugin):
    """Say which joints take efforts and what is measured of each, as ros2_control reads it."""
    system = SubElement(root, 'ros2_control', name=name, type='system')
    hardware = SubElement(system, 'hardware')
    SubElement(hardware, 'plugin').text = plugin
    driven = [motor if motors and motor else joint
              for joint, motor in zip(robot.joints, robot.motors, strict=True)]
    for called in dict.fromkeys([*robot.joints, *driven]):
        joint = SubElement(system, 'joint', name=called)
        if called in driven:
            SubElement(joint, 'command_interface', name='effort')
        for what in ('position', 'velocity', *(['effort'] if called in driven else [])):
            SubElement(joint, 'state_interface', name=what)


def _joint(root, arm, j, name, parent, child, place):
    slides = arm.axes == 'linear'
    joint = SubElement(root, 'joint', name=name, type='prismatic' if slides else 'continuous')
    SubElement(joint, 'parent', link=parent)
    SubElement(joint, 'child', link=child)
    angle = 0.0 if slides else arm.offset[j]
    SubElement(joint, 'origin', xyz=_text(*place), rpy=_text(0.0, 0.0, angle))
    SubElement(joint, 'axis', xyz='1 0 0' if slides else '0 0 1')
    if slides:  # URDF wants them
        SubElement(joint, 'limit', _range(-UNLIMITED, UNLIMITED) | dict.fromkeys(
            ('effort', 'velocity'), _text(UNLIMITED)))
    return joint


def _range(lower, upper):
    return {'lower': _text(lower), 'upper': _text(upper)}


def _inertial(link, mass, com, diagonal):
    inertial = SubElement(link, 'inertial')
    SubElement(inertial, 'origin', xyz=_text(com, 0.0, 0.0))
    SubElement(inertial, 'mass', value=_text(max(mass, _LEAST_MASS)))
    ixx, iyy, izz = (_text(max(value, 1e-12)) for value in diagonal)
    SubElement(inertial, 'inertia', ixx=ixx, ixy='0', ixz='0', iyy=iyy, iyz='0', izz=izz)


def _visual(link, material, place, *, box=None, cylinder=None):
    """Add a shape: the sides of a box, or radius and length of a cylinder [m]."""
    visual = SubElement(link, 'visual')
    SubElement(visual, 'origin', xyz=_text(*place))
    geometry = SubElement(visual, 'geometry')
    if box:
        SubElement(geometry, 'box', size=_text(*box))
    else:
        SubElement(geometry, 'cylinder', radius=_text(cylinder[0]), length=_text(cylinder[1]))
    SubElement(visual, 'material', name=material)


def _text(*numbers):
    """Return numbers so that they are read back as they are."""
    return ' '.join(repr(float(number)) for number in numbers)
