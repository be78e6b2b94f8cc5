# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What `gms_flex view live` costs the loop beside it: late samples with the page closed and open.

Closed is without viewer and browser; open is both on this machine, the browser without a graphics
card. The two take turns, so that a busy moment hits both.
"""

from functools import partial
from importlib.util import find_spec
import shutil
from statistics import median
import sys

from bench.speed.ros_loop import run_loop
from bench.speed.timing import Measurement

_RATE = 1000.0  # [Hz]
_BROWSERS = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
_FLAGS = ('--headless', '--no-sandbox', '--disable-gpu', '--no-first-run', '--disable-sync',
          '--disable-background-networking', '--disable-component-update',
          '--window-size=1280,860')
_START_BOUND = 60.0  # [s]
# what the page may add to the late samples, on an idle machine of 2 cores [%]
_MOST_ADDED = 1.0


def browser():
    """Return the path of an installed Chromium, or of Google's, None if there is none."""
    return next(filter(None, map(shutil.which, _BROWSERS)), None)


def open_page(run):
    """Start viewer and browser of a Run; return their names."""
    run.start('view', [sys.executable, '-m', 'gms_flex_control.cli.main', 'view', 'live',
                       '--port', '0'])
    run.processes.wait_for_text('view', ['http://'], _START_BOUND)
    address = run.processes.printed('view').split()[0]
    run.start('browser', [browser(), *_FLAGS, f'--user-data-dir={run.folder / "profile"}',
                          '--remote-debugging-port=0', address])
    run.processes.wait_for_text('browser', ['DevTools listening'], _START_BOUND)
    return ['view', 'browser']


def measure(robot, gains, quick=False):
    """
    Run the loop at 1 kHz without and with the page, in three processes and in one.

    Where ROS and Chromium are installed; the nodes read the package's own files. ``quick``: one
    run of 6 s each instead of three of 15 s.
    """
    if find_spec('rclpy') is None or browser() is None:
        return []
    duration, turns, found = (6.0, 1, []) if quick else (15.0, 3, [])
    for loop, composed in (('three processes', False), ('one process', True)):
        runs = {'closed': [], 'open': []}
        for _ in range(turns):
            for page, beside in (('closed', None), ('open', open_page)):
                runs[page].append(run_loop(_RATE, duration, composed=composed, beside=beside))
        found += _measurements(loop, runs)
    return found


def _measurements(loop, runs):
    late, found, name = {}, [], f'{_RATE:g} Hz, {loop}'
    figure = partial(Measurement, suite='view', unit='%')
    for page, results in runs.items():
        shares = [100.0 * (1.0 - timing['answered_in_time']) for timing, _ in results]
        late[page] = median(shares)
        processor = {process: median(taken[process] for _, taken in results)
                     for process in results[0][1]}
        found += [
            figure(name=f'{name}, page {page}: late', value=late[page],
                   note=', '.join(f'{share:.2f}' for share in shares)),
            Measurement(suite='view', name=f'{name}, page {page}: interval error p99', unit='us',
                        value=median(timing['interval_error_p99_us'] for timing, _ in results)),
            figure(name=f'{name}, page {page}: processor', value=sum(processor.values()),
                   note=', '.join(f'{one} {share:.0f}' for one, share in processor.items()))]
    return [*found, figure(name=f'{name}: late, added by the page', target=_MOST_ADDED,
                           value=late['open'] - late['closed'], at_least=False)]
