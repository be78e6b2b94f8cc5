# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Between ROS messages and arrays: names mapped, stamps kept, messages refused whole.

Commands and references say in their layout which joint state they are for (``stamp:<ns>``) and who
sent them (``source:<name>``), as labels of dimensions of size 1; ros2_control ignores the layout.
"""

from array import array
from contextlib import suppress
import math

from gms_flex_control.nodes.refusal import (
    first_bad,
    LARGEST_STATE,
    LARGEST_TORQUE,
    order_of,
    refuse_bad_reference,
    RefusedError,
)
import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

NANOSECONDS = 1_000_000_000
_STAMP, _SOURCE = 'stamp:', 'source:'
_LARGEST_STAMP = 2 ** 63                # beyond what a message's own time can hold [ns]
EFFORT, DERIVATIVE = 'effort', 'derivative'


def to_nanoseconds(stamp):
    """Return a builtin_interfaces Time as integer nanoseconds."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def set_stamp(stamp, nanoseconds):
    """Write integer nanoseconds into a builtin_interfaces Time."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NANOSECONDS)


class JointStateReader:
    """
    Map joint states by name to arrays of links and motors.

    Parameters
    ----------
    joints, motors : sequence of str
        Link and motor names; '' where a joint has no motor side of its own.

    """

    def __init__(self, joints, motors):
        self._wanted = [*joints, *(motor or joint
                                   for joint, motor in zip(joints, motors, strict=True))]
        self._n = len(joints)
        self._names = None
        self._order = None

    def read(self, message, measured):
        """
        Write a JointState into ``measured`` (q_link, dq_link, q_motor, dq_motor).

        Parameters
        ----------
        message : sensor_msgs.msg.JointState
            Names in any order, others among them.
        measured : object
            Views of simulation.encoder.state_layout.

        Raises
        ------
        RefusedError
            If a name is missing or repeated, a length is wrong, a value is not finite or beyond
            `LARGEST_STATE`; nothing is written then.

        """
        names = message.name
        if names != self._names:
            self._order = order_of(self._wanted, names)
            self._names = list(names)
        position, velocity = message.position, message.velocity
        if len(position) != len(names) or len(velocity) != len(names):
            raise RefusedError(f'joint states have {len(names)} names, {len(position)} positions '
                               f'and {len(velocity)} velocities; all three must agree')
        q = [position[index] for index in self._order]
        dq = [velocity[index] for index in self._order]
        self._refuse_bad('position', q)
        self._refuse_bad('velocity', dq)
        n = self._n
        measured.q_link[:], measured.q_motor[:] = q[:n], q[n:]
        measured.dq_link[:], measured.dq_motor[:] = dq[:n], dq[n:]

    def motor_efforts(self, message):
        """Return the efforts (n) of a message just read; none where it does not tell them."""
        effort = message.effort
        if len(effort) != len(message.name):
            return []
        return [effort[index] for index in self._order[self._n:]]

    def _refuse_bad(self, field, values):
        bad = first_bad(values, LARGEST_STATE)
        if bad is not None:
            raise RefusedError(f'joint states have {field} {values[bad]} for '
                               f'{self._wanted[bad]!r} ({field}[{self._order[bad]}])')


class JointStateWriter:
    """
    Fill one reused JointState: links, then the motors there are.

    Parameters
    ----------
    joints, motors : sequence of str
        Link and motor names; '' where a joint has no motor side of its own.

    """

    def __init__(self, joints, motors):
        self._flexible = [j for j, motor in enumerate(motors) if motor]
        names = [*joints, *(motors[j] for j in self._flexible)]
        self._nan = [math.nan if motor else 0.0 for motor in motors]
        self._rigid = [j for j, motor in enumerate(motors) if not motor]
        self.message = JointState(name=names)

    def write(self, measured, applied, stamp):
        """
        Return the message of one sample.

        Parameters
        ----------
        measured : object
            What the encoders read.
        applied : ndarray, shape (n_joints,)
            Torque really applied in the sample that ends now [N m].
        stamp : int
            Time of the sample [ns].

        Returns
        -------
        sensor_msgs.msg.JointState
            The same object at every call. Effort of a flexible link is NaN: not measured.

        """
        message, flexible = self.message, self._flexible
        q_motor, dq_motor = measured.q_motor.tolist(), measured.dq_motor.tolist()
        torque = applied.tolist()
        message.position = array('d', measured.q_link.tolist() + [q_motor[j] for j in flexible])
        message.velocity = array('d', measured.dq_link.tolist()
                                 + [dq_motor[j] for j in flexible])
        link_effort = list(self._nan)
        for j in self._rigid:
            link_effort[j] = torque[j]
        message.effort = array('d', link_effort + [torque[j] for j in flexible])
        set_stamp(message.header.stamp, stamp)
        return message


class CommandWriter:
    """
    Fill one reused command message.

    Parameters
    ----------
    n : int
        Number of joints.
    source : str
        Who commands.

    """

    def __init__(self, n, source):
        self._stamp = MultiArrayDimension(size=1, stride=1)
        dims = [MultiArrayDimension(label='joint', size=n, stride=n), self._stamp,
                MultiArrayDimension(label=_SOURCE + source, size=1, stride=1)]
        self.message = Float64MultiArray(layout=MultiArrayLayout(dim=dims))

    def write(self, torque, stamp):
        """Return the message: ``torque`` (n,) [N m] in answer to the state of ``stamp`` [ns]."""
        self._stamp.label = f'{_STAMP}{stamp}'
        self.message.data = array('d', torque.tolist())
        return self.message


class BlockWriter:
    """
    Fill one reused message with a number for each friction block, layout [joint, block].

    Parameters
    ----------
    n, blocks : int
        Joints, and blocks of each.

    """

    def __init__(self, n, blocks):
        self._stamp = MultiArrayDimension(size=1, stride=1)
        self.message = Float64MultiArray(layout=MultiArrayLayout(dim=[
            MultiArrayDimension(label='joint', size=n, stride=n * blocks),
            MultiArrayDimension(label='block', size=blocks, stride=blocks), self._stamp]))

    def write(self, values, stamp):
        """Return the message: ``values`` (n, blocks) at the joint state of ``stamp`` [ns]."""
        self._stamp.label = f'{_STAMP}{stamp}'
        self.message.data = array('d', values.ravel().tolist())
        return self.message


def read_stamp(message):
    """Return the stamp [ns] in the layout of a Float64MultiArray, or None without one."""
    for dimension in message.layout.dim:
        if dimension.label.startswith(_STAMP):
            with suppress(ValueError):  # anyone may have written the label
                stamp = int(dimension.label[len(_STAMP):])
                return stamp if abs(stamp) < _LARGEST_STAMP else None
    return None


def read_source(message):
    """Return who sent a command or reference, as its layout says; None without that."""
    for dimension in message.layout.dim:
        if dimension.label.startswith(_SOURCE):
            return dimension.label[len(_SOURCE):]
    return None


def read_command(message, n):
    """
    Return a command as a list of n torques [N m].

    Raises
    ------
    RefusedError
        If there are more or fewer than n, or one is not finite or beyond `LARGEST_TORQUE`.

    """
    torque = message.data
    if len(torque) != n:
        raise RefusedError(f'command has {len(torque)} torques for {n} joints')
    bad = first_bad(torque, LARGEST_TORQUE)
    if bad is not None:
        raise RefusedError(f'command for joint {bad + 1} is {torque[bad]} (data[{bad}])')
    return torque


class ReferenceWriter:
    """
    Fill one reused reference message of layout [derivative or effort, joint].

    Parameters
    ----------
    n : int
        Number of joints.
    source : str
        Whose reference it is.

    """

    def __init__(self, n, source):
        self._kind = MultiArrayDimension()
        self._joint = MultiArrayDimension(label='joint', size=n, stride=n)
        self._stamp = MultiArrayDimension(size=1, stride=1)
        self.message = Float64MultiArray(layout=MultiArrayLayout(
            dim=[self._kind, self._joint, self._stamp,
                 MultiArrayDimension(label=_SOURCE + source, size=1, stride=1)]))

    def write(self, reference, quantity, stamp):
        """Return the message for ``reference`` (5, n); of an effort only the first row counts."""
        rows = reference[:1] if quantity == EFFORT else reference
        self._kind.label = EFFORT if quantity == EFFORT else DERIVATIVE
        self._kind.size, self._kind.stride = len(rows), rows.size
        self._stamp.label = f'{_STAMP}{stamp}'
        self.message.data = array('d', rows.ravel().tolist())
        return self.message


def read_reference(message, n):
    """
    Return a reference message as (quantity, array).

    Parameters
    ----------
    message : std_msgs.msg.Float64MultiArray
        Dimensions [derivative 5, joint n] or [effort 1, joint n], or none that has a size.
    n : int
        Number of joints.

    Returns
    -------
    quantity : {'motion', 'effort'}
        What the numbers are.
    reference : ndarray, shape (5, n) or (1, n)
        In SI units.

    Raises
    ------
    RefusedError
        If layout or length does not fit, or a number is not finite or too large.

    """
    dims = message.layout.dim
    quantity = EFFORT if dims and dims[0].label == EFFORT else 'motion'
    rows = 1 if quantity == EFFORT else 5
    sizes = [dimension.size for dimension in dims[:2]]
    described = dims and not dims[0].label.startswith((_STAMP, _SOURCE))
    if described and (dims[0].label not in (EFFORT, DERIVATIVE) or sizes != [rows, n]):
        labels = ', '.join(f'{dimension.label[:80]} {dimension.size}' for dimension in dims[:2])
        raise RefusedError(f'reference has the layout [{labels}], expected [{DERIVATIVE} 5, '
                           f'joint {n}] or [{EFFORT} 1, joint {n}]')
    if len(message.data) != rows * n:
        raise RefusedError(f'reference has {len(message.data)} numbers, expected {rows} x {n}')
    refuse_bad_reference(message.data, quantity == EFFORT, n)
    return quantity, np.array(message.data).reshape(rows, n)


def phase_message(phase):
    """
    Return what an experiment does from a joint state on, as a message.

    Parameters
    ----------
    phase : Phase
        Its ``time_ns`` is the stamp of that joint state.

    Returns
    -------
    std_msgs.msg.Float64MultiArray
        The value, and the rest as labels of dimensions of size 1.

    """
    labels = (f'{_STAMP}{phase.time_ns}', f'phase:{phase.phase}', f'joint:{phase.joint}',
              f'step:{phase.step}')
    return Float64MultiArray(data=[float(phase.value)], layout=MultiArrayLayout(
        dim=[MultiArrayDimension(label=label, size=1, stride=1) for label in labels]))
