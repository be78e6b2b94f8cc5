# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A controller whose joint states stop, or make no sense, leaves zero torque on the wire."""

import time

from node_harness import array_message, joint_state, Lab, stamp_of, Trigger
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

# other processes of the machine can delay real nodes beyond any bound
pytestmark = pytest.mark.flaky(reruns=2)

DiagnosticArray = pytest.importorskip('diagnostic_msgs.msg').DiagnosticArray
PERIOD = 5_000_000
NAMES = ['joint1', 'joint2', 'joint1_motor', 'joint2_motor']


class Said(list):
    """What the controller says of itself."""

    def append(self, message):
        super().extend(one.message for one in message.status if one.name == 'cascade_controller')


@pytest.fixture(scope='module')
def lab(tmp_path_factory):
    """Run a controller in real time on states and references that the test makes."""
    with Lab(tmp_path_factory.mktemp('silence')) as running:
        running.controller = running.start('controller_node')
        running.states = running.speak(JointState, '/joint_states')
        running.references = running.speak(Float64MultiArray, '/reference')
        running.said = Said()
        running.listen(DiagnosticArray, '/diagnostics', running.said)
        running.commands = running.listen(Float64MultiArray, '/effort_controller/commands')
        running.until(lambda: running.states.get_subscription_count()
                      and running.references.get_subscription_count())
        running.stamp = 10**9
        yield running
        assert running.controller.runs and 'Traceback' not in running.controller.printed()


