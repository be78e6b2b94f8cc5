#!/usr/bin/env python3
# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Make the pictures of `gms_flex view` in docs/images, with an installed Chromium.

    PYTHONPATH=test:. .venv/bin/python scripts/screenshots.py     # or: make screenshots
"""

from pathlib import Path
import sys
import tempfile
import time

from devtools import Browser, chromium
from gms_flex_control.cli.main import main as gms_flex
from gms_flex_control.file_io import robot_file
from gms_flex_control.schema.files import load_robot
from gms_flex_control.view.recorded import open_bag
from gms_flex_control.view.server import ViewServer
from node_harness import CONFIG, FILES, Lab

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / 'docs' / 'images'
MOMENT = 2.25        # of the bag: blocks of both kinds, a spring wound up [s]
SCALE = 1.25         # pixels of a picture for one of the page
LIVE = 12.0          # seconds of the loop before its picture
GAIN = '[data-name="gains.joint1.kd_link"]'


def main():
    """Make all pictures; return 0, or 2 without Chromium."""
    if chromium() is None:
        print('screenshots.py: no chromium found: apt-get install chromium', file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        folder = Path(folder)
        with Browser(folder / 'profile') as browser:
            picture_bag(browser, folder)
            picture_space(browser, folder)
            picture_live(browser, folder)
    return 0


def picture_bag(browser, folder):
    """Show the default arm with what a controller with a wrong model leaves of its error."""
    bag = folder / 'sinusoid_gms'
    gms_flex(['simulate', '--duration', '14', '--out', str(bag)])
    with ViewServer(open_bag(bag, default=load_robot(robot_file()))) as server:
        for name, width, height, dark in (('view_bag', 1280, 990, False),
                                          ('view_narrow', 400, 860, True)):
            browser.screen(width, height, dark=dark, scale=SCALE)
            browser.visit(f'{server.url}#t={MOMENT}')
            browser.until(f'document.documentElement.dataset.time == {MOMENT}')
            browser.until('!!document.querySelector(".trail").getAttribute("d")')
            browser.until('document.querySelector("#plot-blocks canvas").ariaLabel.includes("%")')
            save(browser, name)


def picture_space(browser, folder):
    """Show an arm in space while it moves."""
    arm, bag = ROOT / 'examples' / 'industrial_arm', folder / 'industrial_arm'
    files = [word for name in ('robot', 'controller', 'trajectory')
             for word in (f'--{name}', str(arm / f'{name}.yaml'))]
    gms_flex(['simulate', *files, '--duration', '6', '--out', str(bag)])
    with ViewServer(open_bag(bag, load_robot(arm / 'robot.yaml'))) as server:
        browser.screen(1280, 860, scale=SCALE)
        browser.visit(f'{server.url}#t=2')
        browser.until('document.documentElement.dataset.time == 2')
        browser.until('!!document.querySelector(".trail").getAttribute("d")')
        save(browser, 'view_space')


def picture_live(browser, folder):
    """Show the running loop after a gain was refused; in lockstep, however busy the machine."""
    with Lab(folder) as lab:
        view = lab.run([sys.executable, '-m', 'gms_flex_control.cli.main', 'view', 'live',
                        '--port', '0'], 'view')
        files = [*FILES, CONFIG / 'sinusoid.yaml']
        lab.start('controller_node', files=files, mode='lockstep')
        lab.start('trajectory_node', files=files, mode='lockstep', trajectory__autostart=True)
        lab.start('plant_node', files=files, mode='lockstep', rate=500.0)
        lab.until(lambda: 'http://' in view.printed())
        browser.screen(1280, 960, scale=SCALE)
        browser.visit(view.printed().split()[0])
        browser.until(f'Number(document.documentElement.dataset.time) > {LIVE} && '
                      f'!!document.querySelector({GAIN!r})')
        browser.ask(f'document.querySelector({GAIN!r} + " input[type=number]").select()')
        browser.type_text('-1')
        browser.press('Enter')
        browser.until(f'document.querySelector({GAIN!r}).classList.contains("refused")')
        browser.ask('document.activeElement.blur()')
        save(browser, 'view_live')


def save(browser, name):
    """Write what is to be seen once it has been drawn."""
    browser.ask('new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))')
    time.sleep(0.5)
    path = IMAGES / f'{name}.png'
    path.write_bytes(browser.picture())
    print(f'{path.relative_to(ROOT)}  {path.stat().st_size // 1024} kB')


if __name__ == '__main__':
    sys.exit(main())
