# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The signals an effect reads and changes: one row of numbers per joint.

An effect's ``apply(s, p, memory, dt)`` gets the row ``s`` of its joint as a pointer, so that
``s[TORSION]`` is the torsion of that joint and ``s[WIDTH + TORSION]`` that of the next one.
"""

TIME = 0           # since the start of the run [s]
JOINT = 1          # index of this joint
JOINTS = 2         # number of joints
Q_LINK = 3         # [rad]
DQ_LINK = 4        # [rad/s]
Q_MOTOR = 5        # [rad]
DQ_MOTOR = 6       # [rad/s]
DDQ_LINK = 7       # of the substep before [rad/s^2]
DDQ_MOTOR = 8      # of the substep before [rad/s^2]
TORQUE = 9         # torque of the actuator [N m]; stage ACTUATOR changes it
TORSION = 10         # q_motor - q_link as the spring sees it [rad]; stage TORSION changes it
TORSION_RATE = 11    # dq_motor - dq_link [rad/s]; stage TORSION changes it
SPRING = 12        # from motor to link, TORQUE - J DDQ_LINK of a rigid joint [N m]; stage SPRING
FRICTION = 13      # friction torque of the link, against the motion [N m]; stage FRICTION
LINK_TORQUE = 14   # extra torque on the link [N m]; stage LINK adds to it
MOTOR_TORQUE = 15  # extra torque on the motor [N m]; stage MOTOR adds to it
SENSED_LINK = 16   # what the link encoder will be given [rad]; stage SENSOR changes it
SENSED_MOTOR = 17  # what the motor encoder will be given [rad]; stage SENSOR changes it
SENSED_LINK_RATE = 18   # rate of what the link encoder is given [rad/s]; SENSOR changes it
SENSED_MOTOR_RATE = 19  # rate of what the motor encoder is given [rad/s]; SENSOR changes it
SUPPLY = 20        # voltage of the supply [V]; 0 where it is not known
BASE = 21          # angle of what the joint stands on [rad]; stage SENSOR changes it
BASE_RATE = 22     # its rate, against which the joint slips [rad/s]; stage SENSOR changes it
WIDTH = 23
