# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The parameters of a plant node that is safe, and of one that is the bridge to a robot."""

from gms_flex_control.hardware.limits import UNLIMITED
from gms_flex_control.schema.key import Key, SMALLEST

BACKENDS = ('sim', 'bridge')
COMMAND_TYPES = ('array', 'joint_state', 'both')
TORQUE_SIDES = ('motor', 'joint')


PRIORITY = Key('realtime_priority', 'integer', 'of the whole process, SCHED_FIFO of Linux where '
               'it is permitted; 0 for none', '', 0, 0, 99)


def safety_keys(joints):
    """Return the keys of the plant node that hold for simulator and bridge."""
    keys = [
        PRIORITY,
        Key('backend', 'string', 'simulated robot, or bridge to a real one', default='sim',
            choices=BACKENDS),
        Key('silence_timeout', 'double', 'without a command for so long: zero torque and FAULT',
            's', 0.035, 0.002, 1.0),
        Key('emergency_stop_topic', 'string', 'std_msgs/Bool, true is pressed',
            default='emergency_stop')]
    for joint in joints:
        prefix = f'limits.{joint}.'
        keys += [
            Key(prefix + 'torque', 'double', 'largest torque given to the robot', 'N m',
                UNLIMITED, 0.0, UNLIMITED),
            Key(prefix + 'torque_rate', 'double', 'fastest rise of the torque; it may fall at '
                'once', 'N m/s', UNLIMITED, SMALLEST, UNLIMITED),
            Key(prefix + 'velocity', 'double', 'speed from which on no torque adds to it',
                'rad/s', UNLIMITED, SMALLEST, UNLIMITED),
            Key(prefix + 'velocity_margin', 'double', 'beyond that by so much: FAULT', 'rad/s',
                0.5, 0.0, UNLIMITED),
            Key(prefix + 'lower', 'double', 'least angle; beyond it only inward torque', 'rad',
                -UNLIMITED, -UNLIMITED, UNLIMITED),
            Key(prefix + 'upper', 'double', 'largest angle; beyond it only inward torque', 'rad',
                UNLIMITED, -UNLIMITED, UNLIMITED),
            Key(prefix + 'position_margin', 'double', 'beyond the range by so much: FAULT',
                'rad', 0.1, 0.0, UNLIMITED),
            Key(prefix + 'twist', 'double', 'difference of motor and link angle that is a FAULT',
                'rad', UNLIMITED, SMALLEST, UNLIMITED)]
    return tuple(keys)


def bridge_keys(joints):
    """Return the keys of the bridge beyond those of `safety_keys`."""
    prefix = 'bridge.'
    keys = [
        Key(prefix + 'state_topics', 'string_array', 'joint states of the robot, one or several '
            'topics', default=('robot/joint_states',)),
        Key(prefix + 'command_topic', 'string', 'efforts for the robot',
            default='robot/effort_controller/commands'),
        Key(prefix + 'command_type', 'string', 'Float64MultiArray on command_topic, JointState '
            'on joint_command_topic, or both', default='array', choices=COMMAND_TYPES),
        Key(prefix + 'joint_command_topic', 'string', 'efforts as JointState',
            default='robot/joint_commands'),
        Key(prefix + 'command_order', 'string_array', 'our joint names in the order of the '
            "effort controller's; empty for that of joints", default=()),
        Key(prefix + 'state_timeout', 'double', 'without joint states for so long: zero torque '
            'and FAULT', 's', 0.03, 0.002, 1.0),
        Key(prefix + 'skew', 'double', 'readings further apart make no state', 's', 0.01, 1e-5,
            1.0),
        Key(prefix + 'velocity_cutoff', 'double', 'low-pass of velocities that the robot does '
            'not send', 'Hz', 50.0, 0.1, 1e4),
        Key(prefix + 'hold_service', 'string', 'called by ~/enable so that the reference begins '
            "where the robot is; '' for none", default='trajectory/reset'),
        Key(prefix + 'guardian', 'boolean', 'start a process that sends zero efforts when the '
            'bridge dies or freezes', default=True),
        Key(prefix + 'device', 'string', 'entry point of a robot without ros2_control; then the '
            'topics above are not used', default=''),
        Key(prefix + 'device_options', 'string_array', 'for the device, each name=value',
            default=())]
    for joint in joints:
        keys += _mapping_keys(f'mapping.{joint}.')
    return tuple(keys)


def _mapping_keys(prefix):
    keys = []
    for side, own in (('link', 'the name in joints'), ('motor', 'the name in motors')):
        keys += [
            Key(f'{prefix}{side}.name', 'string', f"name in the robot's joint states; '' is {own}",
                default=''),
            Key(f'{prefix}{side}.sign', 'double', '1, or -1 if the reading falls when the joint '
                'turns forward', '', 1.0, -1.0, 1.0),
            Key(f'{prefix}{side}.ratio', 'double', 'turns of this encoder per turn of the joint',
                '', 1.0, SMALLEST, 1e6),
            Key(f'{prefix}{side}.offset', 'double', 'joint angle where it reads 0', 'rad', 0.0)]
    return [
        *keys,
        Key(prefix + 'effort.name', 'string', "name in the robot's joint states and commands; '' "
            'is that of the motor side, or of the link of a rigid joint', default=''),
        Key(prefix + 'effort.sign', 'double', '1, or -1 if positive effort drives the joint '
            'backward', '', 1.0, -1.0, 1.0),
        Key(prefix + 'effort.torque_constant', 'double', 'torque per unit of effort; 1 if '
            'efforts are torques', 'N m per unit', 1.0, SMALLEST, UNLIMITED),
        Key(prefix + 'effort.side', 'string', 'whether that torque is the one at the joint or '
            'at the motor shaft', default='joint', choices=TORQUE_SIDES),
        Key(prefix + 'effort.ratio', 'double', 'gear ratio by which a torque at the motor shaft '
            'becomes one at the joint', '', 1.0, SMALLEST, 1e6)]
