# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Plant, controller and trajectory as three processes in real time: topics and live parameters."""

from itertools import pairwise
import math

from gms_flex_control.params.gains import COMPENSATIONS
import node_harness
from node_harness import Float64MultiArray, interfaces, MOTION, services, stamp_of
import numpy as np
import pytest

RATE = 200.0
PERIOD = 5_000_000  # [ns]

CONTROLLER, PLANT, TRAJECTORY = '/cascade_controller', '/plant', '/trajectory'
KD = 'gains__joint1__kd_link'


def listen(lab):
    """Listen to a loop that moves, and wait until it does."""
    lab.states, lab.commands, lab.references = lab.hear('states', 'commands', 'references')
    lab.errors = lab.listen(node_harness.JointState, '/cascade_controller/state')
    lab.blocks = lab.listen(Float64MultiArray, '/cascade_controller/blocks')
    lab.until(lambda: len(lab.errors) > 20 and any(lab.commands[-1].data))


@pytest.fixture(scope='module')
def loop(tmp_path_factory):
    """Run the three nodes, moving along the sinusoid; yield a Lab that listens to them."""
    with node_harness.Lab(tmp_path_factory.mktemp('loop')) as lab:
        lab.controller = lab.start('controller_node', files=MOTION)
        lab.trajectory = lab.start('trajectory_node', files=MOTION, trajectory__autostart=True)
        lab.plant = lab.start('plant_node', files=MOTION, rate=RATE)
        listen(lab)
        yield lab


@pytest.fixture(autouse=True)
def everything_runs_on(loop):
    """Whatever a test does, all three nodes go on answering."""
    yield
    loop.more(loop.errors, 5)
    for process in (loop.plant, loop.controller, loop.trajectory):
        assert process.runs


def sizes(message):
    return [(dim.label, dim.size) for dim in message.layout.dim]


def test_joint_states_name_links_then_motors(loop):
    state = loop.more(loop.states, 1)[0]
    assert list(state.name) == node_harness.NAMES
    assert len(state.position) == len(state.velocity) == len(state.effort) == 4
    assert all(map(math.isnan, state.effort[:2])) and all(map(math.isfinite, state.effort[2:]))
    assert all(map(math.isfinite, [*state.position, *state.velocity]))


def test_effort_of_a_motor_is_the_torque_applied_in_the_sample_before(loop):
    """The command that answers one state acts until the next."""
    start = len(loop.states)
    loop.more(loop.states, 100)
    commands = {stamp_of(message): message for message in loop.commands}
    efforts = [(commands[stamp_of(before)], after)
               for before, after in pairwise(loop.states[start:]) if stamp_of(before) in commands]
    same = [list(command.data) == pytest.approx(list(state.effort[2:]), abs=1e-12)
            for command, state in efforts]
    assert len(same) > 90 and np.mean(same) > 0.5  # a busy machine may answer some too late


def test_reference_and_command_carry_layout_stamp_and_source(loop):
    reference, command = loop.more(loop.references, 1)[0], loop.more(loop.commands, 1)[0]
    assert sizes(reference) == [('derivative', 5), ('joint', 2),
                                (f'stamp:{stamp_of(reference)}', 1),
                                (f'source:/trajectory#{loop.trajectory.process.pid}', 1)]
    assert len(reference.data) == 10
    (joint, stamp, source) = sizes(command)
    assert joint == ('joint', 2) and stamp == (f'stamp:{stamp_of(command)}', 1)
    assert source == (f'source:/cascade_controller#{loop.controller.process.pid}', 1)
    stamps = {stamp_of(state) for state in loop.states}
    assert stamp_of(command) in stamps and stamp_of(reference) - PERIOD in stamps


