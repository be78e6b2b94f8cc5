# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The interface for Python: its names, types, results, and the examples of the documents."""

from contextlib import chdir, redirect_stdout
import io
import json
from pathlib import Path
import re
import runpy
import subprocess
import sys

import gms_flex_control as gms
from gms_flex_control.errors import ConfigError
from gms_flex_control.schema.files import load_robot
from gms_flex_control.tuning import study
from identified_axis import pendulum
from matplotlib.figure import Figure
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'python.md').read_text(encoding='utf-8')
TYPED = """
import gms_flex_control as gms
robot = gms.load_robot('robot.yaml')
gains = gms.load_controller('controller.yaml', robot)
recording = gms.simulate(gms.read_plan(['plan.yaml']))
for shown in (gms.identify([recording], robot), gms.find_discrepancy([recording], robot),
              gms.tune(robot, gains), gms.compare(robot, gains),
              gms.analyse({('sinusoid', 'none'): recording})):
    text: str = shown.summary()
    reveal_type(shown.plot())
reveal_type(gms.identify([recording], robot).robot)
reveal_type(gms.tune(robot, gains).gains)
gms.identify(recording.time, 1)
"""


def followed(run, folder):
    """Return the names that an example leaves and what it prints, run in an empty folder."""
    (folder / 'config').symlink_to(ROOT / 'config')
    with chdir(folder), redirect_stdout(io.StringIO()) as printed:
        return run(), printed.getvalue()


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    """Return names, print and folder of the example of docs/python.md."""
    folder = tmp_path_factory.mktemp('page')
    example, = re.findall(r'```python\n(.*?)```', PAGE, re.DOTALL)

    def run():
        names = {}
        exec(compile(example, 'docs/python.md', 'exec'), names)
        return names
    return *followed(run, folder), folder


@pytest.fixture(scope='module')
def tutorial(tmp_path_factory):
    """Return names, print and folder of the tutorial."""
    folder = tmp_path_factory.mktemp('tutorial')
    path = ROOT / 'docs' / 'tutorials' / 'from_python.py'
    return *followed(lambda: runpy.run_path(str(path)), folder), folder


def test_the_example_of_the_documents_finds_the_stiffness_and_the_friction(page):
    """The robot of the file is the truth."""
    _, printed, folder = page
    verdict, friction = printed.splitlines()
    assert verdict.startswith('effects_found [') and 'stiffness_error' in verdict
    found, true = (load_robot([path]).friction.forward for path in (
        folder / 'identified.yaml', ROOT / 'config' / 'robot.yaml'))
    np.testing.assert_allclose(np.array(friction.strip('[]').split(), dtype=float), found.coulomb,
                               rtol=1e-6)
    speed = np.array([0.8, 1.6])  # a sinusoid determines friction at speed, no Coulomb level
    of_found, of_true = (  # Eq. (4), written anew
        one.coulomb + (one.static - one.coulomb) * np.exp(-(speed / one.velocity) ** 2)
        + speed * one.viscous for one in (found, true))
    np.testing.assert_allclose(of_found, of_true, rtol=0.15)


def test_the_tutorial_names_the_play_of_the_example(tutorial):
    names, printed, folder = tutorial
    assert printed.startswith('The model lacks backlash of joint2')
    row, = names['missing'].to_dataframe().to_dict('records')
    assert (row['effect'], row['joint']) == ('backlash', 'joint2')
    assert row['low'] < 0.012 < row['high']
    effect, = load_robot(folder / 'with_play.yaml').effects
    assert effect.values == pytest.approx((row['value'],))
    assert (folder / 'gap.png').stat().st_size > 10_000


@pytest.fixture(scope='module')
def results(page, tutorial):
    """Return a result of each kind by the function that made it."""
    names, _, _ = page
    robot, recording = names['robot'], names['recording']
    gains = gms.load_controller(ROOT / 'config' / 'controller.yaml', robot)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, 'CONTESTANTS', {'none': 'none', 'gms': 'GMS'})
        compared = gms.compare(robot, gains, amplitude=0.5)
    return {'identify': names['found'], 'find_discrepancy': tutorial[0]['missing'],
            'tune': gms.tune(robot, gains), 'compare': compared,
            'analyse': gms.analyse({('sinusoid', 'gms'): recording})}


