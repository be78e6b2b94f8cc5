# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The topics of one recording as arrays, and what of them belongs to which joint state."""

from functools import cached_property
from math import factorial
from typing import NamedTuple
import warnings

from gms_flex_control.data import cdr
from gms_flex_control.data.bag import BagWarning
from gms_flex_control.data.recording import link_names, MOTOR_SUFFIX
from gms_flex_control.data.tables import ArrayTable, JointTable
from gms_flex_control.errors import BagError
import numpy as np

N_DERIVATIVES = 5        # rows of a reference: angle and its derivatives 1 to 4
_REACH = 1.5             # a reference further away than this many periods is not used
_SAMPLES = 2**15         # samples that are worked on at once, for the sake of memory
_BLOCK = 4096            # messages of a topic that wait to be decoded together
_TWO_RUNS = 100_000_000  # a step back beyond this is another run, not a late message [ns]
# correlation, least and largest slope between a motor's angle and that of its link
_ALONG = 0.98, 0.8, 1.25
# of the Topics
_TYPES = (cdr.JOINT_STATE, cdr.MULTI_ARRAY, cdr.MULTI_ARRAY, cdr.JOINT_STATE, cdr.MULTI_ARRAY)


def names_of(bag, message, topics) -> tuple:
    """Return the names in a joint state (bytes) of a bag; BagError if it is None or broken."""
    if message is None:
        known = ', '.join(sorted(bag.topics)) or 'none'
        what = 'no message on' if topics.joint_states in bag.topics else 'no topic'
        raise BagError(f'{bag.path}: has {what} {topics.joint_states!r} (topics: {known}); '
                       'record it, or name the topic that has the joint states')
    try:
        return cdr.unpack_joint_state(message)[2]
    except BagError as error:
        raise BagError(f'{bag.path}: topic {topics.joint_states!r} message 0 {error}') from None


class _Answers(NamedTuple):
    """Commands in the order they were received."""

    stamps: np.ndarray    # (S,), int64, of the states they answer [ns]
    stamped: np.ndarray   # (S,), whether there is a stamp
    received: np.ndarray  # (S,), int64, receive times [ns]
    values: np.ndarray    # (S, n) [N m]


def _answering(stamps, received, period, answers, n):
    """Return the command that answers each state, shape (T, n), NaN where none came."""
    command = np.full((len(stamps), n), np.nan)
    row = np.full(len(answers.stamps), -1)
    row[answers.stamped] = _row_of(answers.stamps[answers.stamped], stamps)
    times = answers.received[~answers.stamped]
    before = np.searchsorted(received, times, side='right') - 1
    row[~answers.stamped] = np.where(times - received[before] <= period, before, -1)
    rows, first = np.unique(row, return_index=True)
    first = first[rows >= 0]
    command[row[first]] = answers.values[first]
    return command


def _row_of(wanted, stamps):
    """Return where each of ``wanted`` is in the increasing ``stamps``, -1 where it is not."""
    row = np.minimum(np.searchsorted(stamps, wanted), len(stamps) - 1)
    return np.where(stamps[row] == wanted, row, -1)


def _reference_at(times, period, labels, table):
    """
    Return the reference at times (T,) of states, shape (T, 5, n), NaN where absent.

    That of the same time; else the nearest of ``labels`` (S,) within 1.5 periods (all [ns]),
    carried on to the state's time by the derivatives in ``table`` (S, 5, n).
    """
    result = np.full((len(times), *table.shape[1:]), np.nan)
    if not len(table):
        return result
    labels, order = np.unique(labels, return_index=True)
    for start in range(0, len(times), _SAMPLES):
        block = slice(start, start + _SAMPLES)
        right = np.clip(np.searchsorted(labels, times[block]), 1, max(len(labels) - 1, 1))
        left, right = right - 1, np.minimum(right, len(labels) - 1)
        nearest = np.where(times[block] - labels[left] <= labels[right] - times[block], left,
                           right)
        shift = times[block] - labels[nearest]
        near = np.abs(shift) <= _REACH * period
        result[block][near] = carried_on(table[order[nearest[near]]], shift[near] * 1e-9)
    return result