def test_controller_publishes_error_estimate_and_blocks(loop):
    error = loop.more(loop.errors, 1)[0]
    assert list(error.name) == node_harness.JOINTS
    # each has arrived by itself; the state and the reference of that stamp come around it
    stamp = stamp_of(error)
    loop.until(lambda: stamp in map(stamp_of, loop.states)
               and stamp in map(stamp_of, loop.references))
    state = next(state for state in loop.states if stamp_of(state) == stamp)
    reference = next(one for one in loop.references if stamp_of(one) == stamp)
    assert list(error.position) == pytest.approx(
        [state.position[j] - reference.data[j] for j in range(2)], abs=1e-12)
    assert list(error.velocity) == pytest.approx(
        [state.velocity[j] - reference.data[2 + j] for j in range(2)], abs=1e-12)
    assert all(map(math.isfinite, error.effort))
    blocks = loop.more(loop.blocks, 1)[0]
    assert sizes(blocks) == [('joint', 2), ('block', 6), (f'stamp:{stamp_of(blocks)}', 1)]
    assert len(blocks.data) == 12
    sticking = loop.more(loop.listen(Float64MultiArray, '/cascade_controller/sticking'), 1)[0]
    assert sizes(sticking)[:2] == [('joint', 2), ('block', 6)]
    assert set(sticking.data) <= {0.0, 1.0}
    loop.until(lambda: stamp_of(blocks) in map(stamp_of, loop.states))


def test_a_gain_changes_and_a_whole_number_is_taken_for_a_double(loop):
    assert loop.set_parameters(CONTROLLER, **{KD: 0.9}).successful
    assert loop.get(CONTROLLER, 'gains.joint1.kd_link') == 0.9
    assert loop.set_parameters(CONTROLLER, **{KD: 1}).successful
    assert loop.get(CONTROLLER, 'gains.joint1.kd_link') == 1.0
    assert loop.set_parameters(CONTROLLER, **{KD: 0.8}).successful


@pytest.mark.parametrize('node, name, value, reason', [
    (CONTROLLER, KD, math.nan, 'must be finite, got nan'),
    (CONTROLLER, KD, -0.1, 'must be from 0 to 1e+09 N m s/rad, got -0.1'),
    (CONTROLLER, KD, 'stiff', 'type'),
    (CONTROLLER, KD, None, 'cannot be undeclared'),
    (CONTROLLER, 'compensation', 'gsm', "disturbance_observer, got 'gsm'"),
    (CONTROLLER, 'arm__joint1__mass', 2.0, 'start it anew with -p arm.joint1.mass:=2.0'),
    (CONTROLLER, 'mode', 'lockstep', 'mode is realtime as long as the node runs'),
    (CONTROLLER, 'gains__joint1__kd_lnk', 1.0, "did you mean 'gains.joint1.kd_link'?"),
    (CONTROLLER, 'gains__joint9__kd_link', 1.0, "unknown joint 'joint9'"),
    (CONTROLLER, 'effects__joint1__backlsh__half_gap', 1.0, "did you mean 'backlash'?"),
    (CONTROLLER, 'trajectory__type', 'hold', 'is not a parameter of /cascade_controller'),
    (CONTROLLER, 'arm__joint1__mass', None, 'read-only'),
    (PLANT, 'rate', 100.0, 'start it anew with -p rate:=100.0'),
    (TRAJECTORY, 'trajectory__type', 'sinus', "did you mean 'sinusoid'"),
    (TRAJECTORY, 'trajectory__joint1__period', 0.0, 'from 0.001 to 10000 s, got 0'),
    (TRAJECTORY, 'trajectory__repeats', 0, 'range')])
def test_a_bad_value_is_refused_with_a_reason_and_the_old_one_stays(loop, node, name, value,
                                                                    reason):
    before = loop.get(node, name.replace('__', '.'))
    result = loop.set_parameters(node, **{name: value})
    assert not result.successful and reason in result.reason
    assert loop.get(node, name.replace('__', '.')) == before


