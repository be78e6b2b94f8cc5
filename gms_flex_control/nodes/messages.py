# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Between ROS messages and arrays: names mapped, stamps kept, messages refused whole.

Commands and references say in their layout which joint state they are for (``stamp:<ns>``) and who
sent them (``source:<name>``), as labels of dimensions of size 1; ros2_control ignores the layout.
"""

from array import array
from contextlib import suppress
import math

from gms_flex_control.data.cdr import phase_labels, SOURCE_LABEL, STAMP_LABEL
from gms_flex_control.params.key import LARGEST_STATE
import numpy as np
from rclpy.clock import Clock
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

_SYSTEM = Clock()
NANOSECONDS = 1_000_000_000
_LATEST = round(0.1 * NANOSECONDS)      # a state older than the last by less was overtaken
_LARGEST_STAMP = 2 ** 63                # beyond what a message's own time can hold [ns]
EFFORT, DERIVATIVE = 'effort', 'derivative'
# Beyond these, too, a number is a fault, though it is finite: 1e308 overflows in any law.
LARGEST_TORQUE = 1e9       # [N m]
LARGEST_DERIVATIVE = 1e15  # of a reference, up to the fourth [rad/s^4]
_PLURALS = {'position': 'positions', 'velocity': 'velocities'}
_ROWS = ('q', 'dq', 'ddq', 'd3q', 'd4q')
_NAMED = 8  # joint names in a sentence; a message may have a million


class RefusedError(ValueError):
    """A message that is not acted on; the sentence says why."""


class JointsError(RefusedError):
    """Its names are not those of our joints."""


def now(node) -> Time:
    """Return the time of a node; that of the system while it waits for the first /clock."""
    time_of_node = node.get_clock().now()
    return time_of_node if time_of_node.nanoseconds else _SYSTEM.now()


def all_finite(values) -> bool:
    """Return whether no number is NaN or infinite; fast for a handful of them."""
    # NaN and both infinities turn the sum into NaN or infinity
    return math.isfinite(sum(values)) or all(math.isfinite(value) for value in values)


def first_bad(values, limit) -> int | None:
    """Return the index of the first number that is not within +-``limit``; None if all are."""
    # a sum that is finite has no NaN in it, for which min and max are of no use
    if not values or (math.isfinite(sum(values)) and -limit <= min(values)
                      and max(values) <= limit):
        return None
    return next((k for k, value in enumerate(values) if not abs(value) <= limit), None)


def order_of(wanted, names, what='joint states') -> list:
    """Return where the ``wanted`` stand among ``names`` of ``what``; JointsError if not once."""
    order = []
    for name in wanted:
        count = names.count(name)
        if count == 0:
            some = ', '.join(one[:80] for one in names[:_NAMED])
            more = f' and {len(names) - _NAMED} more' if len(names) > _NAMED else ''
            raise JointsError(f'{what} lack {name!r} (have {some}{more}); '
                              'check joints and motors in the robot file')
        if count > 1:
            raise JointsError(f'{what} name {name!r} more than once')
        order.append(names.index(name))
    return order


def to_nanoseconds(stamp) -> int:
    """Return a builtin_interfaces Time or Duration as integer nanoseconds."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def set_stamp(stamp, nanoseconds) -> None:
    """Write integer nanoseconds into a builtin_interfaces Time."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NANOSECONDS)


def is_overtaken(stamp, last) -> bool:
    """Return whether a state came late, after the ``last``: not one of another clock."""
    return last is not None and 0 < last - stamp <= _LATEST


# joint states --------------------------------------------------------------------------------


class JointNumbers:
    """Numbers of the ``wanted`` joints in JointStates, whose names may have any order."""

    def __init__(self, wanted):
        self._wanted, self._names, self.order = list(wanted), None, None

    def read(self, message, field) -> list:
        """Return the numbers of a ``field``; raises RefusedError if any is missing or bad."""
        names, values = message.name, getattr(message, field)
        if names != self._names:
            self.order = order_of(self._wanted, names)
            self._names = list(names)
        if len(values) != len(names):
            raise RefusedError(f'joint states have {len(names)} names and {len(values)} '
                               f'{_PLURALS[field]}; each name needs one')
        numbers = [values[index] for index in self.order]
        bad = first_bad(numbers, LARGEST_STATE)
        if bad is not None:
            raise RefusedError(f'joint states have {field} {numbers[bad]} for '
                               f'{self._wanted[bad]!r} ({field}[{self.order[bad]}])')
        return numbers


class JointStateReader:
    """Links and motors in JointStates; a motor's name is '' where a joint has no such side."""

    def __init__(self, joints, motors):
        self._numbers = JointNumbers([*joints, *(motor or joint for joint, motor in zip(
            joints, motors, strict=True))])
        self._n = len(joints)

    def read(self, message, measured) -> None:
        """
        Write a JointState into ``measured`` (q_link, dq_link, q_motor, dq_motor).

        Raises RefusedError, with nothing written, if a name is missing or repeated, a length is
        wrong, a value is not finite or beyond `LARGEST_STATE`.
        """
        q = self._numbers.read(message, 'position')
        dq = self._numbers.read(message, 'velocity')
        n = self._n
        measured.q_link[:], measured.q_motor[:] = q[:n], q[n:]
        measured.dq_link[:], measured.dq_motor[:] = dq[:n], dq[n:]

    def motor_efforts(self, message) -> list:
        """Return the efforts (n) of a message just read; empty where it has none."""
        effort = message.effort
        if len(effort) != len(message.name):
            return []
        return [effort[index] for index in self._numbers.order[self._n:]]


