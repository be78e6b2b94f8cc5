# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What a lost reference and a robot that is elsewhere make of the reference, sample by sample."""

from types import SimpleNamespace

import numpy as np
import pytest

following = pytest.importorskip('gms_flex_control.nodes.following')
messages = pytest.importorskip('gms_flex_control.nodes.messages')
wire = pytest.importorskip('bench.faults.wire')
Reference, References, Handover = (following.Reference, following.References,
                                   following.Handover)
NS, PERIOD = 10**9, 2_000_000
MOTION = np.array([[0.5, -0.2], [0.4, 0.1], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])


def lost_at(hold=1.0, relax=0.5):
    """Return References whose last motion was for the state at time 0."""
    kept = References(0.1, hold, relax)
    kept.keep(0, Reference('motion', MOTION))
    return kept


def test_a_reference_is_carried_on_until_its_timeout_then_braked_held_and_let_go():
    kept, torque, rows, phases = lost_at(), np.array([0.3, -0.1]), [], []
    for stamp in range(0, 2 * NS, PERIOD):
        reference = kept.at(stamp)
        phases.append(kept.phase)
        if reference is None:
            break
        rows.append((stamp / NS, reference))
        if reference.quantity == 'motion':
            kept.answered(torque, PERIOD / NS)
    changes = [phases[0], *(b for a, b in zip(phases, phases[1:], strict=False) if a != b)]
    assert changes == ['following', 'holding', 'relaxing', None]
    motion = np.array([row.value for _, row in rows if row.quantity == 'motion'])
    assert np.abs(np.diff(motion[:, 0], axis=0)).max() <= 1.01 * 0.4 * PERIOD / NS * 2.0
    assert np.abs(motion[-1, 1:]).max() == 0.0  # at rest
    assert np.all(np.abs(motion[-1, 0] - motion[50, 0]) < 0.2)  # near where it was lost
    efforts = [(time, row.value[0]) for time, row in rows if row.quantity == 'effort']
    assert efforts[0][1] == pytest.approx(torque, rel=0.02)
    assert np.all(np.diff([np.abs(value).sum() for _, value in efforts]) < 0.0)
    assert efforts[-1][0] == pytest.approx(0.1 + 1.0 + 0.5, abs=0.01)


def test_a_handover_begins_at_the_robot_and_ends_at_the_reference():
    way = Handover(2.0)
    way.begin(0, np.array([[1.0, 0.0], [0.0, -0.5]]), MOTION)
    first = way.applied(0, MOTION)
    assert first[:2] == pytest.approx(np.array([[1.0, 0.0], [0.0, -0.5]]))
    assert np.abs(first[2:]).max() < 1e-9
    rows = np.array([way.applied(stamp, MOTION) for stamp in range(0, 2 * NS, PERIOD)])
    step = np.abs(np.diff(rows[:, 0], axis=0)).max() / (PERIOD / NS)
    assert step < 1.0 + np.abs(rows[:, 1]).max()  # no jump on the way
    assert way.applied(2 * NS, MOTION) is MOTION and way.left is None


SHARE = np.minimum(np.arange(200) / 20, 1.0)
EVENLY = range(0, NS, NS // 200)
STALLING = [0, NS // 12, NS // 6, NS // 6 + NS // 500]


@pytest.mark.parametrize(('given', 'moments', 'shares'), [
    ({}, EVENLY, SHARE), ({'torque': np.array([0.4, 0.4])}, EVENLY, SHARE + 0.4 * (1.0 - SHARE)),
    ({}, STALLING, [0.0, 0.1, 0.2, 0.22])])
def test_torque_fades_in_from_the_one_that_is_given_and_jumps_after_no_stall(
        given, moments, shares):
    way, torque = Handover(2.0), np.ones((len(moments), 2))
    way.begin(NS, MOTION[:2], MOTION, **given)
    for since, row in zip(moments, torque, strict=True):
        way.fade(NS + since, row)
    assert torque[:, 0] == pytest.approx(shares)


@pytest.mark.parametrize('bad', [float('nan'), float('inf'), -float('inf'), 1e308, -1e308])
def test_every_bad_number_is_refused_with_joint_and_index(bad):
    reader = messages.JointStateReader(wire.JOINTS, wire.NAMES[2:])
    for k, name in enumerate(wire.NAMES):
        numbers = [0.1 if j != k else bad for j in range(4)]
        for field, values in (('position', (numbers, None)), ('velocity', ([0.0] * 4, numbers))):
            with pytest.raises(messages.RefusedError, match=f'{field} .*{name}.*{field}.{k}.'):
                reader.read(wire.joint_state(0, values[0], velocity=values[1]), None)
    for k in range(2):
        command = wire.array_message([bad if j == k else 0.0 for j in range(2)])
        with pytest.raises(messages.RefusedError, match=rf'joint {k + 1} .*data.{k}.'):
            messages.read_command(command, 2)
    for k in range(10):
        reference = wire.array_message([bad if j == k else 0.0 for j in range(10)])
        row = ('q', 'dq', 'ddq', 'd3q', 'd4q')[k // 2]
        said = rf'has {row} .*joint {k % 2 + 1}.*\[{k}\]'
        with pytest.raises(messages.RefusedError, match=said):
            messages.read_reference(reference, 2)


@pytest.mark.parametrize(('names', 'position', 'velocity', 'reason'), [
    (wire.NAMES[:3], [0.1] * 3, None, "lack 'joint2_motor'"),
    ([*wire.NAMES, 'joint1'], [0.1] * 5, None, "name 'joint1' more than once"),
    (wire.NAMES, [0.1] * 3, None, 'have 4 names and 3 positions'),
    (wire.NAMES, [0.1] * 4, [0.0], '1 velocities')])
def test_the_reason_of_a_refused_state_names_the_culprit(names, position, velocity, reason):
    reader = messages.JointStateReader(wire.JOINTS, wire.NAMES[2:])
    with pytest.raises(messages.RefusedError, match=reason):
        reader.read(wire.joint_state(0, position, names=names, velocity=velocity), None)


def test_a_million_names_make_a_short_sentence():
    with pytest.raises(messages.RefusedError) as refused:
        messages.order_of(['joint1'], [f'x{k}' for k in range(10**6)])
    assert len(str(refused.value)) < 300 and 'and 999992 more' in str(refused.value)


def test_effort_that_is_not_measured_may_be_nan():
    reader = messages.JointStateReader(wire.JOINTS, wire.NAMES[2:])
    state = wire.joint_state(0, (0.1, 0.2, 0.3, 0.4))
    state.effort = [float('nan')] * 4
    taken = SimpleNamespace(q_link=np.zeros(2), dq_link=np.zeros(2), q_motor=np.zeros(2),
                            dq_motor=np.zeros(2))
    reader.read(state, taken)
    assert list(taken.q_motor) == [0.3, 0.4]