def push(lab, position=(0.0, 0.0, 0.0, 0.0), *, velocity=None, frozen=(), torque=None,
         sources=((),)):
    """
    Send states with references 0.2 rad ahead until one is answered; return the answer.

    All angles shiver by a microradian but those whose indices are in ``frozen``. Each of
    ``sources`` are the labels that a reference carries beyond its stamp; ``torque`` [N m] asks
    for that instead.
    """
    first, seen = lab.stamp + PERIOD, len(lab.commands)

    def answers():
        lab.stamp += PERIOD
        shiver = 1e-6 * (lab.stamp // PERIOD % 2)
        angles = [angle + shiver * (k not in frozen) for k, angle in enumerate(position)]
        for labels in sources:
            lab.references.publish(reference(torque, f'stamp:{lab.stamp}', *labels))
        lab.states.publish(joint_state(lab.stamp, angles, names=NAMES, velocity=velocity))
        return [one for one in lab.commands[seen:] if first <= stamp_of(one)]
    return lab.until(answers)[-1]


def reference(torque, *labels):
    """Return a reference 0.2 rad ahead, or of a torque."""
    data, kind = [0.2, 0.2, *[0.0] * 8], 'derivative'
    if torque is not None:
        data, kind = [torque, torque], 'effort'
    message = array_message(data, kind, 'joint', *labels)
    message.layout.dim[0].size, message.layout.dim[1].size = len(data) // 2, 2
    return message


def moving(lab, **options):
    """Return whether the controller pushes."""
    return any(abs(torque) > 0.01 for torque in push(lab, **options).data)


def test_silence_is_answered_with_zero(lab):
    lab.until(lambda: moving(lab))
    lab.until(lambda: not any(lab.commands[-1].data))
    lab.until(lambda: 'no usable joint state for 30 ms' in lab.controller.printed())


def test_states_that_are_all_refused_are_silence(lab):
    lab.until(lambda: moving(lab))
    nan = joint_state(lab.stamp + PERIOD, (np.nan,) * 4, names=NAMES)

    def refused_and_zero():
        lab.states.publish(nan)
        return not any(lab.commands[-1].data)
    lab.until(refused_and_zero)


def test_a_state_that_makes_no_sense_gives_no_torque_that_is_not_finite(lab):
    lab.until(lambda: moving(lab))
    assert np.isfinite(push(lab, (9e5, 0.0, 0.0, 0.0)).data).all()
    assert np.isfinite([one.data for one in lab.commands]).all()
    lab.until(lambda: moving(lab))  # and it goes on with the next sound one


TURNS = {'velocity': (0.5, 0.0, 0.0, 0.0), 'frozen': (0,)}  # joint1 says so, not its encoder
STANDS = {'frozen': (0,)}
MOTORS = {'frozen': (2, 3)}


def freeze(lab):
    """Let joint1 turn with its encoder frozen until torque ends; return after what time [ns]."""
    lab.until(lambda: moving(lab))
    lab.until(lambda: moving(lab, **STANDS))
    begin = lab.stamp
    lab.until(lambda: not any(push(lab, **TURNS).data))
    return next(stamp_of(one) for one in lab.commands
                if stamp_of(one) > begin and not any(one.data)) - begin


def test_an_angle_that_stays_the_same_though_its_velocity_tells_of_more_ends_torque(lab):
    assert freeze(lab) <= 50_000_000  # 20 mrad take 40 ms
    lab.until(lambda: 'joint1 has been at exactly 0 rad for' in lab.controller.printed())
    assert 'call /cascade_controller/reset' in lab.controller.printed()
    # it stays so for as long as the angle does, now at rest
    assert not any(any(push(lab, **STANDS).data) for _ in range(50))


def test_once_the_angle_changes_torque_rises_again_from_zero(lab):
    freeze(lab)
    torques = [max(map(abs, push(lab).data)) for _ in range(20)]
    assert torques[0] < 0.02 < 0.1 < torques[-1]


def test_a_reset_leads_on_though_the_angle_stays_the_same(lab):
    freeze(lab)
    assert lab.call(Trigger, '/cascade_controller/reset').success
    lab.until(lambda: moving(lab, **STANDS))


def test_a_motor_that_does_not_give_way_to_its_torque_ends_it(lab):
    lab.until(lambda: moving(lab))
    lab.until(lambda: moving(lab, torque=0.1, **MOTORS))
    lab.until(lambda: moving(lab, torque=1.5, **MOTORS))
    lab.until(lambda: not any(push(lab, torque=1.5, **MOTORS).data))
    lab.until(lambda: push(lab, **MOTORS) and 'or the motor blocked' in ''.join(lab.said))
    lab.until(lambda: moving(lab))


@pytest.mark.parametrize('sources, named', [
    ((('source:/a#1',), ('source:/b#2',)), '/a#1 and /b#2'),
    ((('source:/a#1',), ()), '/a#1 and somebody without a source label')])
def test_two_sources_of_references_end_torque_and_are_named(lab, sources, named):
    lab.until(lambda: moving(lab, sources=sources[:1]))
    sentence, known = f'2 nodes send references at once: {named}: zero torque', len(lab.said)
    lab.until(lambda: push(lab, sources=sources) and sentence in lab.said[known:])
    assert not any(moving(lab, sources=sources) for _ in range(20))
    lab.until(lambda: moving(lab, sources=sources[1:]))  # one is left: it goes on


def test_another_source_that_is_alone_is_followed_at_once(lab):
    """As after a restart of the trajectory node: its source is new, the old one silent."""
    lab.until(lambda: moving(lab, sources=[('source:/a#1',)]))
    later = time.monotonic() + 0.3  # 50 ms of silence at least, and all of that is told
    lab.until(lambda: time.monotonic() > later)
    known = len(lab.said)
    lab.until(lambda: moving(lab, sources=[('source:/a#2',)]) and 'following' in lab.said[known:])
    assert not any('at once' in said for said in lab.said[known:])


def test_a_source_of_another_time_is_nobody(lab):
    lab.until(lambda: moving(lab))
    known = len(lab.said)
    for _ in range(20):
        lab.references.publish(array_message(np.zeros(10), f'stamp:{lab.stamp - 10**9}',
                                             'source:/old#1'))
        push(lab)
    lab.until(lambda: moving(lab))
    assert not any('at once' in said for said in lab.said[known:])


@pytest.mark.parametrize('labels', [(), ('source:/mine',)])
def test_references_need_no_layout(lab, labels):
    """As from the command line; without a stamp they are for the state there is."""
    def pushes():
        lab.references.publish(array_message([0.2, 0.2, *[0.0] * 8], *labels))
        return any(abs(torque) > 0.01 for torque in push(lab, sources=()).data)
    lab.until(pushes)