class JointStateWriter:
    """Fill one reused JointState: links, then the motors that there are (names other than '')."""

    def __init__(self, joints, motors):
        n, self._rigid = len(joints), [j for j, motor in enumerate(motors) if not motor]
        self._flexible = [j for j, motor in enumerate(motors) if motor]
        self.message = JointState(name=[*joints, *filter(None, motors)])
        numbers = [array('d', [math.nan] * len(self.message.name)) for _ in range(3)]
        self.message.position, self.message.velocity, self.message.effort = numbers
        # written through views of the message's own arrays, which is ten times as fast
        views = [np.frombuffer(getattr(self.message, name)) for name in (
            'position', 'velocity', 'effort')]
        self._links, self._motors = [view[:n] for view in views], [view[n:] for view in views]
        if not self._rigid:  # a slice is faster than a list
            self._flexible = slice(None)

    def write(self, measured, applied, stamp) -> JointState:
        """
        Return the message, the same object at every call, of the sample at ``stamp`` [ns].

        ``measured`` is what the encoders read, ``applied`` (n_joints,) the torque of the sample
        that ends now [N m]. The effort of a flexible link is NaN: not measured.
        """
        (q, dq, effort), flexible = self._links, self._flexible
        q[:], dq[:] = measured.q_link, measured.dq_link
        for side, values in zip(self._motors, (measured.q_motor, measured.dq_motor, applied),
                                strict=True):
            side[:] = values[flexible]
        if self._rigid:
            effort[self._rigid] = applied[self._rigid]
        set_stamp(self.message.header.stamp, stamp)
        return self.message


def _mark(label=''):
    """Return a dimension that only carries a label."""
    return MultiArrayDimension(label=label, size=1, stride=1)


class ArrayWriter:
    """Fill one reused Float64MultiArray of ``dimensions`` (label, size), stamp and ``source``."""

    def __init__(self, *dimensions, source=''):
        self._stamp, self._numbers = _mark(), ()
        sizes = [size for _, size in dimensions]
        self.message = Float64MultiArray(layout=MultiArrayLayout(dim=[
            *(MultiArrayDimension(label=label, size=size, stride=math.prod(sizes[k:]))
              for k, (label, size) in enumerate(dimensions)),
            self._stamp, *([_mark(SOURCE_LABEL + source)] if source else [])]))

    def write(self, values, stamp) -> Float64MultiArray:
        """Return the message: an array, in answer to or at the joint state of ``stamp`` [ns]."""
        self._stamp.label = f'{STAMP_LABEL}{stamp}'
        if len(self._numbers) != values.size:
            self.message.data = array('d', bytes(8 * values.size))
            self._numbers = np.frombuffer(self.message.data)
        self._numbers[:] = values.ravel()
        return self.message


