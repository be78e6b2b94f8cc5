# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`gms_flex view` without a browser: columns, decimation, rows of a running loop, the server."""

import http.client
import json
from pathlib import Path
import re
import signal
import subprocess

from core_runs import single_axis
from gms_flex_control import friction as gms
from gms_flex_control.data import cdr
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.writer import BagWriter
from gms_flex_control.file_io import share_path
from gms_flex_control.schema.files import load_robot
from gms_flex_control.view.live import JointStateTable
from gms_flex_control.view.recorded import (
    BagView,
    blocks_along,
    CHUNK,
    extent,
    open_bag,
    places,
    scene_of,
    unknown_scene,
)
from gms_flex_control.view.server import refusal_of_host, ViewServer
import numpy as np
from processes import TOOL
import pytest

PERIOD = 0.01
ROOT = Path(__file__).resolve().parents[1]


def recording(samples=5000, n=2, **changes):
    """Return a recording of n joints with everything in it."""
    time = PERIOD * np.arange(samples)
    link = np.sin(time[:, None] + np.arange(n))
    fields = {'q_link': link, 'dq_link': np.cos(time[:, None] + np.arange(n)),
              'q_motor': link + 0.1, 'command': 2.0 * link, 'friction_hat': 0.3 * link,
              'reference': np.repeat((link - 0.002)[:, None], 5, axis=1)} | changes
    return Recording(joints=tuple(f'joint{j + 1}' for j in range(n)), time=time, source='made up',
                     **fields)


def view_of(recorded, torque=None, sticking=None):
    """Return a BagView and a function that takes a column out of its tables."""
    flexible = np.isfinite(recorded.q_motor).any(axis=0)
    view = BagView(recorded, unknown_scene(recorded.joints, flexible), torque, sticking)
    names = view.session()['columns']
    return view, lambda table, name: table[names.index(name)]


def test_frames_of_every_level_are_the_samples_in_order():
    recorded = recording()
    view, column = view_of(recorded)
    for level in (0, 2):
        stride, span = 2 ** level, CHUNK * PERIOD * 2 ** level
        tables = [view.frames(level, chunk) for chunk in range(int(50 / span) + 1)]
        assert view.frames(level, len(tables) + 1).shape[1] == 0
        time = np.concatenate([column(table, 'time') for table in tables])
        np.testing.assert_array_equal(time, recorded.time[::stride])
        error = np.concatenate([column(table, 'error.1') for table in tables])
        np.testing.assert_allclose(error, 0.002, atol=1e-12)
        assert all(column(table, 'torsion.0') == pytest.approx(0.1) for table in tables)


def test_a_chart_of_few_points_keeps_every_peak_and_the_share_of_sticking():
    link = recording().q_link.copy()
    link[1234, 0], link[4321, 1] = 7.0, -9.0
    sticking = np.zeros((5000, 2, 3))
    sticking[:2500, 0, 1] = 1.0
    view, column = view_of(recording(q_link=link), sticking, sticking)
    table = view.plots(0.0, 50.0, 200)
    assert table.shape[1] == 200
    assert column(table, 'link.0').max() == 7.0 and column(table, 'link.1').min() == -9.0
    assert column(table, 'stick.0.1').mean() == pytest.approx(0.5, abs=0.01)
    assert not column(table, 'stick.1.2').any()


def test_one_rigid_joint_and_many_joints_have_a_scene(robot):
    rigid = scene_of(single_axis(robot.friction.of_joints([0]), 0.1))
    assert rigid.rigid == (True,) and rigid.kind == 'decoupled' and rigid.length[0] > 0.0
    chain = unknown_scene([f'j{k}' for k in range(7)], [True] * 7)
    straight = extent(chain, np.zeros((4, 7)))
    np.testing.assert_allclose(straight, (0.0, 0.0, sum(chain.length), 0.0))
    bent = extent(chain, np.array([[np.pi / 2] + [0.0] * 6]))
    np.testing.assert_allclose(bent, (0.0, 0.0, 0.0, sum(chain.length)), atol=1e-9)


