# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`gms_flex view live` without a browser: a robot of somebody else, in a namespace."""

import base64
from concurrent.futures import ThreadPoolExecutor
import http.client
import json
import re
import sys

import node_harness
from node_harness import array_message, Float64MultiArray
import numpy as np
import pytest

diagnostics = pytest.importorskip('diagnostic_msgs.msg')

NAMES = ['gripper', 'axis_b_motor', 'axis_a', 'axis_b']
PERIOD = 10_000_000  # [ns]


@pytest.fixture(scope='module')
def lab(tmp_path_factory):
    """Run the tool on a namespace that only this test speaks in; yield the Lab."""
    with node_harness.Lab(tmp_path_factory.mktemp('view')) as lab:
        lab.view = lab.run([sys.executable, '-m', 'gms_flex_control.cli.main', 'view', 'live',
                            '--namespace', 'left', '--port', '0'], 'view')
        lab.states = lab.speak(node_harness.JointState, '/left/joint_states')
        lab.commands = lab.speak(Float64MultiArray, '/left/effort_controller/commands')
        lab.references = lab.speak(Float64MultiArray, '/left/reference')
        lab.reports = lab.speak(diagnostics.DiagnosticArray, '/diagnostics')
        lab.stamp = 0
        lab.until(lambda: 'http://' in lab.view.printed())
        lab.until(lambda: all(one.get_subscription_count() for one in (
            lab.states, lab.commands, lab.references, lab.reports)))
        yield lab


def ask(lab, path, what=None):
    """Return status and JSON of one request; ``what`` is asked for with the page's token."""
    connection = http.client.HTTPConnection(lab.view.printed().split('/')[2], timeout=30)
    if what is None:
        connection.request('GET', path)
    else:
        connection.request('GET', '/')
        page = connection.getresponse().read().decode()
        token = re.search(r'name="token" content="([^"]+)"', page)
        connection.request('POST', path, json.dumps(what), {'X-Token': token.group(1)})
    answer = connection.getresponse()
    result = answer.status, json.loads(answer.read())
    connection.close()
    return result


def move(lab):
    """Publish one joint state with the reference and command that belong to it."""
    lab.stamp += PERIOD
    angle = lab.stamp * 1e-9
    label = f'stamp:{lab.stamp}'
    lab.references.publish(array_message([0.0, angle + 0.25, 0.0], label))
    angles = [0.0, 2 * angle, angle, 2 * angle - 0.125]
    lab.states.publish(node_harness.joint_state(lab.stamp, angles, names=NAMES))
    lab.commands.publish(array_message([1.0, 2.0, 3.0], label))
    lab.spin()


def known(lab):
    """Return the session once the joints are known, moving meanwhile."""
    move(lab)
    return (session := ask(lab, '/api/session')[1])['scene'] and session


def event_of(lab, condition):
    """Return the first event of the stream that meets a condition, moving meanwhile."""
    connection = http.client.HTTPConnection(lab.view.printed().split('/')[2], timeout=30)
    connection.request('GET', '/api/live')
    answer = connection.getresponse()
    assert answer.headers['Content-Type'] == 'text/event-stream'
    while True:
        move(lab)
        line = answer.readline()
        if line.startswith(b'data: ') and condition(event := json.loads(line[6:])):
            connection.close()
            return event


def rows_of(lab, session):
    """Return the first rows of the stream by column name."""
    event = event_of(lab, lambda event: event.get('rows'))
    assert event['version'] == session['version']
    names = session['columns']
    data = np.frombuffer(base64.b64decode(event['rows'])).reshape(-1, len(names))
    return dict(zip(names, data.T, strict=True))


def test_joints_of_another_robot_are_found_by_name_and_drawn_alike(lab):
    session = lab.until(lambda: known(lab))
    assert session['title'] == 'running loop in /left'
    assert session['scene']['joints'] == ['gripper', 'axis_a', 'axis_b']
    assert session['scene']['rigid'] == [True, True, False] and not session['scene']['known']
    assert session['controller'] == '/left/cascade_controller'