@pytest.mark.parametrize('node', [CONTROLLER, PLANT, TRAJECTORY])
def test_all_parameters_of_a_node_may_be_set_to_what_they_are(loop, node):
    """As 'ros2 param load' does with what 'ros2 param dump' wrote; most are fixed at the start."""
    kind = services.ListParameters
    names = loop.call(kind, f'{node}/list_parameters', kind.Request()).result.names
    kind = services.GetParameters
    values = loop.call(kind, f'{node}/get_parameters', kind.Request(names=names)).values
    kind = services.SetParameters
    results = loop.call(kind, f'{node}/set_parameters', kind.Request(parameters=[
        interfaces.Parameter(name=name, value=value)
        for name, value in zip(names, values, strict=True)])).results
    assert len(names) > 30 and not [result.reason for result in results if not result.successful]


def test_a_group_is_taken_whole_or_not_at_all(loop):
    group = {KD: 0.7, 'gains__joint2__kd_link': -1.0}
    assert not loop.set_parameters(CONTROLLER, together=True, **group).successful
    assert loop.get(CONTROLLER, 'gains.joint1.kd_link') == 0.8
    first, second = loop.set_parameters(CONTROLLER, **group)  # one by one
    assert first.successful and not second.successful
    back = {KD: 0.8, 'gains__joint2__kd_link': 0.8}
    assert loop.set_parameters(CONTROLLER, together=True, **back).successful
    points = {'trajectory__type': 'via_points', 'trajectory__joint1__points': [0.0, 0.1]}
    result = loop.set_parameters(TRAJECTORY, together=True, **points)  # joint2 has three
    assert not result.successful and 'the same number of points' in result.reason
    assert loop.get(TRAJECTORY, 'trajectory.type') == 'sinusoid'


def test_descriptors_have_meaning_unit_and_range(loop):
    kind = services.DescribeParameters
    gain, mode, mass, every = loop.call(kind, f'{CONTROLLER}/describe_parameters', kind.Request(
        names=['gains.joint1.kd_link', 'compensation', 'arm.joint1.mass', 'state_every']
    )).descriptors
    assert gain.description == 'K_D1 of the link law [N m s/rad]' and not gain.read_only
    assert gain.additional_constraints == 'from 0 to 1e+09' and not gain.floating_point_range
    assert mode.additional_constraints == f"one of {', '.join(COMPENSATIONS)}"
    assert mass.read_only and mass.description == 'mass of the link [kg]'
    assert every.integer_range[0].from_value == 1
    assert every.type == interfaces.ParameterType.PARAMETER_INTEGER


def test_compensation_changes_while_it_moves(loop):
    assert loop.set_parameters(CONTROLLER, compensation='none').successful
    changed = stamp_of(loop.states[-1]) + 10 * PERIOD
    loop.until(lambda: stamp_of(loop.errors[-1]) > changed)
    assert list(loop.errors[-1].effort) == [0.0, 0.0]
    assert loop.set_parameters(CONTROLLER, compensation='gms').successful
    loop.until(lambda: all(loop.errors[-1].effort))
    limit = 2.0
    assert all(abs(torque) <= limit for message in loop.commands for torque in message.data)


def test_breaking_the_gain_condition_warns_once_with_the_numbers(loop):
    before = loop.controller.printed().count('does not hold')
    assert loop.set_parameters(CONTROLLER, **{KD: 0.1}).successful
    loop.until(lambda: loop.controller.printed().count('does not hold') > before)
    # other gains do not repeat it
    assert loop.set_parameters(CONTROLLER, gains__joint2__torque_limit=1.9).successful
    loop.more(loop.commands, 50)
    new = [line for line in loop.controller.printed().splitlines() if 'does not hold' in line]
    new = new[before:]
    assert all('WARN' in line and 'joint1' in line for line in new)
    assert len(new) == len({line.split(']: ', 1)[1] for line in new})
    assert any('is not above' in line and '0.1' in line for line in new)
    assert loop.set_parameters(CONTROLLER, **{KD: 0.8}).successful