KINDS = ('identify', 'find_discrepancy', 'tune', 'compare', 'analyse')


@pytest.mark.parametrize('kind', KINDS)
def test_a_result_shows_itself_as_text_values_table_picture_and_page(results, kind):
    result = results[kind]
    summary, table = result.summary(), result.to_dataframe()
    assert summary.strip() and not table.empty
    json.dumps(result.to_dict(), allow_nan=False)
    assert isinstance(result.plot(), Figure)
    shown = result._repr_html_()
    assert '<svg' in shown and summary.split()[0] in shown


def test_the_tables_hold_the_numbers(results):
    found = results['identify'].to_dataframe().set_index('parameter')
    coulomb = found.loc['friction.joint1.forward.coulomb']
    assert coulomb['value'] == results['identify'].robot.friction.forward.coulomb[0]
    assert coulomb['unit'] == 'N m'
    known = found[np.isfinite(found['low']) & (found['flags'] == '')]
    assert len(known) and (known['low'] < known['value']).all()
    assert (known['value'] < known['high']).all()
    gains = results['tune'].to_dataframe().set_index('joint')
    np.testing.assert_array_equal(gains['kd_link'], results['tune'].gains.kd_link)
    compared = results['compare'].to_dataframe().set_index('compensation')['nominal [rad]']
    assert compared['gms'] < compared['none']


def test_without_pandas_the_way_out_is_named(results, monkeypatch):
    monkeypatch.setitem(sys.modules, 'pandas', None)
    with pytest.raises(ConfigError, match=r"pip install '\.\[pandas\]'"):
        results['tune'].to_dataframe()


def test_the_page_has_every_name():
    for name in gms.__all__:
        assert re.search(rf'^\| .*`{name}\b', PAGE, re.MULTILINE), name
        assert getattr(gms, name).__name__ == name
    assert set(gms.__all__) <= set(dir(gms))
    assert not hasattr(gms, 'nonsense')


def test_a_type_checker_knows_the_interface(tmp_path):
    """A user's script, in which the last line is wrong."""
    pytest.importorskip('mypy')
    script = tmp_path / 'script.py'
    script.write_text(TYPED)
    ran = subprocess.run(
        [sys.executable, '-m', 'mypy', '--follow-imports=silent', '--ignore-missing-imports',
         '--disallow-untyped-defs', '--no-error-summary', '--cache-dir',
         str(ROOT / '.pytest_cache' / 'mypy'), 'gms_flex_control/__init__.py',
         'gms_flex_control/results.py', str(script)], cwd=ROOT, capture_output=True, text=True,
        timeout=200, check=False)
    assert re.findall('Revealed type is "(.*?)"', ran.stdout) == [
        'matplotlib.figure.Figure', 'gms_flex_control.params.robot.RobotParams',
        'gms_flex_control.params.gains.ControllerParams'], ran.stdout
    errors = [line for line in ran.stdout.splitlines() if ': error: ' in line]
    assert len(errors) == 2 and all('"identify"' in line for line in errors), ran.stdout
    assert (ROOT / 'gms_flex_control' / 'py.typed').exists()


def test_importing_the_package_imports_nothing_else():
    """The names are imported when they are used: command line and nodes start quickly."""
    script = ('import sys, gms_flex_control; '
              'print([name for name in ("numpy", "numba", "scipy") if name in sys.modules])')
    ran = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                         check=True, timeout=60)
    assert ran.stdout == '[]\n'


def test_a_recording_alone_is_identified_and_what_stands_still_is_left_out():
    """A pendulum in closed form beside a joint that stands still, and no robot file."""
    swing = pendulum(seconds=15.0)
    recording = gms.Recording(joints=('swing', 'held'), time=swing.time, source='two axes', **{
        name: np.hstack([getattr(swing, name), np.zeros((len(swing.time), 1))])
        for name in ('q_link', 'tau_motor')})
    found = gms.identify([recording])
    assert found.warnings == ('two axes: no motion of held: left out',)
    arm, friction = found.robot.arm, found.robot.friction
    assert found.robot.joints == ('swing',) and not found.described
    assert arm.inertia + arm.mass * arm.com ** 2 == pytest.approx(0.02, rel=0.03)
    assert friction.forward.coulomb == pytest.approx(0.06, rel=0.1)
    assert friction.backward.coulomb == pytest.approx(0.06, rel=0.1)