def carried_on(table, shift) -> np.ndarray:
    """Return the Taylor series of references (T, up to 5, n) after ``shift`` (T,) [s]."""
    known = np.nan_to_num(table)
    result, rows = table.copy(), table.shape[1]
    for row in range(rows):
        for power in range(1, rows - row):
            weight = shift ** power / factorial(power)
            result[:, row] += weight[:, None] * known[:, row + power]
    return result


class Series:
    """The topics of one recording, decoded while the bag is read; see `read_recording`."""

    def __init__(self, bag, topics, joints, motors):
        self._bag, self._path, self.topics = bag, bag.path, topics
        self._chosen = joints, motors
        self._waiting = {topic: ([], []) for topic in topics}  # receive times, messages
        self._first, self._tables, self._places = None, (), None
        self._unclaimed = {}  # a table of each name that no joint has and a link may have
        self._readers = []    # topic, type and table

    def collect(self, further) -> None:
        """Read the bag; messages of ``further`` topics are put into their lists."""
        for batch in self._bag.batches({*self._waiting, *further}):
            for topic, log, _, message in batch:
                if topic in further:
                    further[topic].append(message)
                    continue
                times, messages = self._waiting[topic]
                times.append(log)
                messages.append(message)
            self._decode(_BLOCK)
        self._decode(1)
        for topic, type_name in zip(self.topics, _TYPES, strict=True):
            if not self._has_type(topic, type_name):
                raise BagError(f'{self._path}: topic {topic!r} is a '
                               f'{self._bag.topics.get(topic)}, expected {type_name}')

    def _has_type(self, topic, type_name):
        return topic not in self._bag.topics or self._bag.topics.get(topic) == type_name

    def _decode(self, least):
        """Decode the topics of which ``least`` messages wait, once the joints are known."""
        if self._first is None and self._waiting[self.topics.joint_states][1]:
            self._first = self._waiting[self.topics.joint_states][1][0]
            self._tables = self._make_tables()
            self._readers = [*zip(self.topics, _TYPES, self._tables, strict=False), *(
                (self.topics.joint_states, cdr.JOINT_STATE, table)
                for table in self._unclaimed.values())]
        if self._first is None:
            return
        for topic, (times, messages) in self._waiting.items():
            if len(messages) >= least:
                for name, type_name, table in self._readers:
                    if name == topic and self._has_type(topic, type_name):
                        table.add(times, messages)
                times.clear()
                messages.clear()

    def _make_tables(self):
        """Return a table for each of the topics, none if the joints are not known."""
        try:
            joints, _ = self.sides
        except BagError:  # raised again once the bag is known to be sound
            return ()
        n, links = len(joints), link_names(self.names)
        self._unclaimed = {name: JointTable((name,), ('position',)) for name in self._not_named()}
        self._places = [links.index(name) for name in joints] if set(joints) < set(links) else None
        widest = n if self._places is None else len(links)

        def torques(_dims, count):
            if count not in (n, widest):
                raise BagError(f'has {count} torques for {n} joints ({", ".join(joints)}); are '
                               'some of them motors? --joints names the links, --motors their '
                               'motors')
            return (count,)

        def references(dims, count):
            try:
                return _reference_shape(dims, count, n)
            except BagError:
                if widest == n:
                    raise
                return _reference_shape(dims, count, widest)

        return (JointTable(self._there()), ArrayTable((widest,), torques),
                ArrayTable((N_DERIVATIVES, widest), references),
                JointTable(joints, ('effort',)), ArrayTable((1,), _one_voltage))

    def _own(self, values):
        """Return the columns (..., n) of these joints, of messages that may be of all joints."""
        if self._places is None:
            return values
        narrow = np.all(np.isnan(values[..., len(self._places):]), axis=-1, keepdims=True)
        return np.where(narrow, values[..., :len(self._places)], values[..., self._places])

    @cached_property
    def names(self) -> tuple:
        """Return the names of the first joint state, or raise BagError."""
        return names_of(self._bag, self._first, self.topics)

    @cached_property
    def sides(self) -> tuple:
        """Return joint and motor names as wanted, one motor a joint, '' where absent."""
        names, (joints, motors) = self.names, self._chosen
        if joints is None:
            joints = link_names(names) if motors is None else [
                name for name in names if name not in motors]
        if motors is None:
            motors = [name + MOTOR_SUFFIX if name + MOTOR_SUFFIX in names else ''
                      for name in joints]
        if len(motors) != len(joints):
            raise BagError(f'{self._path}: {len(motors)} motors for {len(joints)} joints '
                           f'({", ".join(joints)}); give one each, empty where there is none')
        lone = {joint for joint, motor in zip(joints, motors, strict=True) if motor in names}
        for name in (*joints, *motors):
            if name and name not in names and name not in lone:
                raise BagError(
                    f'{self._path}: topic {self.topics.joint_states!r} lacks joint {name!r} '
                    f'(has {", ".join(names)}); set the names that are there or record that side '
                    'as well')
            if name and names.count(name) > 1:
                raise BagError(f'{self._path}: topic {self.topics.joint_states!r} names {name!r} '
                               'more than once; who publishes it?')
        return tuple(joints), tuple(motors)

    def _lone(self):
        """Return the motor of each joint that has no link angle, by the joint's name (dict)."""
        return {joint: motor for joint, motor in zip(*self.sides, strict=True)
                if joint not in self.names and motor in self.names}

    def _not_named(self):
        """Return names that may be those of links without an angle, none if all have one."""
        if not self._lone():
            return []
        others = {*self.names}.difference(*self.sides)
        return [name for name in self.names if name in others
                and not name.endswith(MOTOR_SUFFIX) and name + MOTOR_SUFFIX not in others]

    def refuse_renamed(self, stamps, q_motor) -> None:
        """
        Raise BagError if links without an angle have one by another name.

        As many as lack one must be named like a motor, or move along with one, ``q_motor`` (T, n):
        a gripper does not, and further joints on the same course are more.
        """
        lone, joints, along = self._lone(), self.sides[0], {}
        for name, table in self._unclaimed.items():
            times, angles = table.take('stamps'), table.take('position')[:, 0]
            _, here, there = np.intersect1d(stamps, times, return_indices=True)
            along[name] = [joint for joint in lone if _moves_along(
                q_motor[here, joints.index(joint)], angles[there])]
        found = [[name for name in along if name + MOTOR_SUFFIX == motor]
                 or [name for name in along if joint in along[name]]
                 for joint, motor in lone.items()]
        alike = dict.fromkeys(sum(found, []))
        if alike and all(found) and len(alike) == len(lone):
            raise BagError(
                f'{self._path}: topic {self.topics.joint_states!r} lacks link '
                f'{", ".join(map(repr, lone))} but has {", ".join(alike)}, which the robot does '
                'not; rename in `joints`, or give --joints')

    def note_others(self) -> None:
        """Issue a BagWarning if there are more joints than those that were asked for."""
        others = [name for name in self.names if not any(name in side for side in self.sides)]
        if others and self._chosen[0] is not None:
            warnings.warn(f'{self._path}: topic {self.topics.joint_states!r} has '
                          f'{", ".join(others)} as well, which this robot has not: left out',
                          BagWarning, stacklevel=4)

    def _take(self, topic, *columns):
        """Return columns of the table of a topic, a field of ``topics``."""
        table = self._tables[self.topics._fields.index(topic)]
        try:
            return [table.take(name) for name in columns]
        except BagError as error:
            name = getattr(self.topics, topic)
            raise BagError(f'{self._path}: topic {name!r} {error}') from None

    def clock(self) -> tuple:
        """Return stamps and receive times of the states, increasing, and the rows to take."""
        topic = self.topics.joint_states
        stamps, received, rows = self._take('joint_states', 'stamps', 'received', 'rows')
        stamped = stamps > 0
        if not stamped.any():
            stamps, stamped = received, ~stamped
        elif stamps[stamped].min() < _TWO_RUNS:
            stamped[:] = True  # 0 is where the time of a simulation began
        elif not stamped.all():
            warnings.warn(f'{self._path}: topic {topic!r} has {np.sum(~stamped)} states without a '
                          'stamp among others: left out', BagWarning, stacklevel=4)
        taken = np.flatnonzero(stamped)
        stamps, received, rows = stamps[taken], received[taken], rows[taken]
        back = np.diff(stamps)
        if len(back) and back.min() < -_TWO_RUNS:
            k = int(np.argmin(back))
            raise BagError(
                f'{self._path}: topic {topic!r} goes back from {stamps[k] * 1e-9:.3f} s to '
                f'{stamps[k + 1] * 1e-9:.3f} s at message {rows[k + 1]}: two runs in one '
                'bag? Record each in its own')
        order = np.unique(stamps, return_index=True)[1]
        if len(order) < len(stamps):
            warnings.warn(f'{self._path}: topic {topic!r} repeats {len(stamps) - len(order)} '
                          'stamps; the first state of each is taken', BagWarning, stacklevel=4)
        return stamps[order], received[order], taken[order]

    def states(self, name, rows) -> tuple:
        """Return position, velocity or effort of links and of motors, (T, n) each, or NaN."""
        known, there = self._take('joint_states', name)[0], self._there()
        unknown = np.full(len(rows), np.nan)
        return tuple(np.stack([known[rows, there.index(one)] if one in there else unknown
                               for one in side], axis=1) for side in self.sides)

    def _there(self):
        return [name for side in self.sides for name in side if name and name in self.names]

    def commands(self, stamps, received, period) -> np.ndarray:
        """Return the command that answers each state, shape (T, n)."""
        answers = _Answers(*self._take('command', *_Answers._fields))
        answers = answers._replace(values=self._own(answers.values))
        return _answering(stamps, received, period, answers, len(self.sides[0]))

    def reference(self, stamps, received, period) -> np.ndarray:
        """Return the reference at the states, shape (T, 5, n)."""
        labels, stamped, times, values = self._take('reference', *_Answers._fields)
        values = self._own(values)
        by_stamp, by_time = (
            _reference_at(states, period, when[own], values[own]) for states, when, own in (
                (stamps, labels, stamped), (received, times, ~stamped)))
        return np.where(np.isnan(by_stamp).all(axis=(1, 2), keepdims=True), by_time, by_stamp)

    def friction(self, stamps) -> np.ndarray:
        """Return the friction estimate at the states, shape (T, n)."""
        own, values = self._take('controller_state', 'stamps', 'effort')
        result, row = np.full((len(stamps), values.shape[1]), np.nan), _row_of(own, stamps)
        result[row[row >= 0]] = values[row >= 0]
        return result

    def supply(self, stamps, received) -> np.ndarray:
        """Return the voltage at the states, shape (T,), between two messages a straight line."""
        labels, stamped, times, values = self._take('supply', *_Answers._fields)
        if not len(values):
            return np.full(len(stamps), np.nan)
        own = stamped if stamped.any() else ~stamped
        at, known = (stamps, labels) if stamped.any() else (received, times)
        known, first = np.unique(known[own], return_index=True)
        return np.interp(at, known, values[own][first, 0])


