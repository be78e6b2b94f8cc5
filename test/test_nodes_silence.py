# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A controller whose joint states stop, or make no sense, leaves zero torque on the wire."""

from node_harness import array_message, joint_state, Lab, stamp_of
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

# other processes of the machine can delay real nodes beyond any bound
pytestmark = pytest.mark.flaky(reruns=2)

PERIOD = 5_000_000
NAMES = ['joint1', 'joint2', 'joint1_motor', 'joint2_motor']


@pytest.fixture(scope='module')
def lab(tmp_path_factory):
    """Run a controller in real time on states and references that the test makes."""
    with Lab(tmp_path_factory.mktemp('silence')) as running:
        running.controller = running.start('controller_node')
        running.states = running.speak(JointState, '/joint_states')
        running.references = running.speak(Float64MultiArray, '/reference')
        running.commands = running.listen(Float64MultiArray, '/effort_controller/commands')
        running.until(lambda: running.states.get_subscription_count()
                      and running.references.get_subscription_count())
        running.stamp = 10**9
        yield running
        assert running.controller.runs and 'Traceback' not in running.controller.printed()


def push(lab, position=(0.0, 0.0, 0.0, 0.0)):
    """Send states with references 0.2 rad ahead until one is answered; return the answer."""
    first, seen = lab.stamp + PERIOD, len(lab.commands)
    motion = np.zeros((5, 2))
    motion[0] = 0.2

    def answers():
        lab.stamp += PERIOD
        lab.references.publish(array_message(motion.ravel(), f'stamp:{lab.stamp}'))
        lab.states.publish(joint_state(lab.stamp, position, names=NAMES))
        return [one for one in lab.commands[seen:] if first <= stamp_of(one)]
    return lab.until(answers)[-1]


def moving(lab):
    """Return whether the controller pushes."""
    return any(abs(torque) > 0.01 for torque in push(lab).data)


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