def test_bytes_that_make_no_message_end_nothing(lab):
    session = lab.until(lambda: known(lab))
    for data in (b'\0\1\0\0', b'\0\1\0\0' + 20 * b'\xff'):
        for publisher in (lab.states, lab.commands, lab.reports):
            publisher.publish(data)
    lab.spin(0.5)
    assert len(rows_of(lab, session)['command.0'])


def test_what_belongs_together_is_in_one_row(lab):
    session = lab.until(lambda: known(lab))
    for _ in range(20):
        move(lab)
    rows = rows_of(lab, session)
    whole = np.isfinite(rows['command.0'] + rows['error.1'])
    whole[:5] = False  # not everybody may have met everybody yet
    assert whole.any()
    np.testing.assert_allclose(rows['error.1'][whole], -0.25, atol=1e-9)
    np.testing.assert_allclose(rows['torsion.2'], 0.125, atol=1e-9)
    assert np.isnan(rows['torsion.1']).all()
    assert {tuple(row) for row in np.stack([rows[f'command.{j}'][whole] for j in range(3)], 1)
            } == {(1.0, 2.0, 3.0)}


@pytest.mark.parametrize('names, late', [
    (('states out', 'states without a fresh command'), 0.25),
    (('samples', 'samples without a fresh command', 'samples left out'), 0.4)])  # 2/4 of 5/4
def test_state_and_late_share_are_those_of_the_plant_in_the_namespace(names, late, lab):
    def report(sample):
        message = diagnostics.DiagnosticArray(status=[status(sample, 'left/plant', 'FAULT'),
                                                      status(sample, 'plant', 'ACTIVE')])
        message.header.stamp.sec = sample // 100
        lab.reports.publish(message)

    def status(sample, name, state):
        counts = sample, sample // 4, sample // 4
        values = {'state': state, 'reason': reason,
                  **dict(zip(names, map(str, counts), strict=False))}
        return diagnostics.DiagnosticStatus(name=name, hardware_id=f'/{name}', values=[
            diagnostics.KeyValue(key=key, value=value) for key, value in values.items()])

    reason = f'joint1 moves at {late} rad/s'  # the view still shows what another run reported
    samples = iter(range(100, 100_000, 100))
    robot = event_of(lab, lambda event: report(next(samples)) or (
        (event['robot'] or {}).get('reason') == reason and event['robot']['rate']))['robot']
    assert robot == {'state': 'FAULT', 'reason': reason, 'rate': 100.0, 'late': late}


def test_requests_reach_the_services_of_the_namespace(lab):
    def stop(_, response):
        response.success, response.message = True, 'FAULT: emergency stop by service'
        return response
    lab.node.create_service(node_harness.Trigger, '/left/plant/emergency_stop', stop)
    with ThreadPoolExecutor(1) as pool:  # this thread answers
        def answered():
            future = pool.submit(ask, lab, '/api/call', {'name': 'emergency_stop'})
            lab.until(future.done)
            return future.result() if future.result()[0] == 200 else None  # it is known by then
        asked = lab.until(answered)
    assert asked == (200, {'success': True, 'message': 'FAULT: emergency stop by service'})
    status, answer = ask(lab, '/api/call', {'name': 'start'})
    assert status == 503 and answer['reason'] == (
        '/left/trajectory/start does not answer: is trajectory_node running?')
    status, answer = ask(lab, '/api/call', {'name': 'reboot'})
    assert status == 503 and answer['reason'].startswith('reboot cannot be asked for here, only')


def test_without_a_controller_gains_are_a_sentence_and_the_end_is_clean(lab):
    status, answer = ask(lab, '/api/parameters')
    assert status == 503
    assert answer['reason'].startswith('/left/cascade_controller does not answer')
    assert lab.view.signal(node_harness.TERM) == 0
