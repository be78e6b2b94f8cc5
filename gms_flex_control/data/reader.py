# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Read a bag as a recording, with the phases of its experiment."""

from collections.abc import Sequence
import warnings

from gms_flex_control.data import cdr
from gms_flex_control.data.bag import Bag, BagWarning, namespace_of
from gms_flex_control.data.conditions import conditions_of, with_conditions
from gms_flex_control.data.recording import (
    MOTOR_SUFFIX,
    on_even_clock,
    Phase,
    Recording,
    Topics,
    with_own_stamps,
)
from gms_flex_control.data.series import names_of, Series
from gms_flex_control.errors import BagError
from gms_flex_control.params.key import LARGEST, LARGEST_STATE
import numpy as np

# of columns, by how their names begin: what, unit, the largest of any joint
_QUANTITIES = {'q': ('position', 'rad', LARGEST_STATE), 'dq': ('velocity', 'rad/s', LARGEST_STATE),
               'tau': ('effort', 'N m', LARGEST),
               'command': ('torque', 'N m', LARGEST)}
_LABELS = ('phase', 'joint', 'step')


def read_recording(path, joints: Sequence[str] | None = None, motors: Sequence[str] | None = None,
                   *, topics: Topics | None = None) -> Recording:
    """
    Read one experiment from a bag of `ros2 bag record` or of this package, sampled at its states.

    ``path`` is a bag folder or file: mcap or sqlite3, plain or zstd, also one cut off. ``joints``
    are link names in the order of the command, by default those of the first joint state that are
    not the motor of another; ``motors`` that of each joint, '' where absent, by default
    ``<joint>_motor`` where the states have it. ``topics`` are by default those of our nodes, in
    the namespace they were recorded in.

    The command of a state is the one that carries its stamp, the reference that of the same time;
    a link whose motor alone is in the states has no angles (NaN). What recording.yaml beside the
    bag states is applied. BagError if the bag lacks the joint states, a joint or a length that
    fits; BagWarning if it was cut off, is damaged or otherwise odd.
    """
    return _read(path, joints, motors, topics)[0]


def read_experiment(path, joints=None, motors=None) -> tuple:
    """Read the Recording and Phases of an experiment, the bag but once."""
    recording, begin, bag, (topic, messages) = _read(path, joints, motors)
    if messages and bag.topics[topic] != cdr.MULTI_ARRAY:
        raise BagError(f'{path}: topic {topic!r} is a {bag.topics[topic]}, expected '
                       f'{cdr.MULTI_ARRAY}')
    phases = [_phase(path, topic, k, data) for k, data in enumerate(messages)]
    return recording, tuple(phase._replace(time_ns=phase.time_ns - begin)
                            for phase in sorted(phases, key=lambda phase: phase.time_ns))


def read_experiment_of(path, robot) -> tuple:
    """Return a bag of a robot as (Recording, phases)."""
    return read_experiment(path, robot.joints, motors_in(path, robot))


def motors_in(path, robot) -> tuple[str, ...]:
    """Return the robot's motor names in the bag, '' for others; a rigid joint may have one."""
    names = joint_names(path)
    wanted = (motor or joint + MOTOR_SUFFIX
              for joint, motor in zip(robot.joints, robot.motors, strict=True))
    return tuple(motor if motor in names else '' for motor in wanted)


def _read(path, joints, motors, topics=None):
    """Return the Recording, its first stamp [ns], the Bag, and topic and messages of phases."""
    bag, messages = Bag(path), []
    space = namespace_of(bag)
    phases = space + cdr.PHASE_TOPIC
    series = Series(bag, topics or Topics().within(space), joints, motors)
    series.collect({phases: messages})
    known = series.names
    bag.warn()
    joints, motors = series.sides
    begin, columns = _columns(path, series, motors)
    series.note_others()
    recording, said = with_own_stamps(on_even_clock(
        Recording(joints=joints, source=str(path), **columns)))
    for text in said:
        warnings.warn(text, BagWarning, stacklevel=3)
    recording = with_conditions(recording, conditions_of(path), motors, known)
    return recording, begin, bag, (phases, messages)


def joint_names(path) -> tuple:
    """Return the names in the first joint state of a bag; BagError without any."""
    bag = Bag(path)
    topics = Topics().within(namespace_of(bag))
    for batch in bag.batches({topics.joint_states}):
        for *_, message in batch:
            return names_of(bag, message, topics)
    return names_of(bag, None, topics)


def _columns(path, series, motors):
    """Return the first stamp [ns], and the arrays of the Recording by name."""
    stamps, received, order = series.clock()
    if len(stamps) < 2:
        raise BagError(f'{path}: {series.topics.joint_states} has {len(stamps)} joint state of '
                       'these joints; a recording needs at least 2')
    period = float(np.median(np.diff(stamps)))
    columns = {'time': (stamps - stamps[0]) * 1e-9}
    columns['q_link'], columns['q_motor'] = series.states('position', order)
    columns['dq_link'], columns['dq_motor'] = series.states('velocity', order)
    series.refuse_renamed(stamps, columns['q_motor'])
    columns['tau_motor'] = np.where([not name for name in motors], *series.states('effort', order))
    columns['command'] = series.commands(stamps, received, period)
    joints = series.sides[0]
    driven = [motor or joint for joint, motor in zip(joints, motors, strict=True)]
    for name, values in columns.items():
        if name != 'time':
            topic = series.topics.command if name == 'command' else series.topics.joint_states
            _refuse_huge(f'{path}: {topic}', name, values,
                         driven if name.endswith('_motor') else joints, columns['time'])
    columns['reference'] = series.reference(stamps, received, period)
    columns['friction_hat'] = series.friction(stamps)
    columns['supply'] = series.supply(stamps, received)
    return int(stamps[0]), columns


def _refuse_huge(where, name, values, names, time):
    """Raise BagError for a value (T, n) that no joint has; NaN and inf are none."""
    what, unit, most = _QUANTITIES[name.partition('_')[0]]
    bad = np.argwhere((np.abs(values) > most) & np.isfinite(values))
    if len(bad):
        k, j = bad[0]
        raise BagError(f'{where} has {what} {values[k, j]:g} {unit} for {names[j]!r} at '
                       f'{time[k]:.3f} s; is it in counts? Leave that part out, or convert it')


def _phase(path, topic, number, data):
    """Return the Phase of one message, its time still a stamp."""
    try:
        dims, values = cdr.unpack_multi_array(data)
        stamp = cdr.stamp_of(dims)
    except BagError as error:
        raise BagError(f'{path}: topic {topic!r} message {number} {error}') from None
    texts = dict(label.split(':', 1) for label, _, _ in dims if ':' in label)
    missing = [f'{name}:' for name in _LABELS if name not in texts]
    missing += [cdr.STAMP_LABEL] if stamp is None else []
    wrong = [f'{len(values)} values'] * (len(values) != 1)
    wrong += [f'no label {" or ".join(missing)}'] * bool(missing)
    if wrong:
        raise BagError(f'{path}: topic {topic!r} message {number} has {" and ".join(wrong)}; '
                       f'a phase has one value and the labels {cdr.STAMP_LABEL}, phase:, joint: '
                       'and step:')
    return Phase(stamp, *(texts[name] for name in _LABELS), float(values[0]))