def _moves_along(motor, link):
    """Return whether an angle (T,) may be that of the link that a motor (T,) drives."""
    known = np.isfinite(motor) & np.isfinite(link)
    if known.sum() < 2:
        return False
    x, y = (side[known] - side[known].mean() for side in (motor, link))
    fit, low, high = _ALONG
    return bool(x @ y > fit * np.sqrt((x @ x) * (y @ y)) and low * (x @ x) < x @ y
                and x @ y < high * (x @ x))


def _one_voltage(_dims, count):
    """Return the shape (1,) of a supply's voltage; raise BagError if it is not one number."""
    if count != 1:
        raise BagError(f'has {count} numbers, expected the voltage of the supply alone')
    return (1,)


def _reference_shape(dims, count, n):
    """Return the shape (rows, n) of a reference, None of torques; BagError where none fits."""
    shape = [(label, size) for label, size, _ in dims
             if not label.startswith((cdr.STAMP_LABEL, cdr.SOURCE_LABEL))]
    if shape and shape[0][0] == 'effort':
        return None
    rows = shape[0][1] if shape else count // max(n, 1)
    columns = shape[1][1] if len(shape) > 1 else n
    if not 1 <= rows <= N_DERIVATIVES or columns != n or count != rows * n:
        layout = ' x '.join(f'{label} {size}' for label, size in shape) or 'no layout'
        raise BagError(f'has {count} numbers ({layout}), expected '
                       f'derivative {N_DERIVATIVES} x joint {n}')
    return rows, n