class ReferenceWriter:
    """Fill one reused reference message of ``n`` joints, layout [derivative or effort, joint]."""

    def __init__(self, n, source):
        self._writer = ArrayWriter((DERIVATIVE, 5), ('joint', n), source=source)
        self.message = self._writer.message

    def write(self, reference, quantity, stamp) -> Float64MultiArray:
        """Return the message for ``reference`` (5, n); of an effort only the first row counts."""
        rows, kind = reference, self.message.layout.dim[0]
        if quantity == EFFORT:
            rows, kind.label = reference[:1], EFFORT
        else:
            kind.label = DERIVATIVE
        kind.size, kind.stride = len(rows), rows.size
        return self._writer.write(rows, stamp)


def read_marks(message) -> tuple:
    """Return stamp [ns], None without one, and source, '' without, in a Float64MultiArray."""
    stamp, source = None, ''
    for dimension in reversed(message.layout.dim):  # the first ones count
        label = dimension.label
        if label.startswith(STAMP_LABEL):
            stamp = None
            with suppress(ValueError):  # anyone may have written the label
                stamp = int(label[len(STAMP_LABEL):])
        elif label.startswith(SOURCE_LABEL):
            source = label[len(SOURCE_LABEL):]
    return (stamp if stamp is None or abs(stamp) < _LARGEST_STAMP else None), source


def read_command(message, n) -> array:
    """Return n torques [N m]; raises RefusedError unless they are n, finite and plausible."""
    torque = message.data
    if len(torque) != n:
        raise RefusedError(f'command has {len(torque)} torques for {n} joints')
    bad = first_bad(torque, LARGEST_TORQUE)
    if bad is not None:
        raise RefusedError(f'command for joint {bad + 1} is {torque[bad]} (data[{bad}])')
    return torque


def read_reference(message, n) -> tuple:
    """Return ('motion', (5, n)) or ('effort', (1, n)) in SI units, or raise RefusedError."""
    dims = message.layout.dim
    quantity = EFFORT if dims and dims[0].label == EFFORT else 'motion'
    rows = 1 if quantity == EFFORT else 5
    sizes = [dimension.size for dimension in dims[:2]]
    described = dims and not dims[0].label.startswith((STAMP_LABEL, SOURCE_LABEL))
    if described and (dims[0].label not in (EFFORT, DERIVATIVE) or sizes != [rows, n]):
        labels = ', '.join(f'{dimension.label[:80]} {dimension.size}' for dimension in dims[:2])
        raise RefusedError(f'reference has the layout [{labels}], expected [{DERIVATIVE} 5, '
                           f'joint {n}] or [{EFFORT} 1, joint {n}]')
    if len(message.data) != rows * n:
        raise RefusedError(f'reference has {len(message.data)} numbers, expected {rows} x {n}')
    _refuse_bad_reference(message.data, quantity == EFFORT, n)
    return quantity, np.array(message.data).reshape(rows, n)


def _refuse_bad_reference(data, effort, n):
    """Raise RefusedError, with row, joint and index, for a bad number in a reference."""
    limits = (((0, n, LARGEST_TORQUE),) if effort else
              ((0, 2 * n, LARGEST_STATE), (2 * n, 5 * n, LARGEST_DERIVATIVE)))
    for begin, end, limit in limits:
        bad = first_bad(data[begin:end], limit)
        if bad is not None:
            row, joint = divmod(begin + bad, n)
            name = 'effort' if effort else _ROWS[row]
            raise RefusedError(f'reference has {name} {data[begin + bad]} for joint {joint + 1} '
                               f'(data[{begin + bad}])')


def phase_message(phase) -> Float64MultiArray:
    """Return what an experiment does from a joint state on (Phase): the rest are labels."""
    return Float64MultiArray(data=[float(phase.value)], layout=MultiArrayLayout(
        dim=[_mark(label) for label in phase_labels(phase)]))