def test_places_in_space_are_those_of_mujoco():
    mujoco = pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")
    arm = load_robot(share_path() / 'examples' / 'industrial_arm' / 'robot.yaml')
    model = mujoco.MjModel.from_xml_path(str(arm.arm.frames.source))
    data, angles = mujoco.MjData(model), np.random.default_rng(4).uniform(-2.0, 2.0, (5, 6))
    found = places(scene_of(arm), angles)
    for pose, points in zip(angles, found, strict=True):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(points[1:-1], data.xpos[model.jnt_bodyid], atol=1e-9)
    np.testing.assert_allclose(extent(scene_of(arm), angles), (
        *found.min(axis=(0, 1)), *found.max(axis=(0, 1))))


def test_blocks_along_a_motion_are_those_of_the_model_stepped_by_hand(robot):
    recorded = recording(samples=200)
    torque, sticking = blocks_along(recorded, robot.friction)
    state = gms.init(robot.friction)
    for k in range(1, 200):
        state = state.copy()
        gms.advance(state, recorded.q_link[k] - recorded.q_link[k - 1], recorded.dq_link[k],
                    PERIOD, gms.constants_of(robot.friction))
        np.testing.assert_allclose(torque[k], state.torque, atol=1e-7)
        np.testing.assert_array_equal(sticking[k], state.sticking)
    assert 0.0 < sticking.mean() < 1.0


def write_bag(path, start=5_000_000_000):
    """Write 100 joint states."""
    stamps = start + 10_000_000 * np.arange(100)
    angle = np.linspace(0.0, 1.0, 100)
    with BagWriter(path, {'/joint_states': cdr.JOINT_STATE}, atomic=True) as writer:
        for k, message in enumerate(cdr.pack_joint_states(
                ['joint1', 'joint2'], stamps, np.stack([angle, -angle], axis=1))):
            writer.write('/joint_states', int(stamps[k]), message)
    return path


def test_the_blocks_of_a_bag_are_those_of_the_robot_file(tmp_path, robot):
    path = write_bag(tmp_path / 'bag')
    assert open_bag(path).session()['blocks'] == {'count': 0, 'origin': ''}
    for options in ({'robot': robot}, {'default': robot}):
        session = open_bag(path, **options).session()
        assert session['blocks'] == {'count': 6, 'origin': 'model'}
        assert session['scene']['length'] == (0.35, 0.3)


def test_other_bags_are_drawn_over_the_first_from_their_beginnings(tmp_path):
    """Whenever they were recorded; where one has ended there is no line."""
    first = write_bag(tmp_path / 'first')
    later = write_bag(tmp_path / 'later', start=9_000_000_000)
    view = open_bag(first, others=[later, later])
    session, table = view.session(), view.plots(0.0, 1.0, 400)
    assert session['over'] == 2 and session['title'].endswith(', pale: later, later')
    columns = dict(zip(session['columns'], table, strict=True))
    for number in (1, 2):
        np.testing.assert_array_equal(columns[f'link.1@{number}'], columns['link.1'])
        assert np.isnan(columns[f'command.0@{number}']).all()
    longer, _ = view_of(recording(samples=10))
    assert longer.session()['over'] == 0
    view = BagView(recording(samples=20), unknown_scene(['joint1', 'joint2'], [True] * 2),
                   over=[recording(samples=10)])
    table = view.frames(0, 0)
    column = table[view.session()['columns'].index('error.0@1')]
    np.testing.assert_allclose(column[:10], 0.002, atol=1e-12)
    assert np.isnan(column[10:]).all()


