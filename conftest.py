# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Fixtures shared by many tests, which cores a test may use, and which files come first."""

from dataclasses import replace
import gc
from itertools import accumulate
import os
from pathlib import Path
import signal

from devtools import Browser, BrowserError, chromium
from gms_flex_control.params.robot import EncoderParams
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np
import pytest

CONFIG = Path(__file__).parent / 'config'

# a shell that starts the tests in its background has them ignore Ctrl-C, which is tested
signal.signal(signal.SIGINT, signal.default_int_handler)

CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else []


NODES = ('nodes', 'demo', 'colcon', 'sros2', 'view_browser')  # in the names of files
# tests of real nodes are repeated, as other processes of the machine can delay nodes beyond any
# bound; not those of a process without nodes, of bits that agree, of files that are refused
REPEATED = ('nodes_', 'view_live', 'faults', 'soak')
ONCE = [f'test_nodes_{name}' for name in (
    'files', 'following', 'foresight', 'launch', 'lockstep', 'scheduling', 'sros2', 'trajectory')]
WORKER = os.environ.get('PYTEST_XDIST_WORKER', '')
NODES_APART = 3  # processes of tests, from which on the last has the nodes


def has_nodes(path):
    """Return whether a file of tests starts real nodes, or compiles for them."""
    name = Path(path).stem.removeprefix('test_')
    return (name in WITH_NODES or name.startswith(REPEATED)
            or any(word in name for word in NODES))


def pytest_configure():
    """
    Let linear algebra use one thread in processes of tests, and in what they start.

    They inherit it. Each has one core, on which threads of BLAS would wait for each other: where
    others compute as well, tests took twenty times as long.
    """
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    gc.set_threshold(50_000)  # a compiler makes many objects: garbage was sought without end


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """
    Give files with nodes to the last of three processes, others to the rest, while there are such.

    Nodes mostly wait. Two processes that compute use both cores meanwhile, and no nodes run
    beside nodes.
    """
    if config.getoption('dist') != 'loadfile' or len(config.option.tx) < NODES_APART:
        return None
    from xdist.scheduler import LoadFileScheduling

    class NodesApart(LoadFileScheduling):
        def _assign_work_unit(self, node):
            last = node.gateway.id == f'gw{self.numnodes - 1}'
            fitting = next((file for file in self.workqueue if has_nodes(file) == last), None)
            if fitting is not None:
                self.workqueue.move_to_end(fitting, last=False)
            super()._assign_work_unit(node)

    return NodesApart(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """
    Let real nodes have all cores, other tests that run beside them one of their own.

    A computation with a thread per core would starve the nodes of a test in another process. The
    process of the node tests computes once these are done, on whichever core is free.
    """
    if getattr(item, 'execution_count', 1) > 1:
        _begin_anew(item)
    if not WORKER or len(CORES) < 2:
        return
    own = CORES[int(WORKER.removeprefix('gw')) % len(CORES)]
    nodes = item.get_closest_marker('flaky') or has_nodes(item.path)
    with_nodes = WORKER == f'gw{NODES_APART - 1}'
    os.sched_setaffinity(0, CORES if nodes or with_nodes else [own])


def _begin_anew(item):
    """
    Take down what the module of a repeated test shares, so that nodes and robot start anew.

    What the first attempt left (a fault, a robot that was killed) would fail the next as well.
    """
    for found in item._fixtureinfo.name2fixturedefs.values():
        if found[-1].scope == 'module':
            found[-1].finish(item._request)


# files that take longest and about how long [s]; nothing but the order depends on it
WITH_NODES = {
    'control_cascade': 25,  # compiles for two joints what the nodes run
    'nodes_identification': 37, 'demo_discrepancy': 60, 'demo_next': 60, 'nodes_safety': 40,
    'tutorial_with_a_robot': 40, 'faults': 34, 'nodes_namesakes': 33, 'nodes_bridge': 25,
    'nodes_signals': 20, 'colcon_workspace': 20, 'nodes_composed': 19, 'soak': 16,
    'cli_demo': 15, 'nodes_late': 15, 'nodes_lockstep': 14, 'nodes_files': 13,
    'nodes_messages': 12, 'nodes_recorder': 12, 'demo_identify': 12, 'nodes_sros2': 10}
WITHOUT_NODES = {
    'identification_axis': 76,  # compiles for one joint meanwhile
    'identification_loads': 28,  # and for six: no two compile the same
    'discrepancy_workflow': 60, 'results': 34,
    'discrepancy_faults': 28, 'recovery': 21,
    'effects_learned': 16, 'identification_believed_arm': 15, 'speed': 15, 'real_machines': 15,
    'tutorials': 14, 'cli_identify': 14, 'identification_rows': 16, 'tuning_study': 12,
    'design': 12, 'schema_urdf_arm': 11, 'discrepancy_unseen_links': 10, 'hidden_score': 10,
    'discrepancy_validation': 9, 'identification_currents': 9, 'identification_checks': 9,
    'cli': 9, 'discrepancy_noise': 9, 'discrepancy_fast_ripple': 8, 'discrepancy_motion': 12,
    'identification_arm': 7, 'tuning': 6, 'cli_discrepancy': 6}


def pytest_addoption(parser):
    """Add --fast: the files with ``pytestmark = pytest.mark.fast`` alone, for `make test-fast`."""
    parser.addoption('--fast', action='store_true', help='run the files marked as fast alone')


def pytest_ignore_collect(collection_path, config):
    """Leave out files that are not marked as fast, where asked."""
    if config.getoption('--fast') and collection_path.name.startswith('test_'):
        return True if 'mark.fast' not in collection_path.read_text(encoding='utf-8') else None
    return None


def pytest_collection_modifyitems(items):
    """
    Begin the longest files first, those with real nodes and others in turn.

    No process is left waiting for the other at the end, and nodes seldom run beside nodes.
    """
    begin = {}
    for files in (WITH_NODES, WITHOUT_NODES):
        begin.update(zip(files, accumulate(files.values(), initial=0), strict=False))
    for item in items:
        name = item.path.stem
        if name not in ONCE and name.removeprefix('test_').startswith(REPEATED):
            item.add_marker(pytest.mark.flaky(reruns=2))
    items.sort(key=lambda item: begin.get(item.path.stem.removeprefix('test_'), np.inf))


@pytest.fixture(scope='session')
def robot():
    """Return the default robot, encoders included."""
    return load_robot(CONFIG / 'robot.yaml')


@pytest.fixture(scope='session')
def ideal_robot(robot):
    """Return the default robot measured without error."""
    return replace(robot, encoder=EncoderParams())


@pytest.fixture(scope='session')
def gains(robot):
    """Return the default gains."""
    return load_controller(CONFIG / 'controller.yaml', robot)


@pytest.fixture(scope='session')
def arm(robot, gains):
    """Return the default robot and its gains."""
    return robot, gains


@pytest.fixture
def lab(tmp_path):
    """Yield a Lab of node processes in an empty folder."""
    with pytest.importorskip('node_harness').Lab(tmp_path) as running:
        yield running


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    """Yield a Browser; skip where there is no Chromium that runs."""
    if chromium() is None:
        pytest.skip('no chromium on this machine')
    chrome = Browser(tmp_path_factory.mktemp('chromium') / 'profile')
    try:
        chrome.__enter__()
    except BrowserError as error:
        pytest.skip(f'chromium does not run here: {error}')
    yield chrome
    chrome.__exit__()
