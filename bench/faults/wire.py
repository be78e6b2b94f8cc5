# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Messages as a bench makes and reads them, right ones and wrong ones."""

from gms_flex_control.nodes.messages import read_marks, set_stamp, to_nanoseconds
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

JOINTS = ['joint1', 'joint2']
NAMES = [*JOINTS, 'joint1_motor', 'joint2_motor']


def joint_state(stamp, position=(0.0,) * 4, *, names=NAMES, velocity=None):
    """Return a JointState of ``stamp`` [ns]; at rest unless a velocity is given."""
    message = JointState(name=list(names), position=list(position),
                         velocity=[0.0] * len(position) if velocity is None else list(velocity))
    set_stamp(message.header.stamp, stamp)
    return message


def array_message(data, *labels):
    """Return a Float64MultiArray of ``data`` with a dimension of size 1 for each label."""
    message = Float64MultiArray(data=[float(value) for value in data])
    message.layout.dim = [MultiArrayDimension(label=label, size=1, stride=1) for label in labels]
    return message


def stamp_of(message):
    """Return the stamp of a JointState, or that in the labels of an array [ns]."""
    if hasattr(message, 'header'):
        return to_nanoseconds(message.header.stamp)
    return read_marks(message)[0]


def as_value(value):
    """Return a Python value as the ParameterValue of its own type."""
    fields = {bool: ('BOOL', 'bool_value'), int: ('INTEGER', 'integer_value'),
              float: ('DOUBLE', 'double_value'), str: ('STRING', 'string_value'),
              list: ('DOUBLE_ARRAY', 'double_array_value'), type(None): ('NOT_SET', None)}
    name, field = fields[type(value)]
    message = ParameterValue(type=getattr(ParameterType, f'PARAMETER_{name}'))
    if field:
        setattr(message, field, value)
    return message


def as_parameter(name, value):
    """Return a Parameter, '__' in its name for '.'."""
    return Parameter(name=name.replace('__', '.'), value=as_value(value))