def test_rows_are_put_together_by_stamp_whatever_comes_first():
    rows = JointStateTable(2, 3)
    rows.put('reference', 1_000_000_000, [0.5, 0.6])
    rows.put_state(1_000_000_000, 0.0, [0.1, 0.2], [0.3, 0.4])
    rows.put_state(1_002_000_000, 0.002, [0.11, 0.21], [0.31, np.nan])
    rows.put('command', 1_000_000_000, [1.0, 2.0])
    rows.put('stick', 1_002_000_000, [1, 0, 1, 0, 1, 0])
    rows.put('error', 1_002_000_000, [0.01, 0.02])
    rows.put('command', None, [3.0, 4.0])  # without a stamp: of the newest state
    rows.put('command', 17, [9.0, 9.0])
    rows.put('block', 1_002_000_000, [1.0])  # of another robot
    assert rows.take(0.01).shape[0] == 0  # they wait for what belongs to them
    table = rows.take(1.0)
    first, second = (dict(zip(rows.names, row, strict=True)) for row in table)
    assert first['time'] == 0.0 and second['time'] == pytest.approx(0.002)
    assert first['error.0'] == pytest.approx(-0.4) and first['torsion.1'] == pytest.approx(0.2)
    assert (first['command.0'], second['command.1']) == (1.0, 4.0)
    assert second['reference.0'] == pytest.approx(0.10)  # what the controller calls its error
    assert np.isnan(second['torsion.1']) and np.isnan(second['block.0.0'])
    assert [second[f'stick.{j}.{i}'] for j in range(2) for i in range(3)] == [1, 0, 1, 0, 1, 0]
    rows.put('reference', 1_009_000_000, [0.5])  # of one joint: none of this robot
    rows.put('reference', 1_020_000_000, [0.5, 0.6, 1.0, -1.0])  # carried back by its rate
    for stamp in (1_005_000_000, 1_018_000_000):
        rows.put_state(stamp, 2.0, [0.1, 0.2], [0.1, 0.2])
    alone, carried = rows.take(3.0)[:, rows.names.index('reference.0'):][:, :2]
    assert np.isnan(alone).all() and carried == pytest.approx([0.498, 0.602])


def test_of_a_fast_loop_only_spaced_states_make_rows():
    rows = JointStateTable(1, 0, spacing=4_000_000)
    for k in range(100):
        stamp = 1_000_000_000 + k * 1_000_000
        assert rows.wants(stamp) is (k % 4 == 0)
        rows.put_state(stamp, 0.0, [0.001 * k], [0.0])
        assert rows.wants_more('command', stamp) is (k % 4 == 0)
        if rows.wants_more('reference', stamp):
            assert k % 4 == 0
            rows.put('reference', stamp, [0.001 * k])
    table = rows.take(1.0)
    np.testing.assert_allclose(table[:, 0], 0.004 * np.arange(25), atol=1e-12)
    np.testing.assert_allclose(table[:, rows.names.index('error.0')], 0.0, atol=1e-12)
    assert rows.wants(0) and not rows.wants(1_000_000_000)  # set back for good, and a repetition


class FakeLoop:
    """A running loop without ROS."""

    live = True

    def __init__(self):
        self.given = []

    def set_parameter(self, name, value):
        self.given.append((name, value))
        return {'accepted': True, 'reason': '', 'value': value}

    def call(self, name):
        self.given.append(name)
        return {'success': True, 'message': 'ZERO'}


@pytest.fixture
def served():
    """Serve a made-up running loop; yield the server."""
    with ViewServer(FakeLoop()) as server:
        yield server


def ask(server, method, path, body=None, **headers):
    """Return status, headers and body of one request; '_' in a header's name is a '-'."""
    connection = http.client.HTTPConnection(*server.server_address[:2], timeout=20)
    connection.request(method, path, body, {
        name.replace('_', '-'): value for name, value in headers.items()})
    answer = connection.getresponse()
    result = answer.status, answer.headers, answer.read()
    connection.close()
    return result


CHANGE = json.dumps({'name': 'gains.joint1.kd_link', 'value': 1.5})


def test_a_change_with_the_token_of_the_page_is_passed_on(served):
    page = ask(served, 'GET', '/')[2].decode()
    token = re.search(r'name="token" content="([^"]{30,})"', page).group(1)
    host = served.url.removeprefix('http://').rstrip('/')
    status, _, body = ask(served, 'POST', '/api/parameters', CHANGE, X_Token=token,
                          Origin=f'http://{host}', Sec_Fetch_Site='same-origin')
    assert (status, json.loads(body)['value']) == (200, 1.5)
    body = ask(served, 'POST', '/api/call', '{"name": "stop"}', X_Token=token)[2]
    assert json.loads(body) == {'success': True, 'message': 'ZERO'}
    assert served.view.given == [('gains.joint1.kd_link', 1.5), 'stop']


