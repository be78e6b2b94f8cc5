#!/usr/bin/env python3
# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Make the pictures of README and docs that `gms_flex` draws, by the commands that stand beside them.

    PYTHONPATH=test:. .venv/bin/python scripts/pictures.py [NAME ...]     # or: make pictures

The rest of docs/images is made by scripts/screenshots.py and scripts/draw_architecture.py.
"""

import argparse
import base64
from pathlib import Path
import shlex
import shutil
import subprocess
import sys
import tempfile
from typing import NamedTuple

from gms_flex_control.cli.main import main as gms_flex

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / 'docs' / 'images'
DATA = ROOT.parent / 'shared' / 'data'  # recordings of others, which are not committed
SERVO = [f'{motion}_kp{gain}' for gain in (400, 100) for motion in (
    'sin_sin', 'lift_and_drop', 'up_and_down', 'sin_time_square')]
WIDTH = 1285  # of the report's picture [px]
# from the heading to the end of the first two charts over time
PART = """(() => {
  const from = [...document.querySelectorAll('h2')].find(
    (one) => one.textContent === 'Robots drawn at random').getBoundingClientRect().top - 12;
  const chart = document.querySelectorAll('details .chart')[1].getBoundingClientRect();
  return [from + scrollY, chart.bottom + 10 - from];
})()"""


class Work(NamedTuple):
    """Commands, run in an empty folder, and the file there that becomes each picture."""

    commands: tuple
    made: dict    # picture: pattern of one file
    needs: Path = ROOT


WORKS = {
    'demo': Work(
        ('demo --motions polynomial --out demo',),
        {'errors_polynomial.png': 'demo/errors_polynomial.png'}),
    'tune': Work(('tune --out tuned',), {'tuning_loop.png': 'tuned/tuning.png'}),
    'compare': Work(('compare --out comparison',),
                    {'compare_report.png': 'comparison/report.html'}),
    'discrepancy': Work(
        ('bench hide --out example --kind double --seeds 6 --duration 40',
         'discrepancy example/double_6/bag --robot example/double_6/robot.yaml '
         '--holdout example/double_6/held_out --out example/result'),
        {'discrepancy_gap.png': 'example/result/gap.png',
         'discrepancy_offset.png': 'example/result/evidence_*_spring_offset*.png',
         'discrepancy_evidence.png': 'example/result/evidence_*_motor_inertia_coupling*.png',
         'discrepancy_map.png': 'example/result/map_*_1.png'}),
    'demo-discrepancy': Work(
        ('bench demo-discrepancy --duration 20 --out demo',),
        {'discrepancy_demo.png': 'demo/tracking.png'})}


def main():
    """Make the pictures asked for; return 0, or 2 where one cannot be made."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('names', nargs='*', metavar='NAME', default=list(WORKS),
                        help=f'of {", ".join(WORKS)} (default: all)')
    parser.add_argument('--into', type=Path, default=IMAGES, metavar='FOLDER',
                        help='default: docs/images')
    args = parser.parse_args()
    unknown = sorted(set(args.names) - set(WORKS))
    if unknown:
        parser.error(f'{unknown[0]}: there is no such work; known: {", ".join(WORKS)}')
    args.into.mkdir(parents=True, exist_ok=True)
    return max(make(WORKS[name], args.into) for name in args.names)


def make(work, into):
    """Run the commands of a Work and put its pictures into a folder; return 0, or 2."""
    if not work.needs.is_dir():
        print(f'pictures.py: left out: {work.needs} is absent', file=sys.stderr)
        return 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for command in work.commands:
            words = shlex.split(command)
            print(f'$ {command}', flush=True)
            run([f'{folder}/{word}' if is_path(word, words[k - 1]) else word
                 for k, word in enumerate(words)])
        for picture, pattern in work.made.items():
            found = sorted(Path(folder).glob(pattern))
            if len(found) != 1:
                print(f'pictures.py: {picture}: expected one {pattern}, there are {len(found)}; '
                      'did the answer change?', file=sys.stderr)
                return 2
            if not taken(found[0], into / picture):
                return 2
            print(into / picture)
    return 0


def run(words):
    """Run a verb of gms_flex; after the word bench, one of ``python -m bench``."""
    if words[0] == 'bench':
        subprocess.run([sys.executable, '-m', *words], cwd=ROOT, check=True)
    else:
        gms_flex(words)


def is_path(word, before):
    """Return whether a word of a command is a file of the folder it is run in."""
    return before == '--out' or '/' in word and not Path(word).is_absolute()


def taken(source, picture):
    """Copy a picture, or take one of a report; return False without a browser for that."""
    if source.suffix != '.html':
        shutil.copyfile(source, picture)
        return True
    from devtools import Browser, chromium
    if chromium() is None:
        print('pictures.py: no chromium found: apt-get install chromium', file=sys.stderr)
        return False
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, \
            Browser(Path(folder) / 'profile') as browser:
        browser.screen(WIDTH, 900)
        browser.visit(source.resolve().as_uri())
        browser.ask('document.querySelector("details").open = true')
        browser.until('document.querySelectorAll("details .chart .u-legend").length > 2')
        top, height = browser.ask(PART)
        clip = {'x': 0, 'y': top, 'width': WIDTH, 'height': height, 'scale': 1}
        shot = browser.call('Page.captureScreenshot', format='png', clip=clip,
                            captureBeyondViewport=True)
        picture.write_bytes(base64.b64decode(shot['data']))
    return True


if __name__ == '__main__':
    sys.exit(main())
