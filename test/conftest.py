# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Fixtures shared by the tests of the physics core, and which cores a test may use."""

from dataclasses import replace
import os
from pathlib import Path
import signal

from devtools import Browser, BrowserError, chromium
from gms_flex_control.params.encoder import EncoderParams
from gms_flex_control.schema.files import load_controller, load_robot
import pytest

CONFIG = Path(__file__).parents[1] / 'config'

# a shell that starts the tests in its background has them ignore Ctrl-C, which is tested
signal.signal(signal.SIGINT, signal.default_int_handler)

CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else []


NODES = ('nodes', 'demo', 'colcon', 'sros2')  # in the names of files; and all that are flaky


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """
    Let real nodes have all cores, other tests that run beside them one of their own.

    A computation with a thread per core would starve the nodes of a test in the other process.
    """
    worker = os.environ.get('PYTEST_XDIST_WORKER', '')
    if not worker or len(CORES) < 2:
        return
    own = CORES[int(worker.removeprefix('gw')) % len(CORES)]
    nodes = item.get_closest_marker('flaky') or any(word in item.path.stem for word in NODES)
    os.sched_setaffinity(0, CORES if nodes else [own])


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