@pytest.mark.parametrize(('headers', 'reason'), [
    ({}, 'token of the page is missing'), ({'X_Token': 'x' * 32}, 'token of the page is missing'),
    ({'X_Token': None, 'Origin': 'http://evil.example'}, 'a page of http://evil.example may not'),
    ({'X_Token': None, 'Origin': 'null'}, 'a page of null may not'),
    ({'X_Token': None, 'Sec_Fetch_Site': 'cross-site'}, 'a page of another site may not'),
    ({'X_Token': None, 'Host': 'evil.example'}, "this server is not 'evil.example'")])
def test_a_change_from_elsewhere_is_refused(served, headers, reason):
    given = {name: served.token if value is None else value for name, value in headers.items()}
    for path, what in (('/api/parameters', CHANGE), ('/api/call', '{"name": "stop"}')):
        status, _, body = ask(served, 'POST', path, what, **given)
        assert status == 403 and reason in json.loads(body)['reason']
    assert served.view.given == []


@pytest.mark.parametrize(('path', 'word', 'body'), [
    *(('parameters', 'a change', body) for body in (
        '{', '[]', '{"name": 1, "value": 1}', '3', '[' * 9000,
        '{"name": "gains.a", "value": true}', 'x' * 20_000)),
    *(('call', 'a request', body) for body in ('[]', '{}', '{"name": 3}'))])
def test_a_malformed_change_or_request_is_refused(served, path, word, body):
    status, _, answer = ask(served, 'POST', f'/api/{path}', body, X_Token=served.token)
    assert status == 400 and json.loads(answer)['reason'].startswith(word)


@pytest.mark.parametrize('path', [
    '/../setup.py', '/assets/../server.py', '/assets/%2e%2e/server.py', '/assets//etc/passwd',
    '/etc/passwd', '/assets/', '/api/frames?level=0&chunk=0', '/assets/index.html%00.js'])
def test_nothing_but_the_page_can_be_fetched(served, path):
    assert ask(served, 'GET', path)[0] == 404


def test_pages_load_nothing_from_elsewhere_and_cannot_be_framed(served):
    for path in ('/', *(f'/assets/{name}' for name in served.files)):
        status, headers, body = ask(served, 'GET', path)
        assert status == 200 and body
        policy = headers['Content-Security-Policy']
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
        loaded = re.findall(rb'(?:src|href|url|import|fetch)[=(\s"\']+(?:https?:)?//', body)
        assert not loaded, path


def test_every_file_of_the_page_is_served_and_installed(served):
    own = {path.name for path in (ROOT / 'gms_flex_control' / 'view' / 'assets').iterdir()}
    assert own <= set(served.files)
    assert "'view/assets/*'" in (ROOT / 'setup.py').read_text(encoding='utf-8')
    for name, body in served.files.items():
        if name.endswith('.js') and name != 'uPlot.js':
            imported = re.findall(rb"from '\./([\w.]+)'", body)
            assert {one.decode() for one in imported} <= own, name
            assert len(body.splitlines()) < 350


@pytest.mark.parametrize('path', ['/api/frames?level=-1&chunk=0', '/api/frames?level=0&chunk=nan',
                                  '/api/plots?from=0&to=inf&points=10', '/api/plots'])
def test_numbers_that_are_none_are_refused(path):
    with ViewServer(view_of(recording())[0]) as server:
        status, _, body = ask(server, 'GET', path)
        assert status == 400 and 'must be a' in json.loads(body)['reason']


@pytest.mark.parametrize(('asked', 'good'), [
    ('localhost:80', True), ('[::1]:80', True), ('127.0.0.1:8642', True),
    ('192.168.1.5:80', False), (None, False), ('localhost.evil.example', False)])
def test_only_names_of_this_machine_lead_here(asked, good):
    assert (refusal_of_host(asked) == '') is good


def test_the_tool_prints_its_address_and_ends_with_0(tmp_path):
    process = subprocess.Popen([*TOOL, 'view', str(write_bag(tmp_path / 'bag')), '--port', '0'],
                               text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    url = process.stdout.readline().split()[0]
    connection = http.client.HTTPConnection(url.split('/')[2], timeout=20)
    connection.request('GET', '/api/session')
    assert json.loads(connection.getresponse().read())['mode'] == 'bag'
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, '')
