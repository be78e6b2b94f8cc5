# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The package's files agree and are found where it is installed; layouts show what is there."""

import ast
from importlib import import_module, util
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import gms_flex_control
from gms_flex_control import file_io
from gms_flex_control.effects.base import Change, Effect, Term
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import robot_file
from gms_flex_control.schema.files import load_robot
import pytest

ROOT = Path(__file__).resolve().parents[1]


def setup_argument(name):
    """Return a literal keyword of the call of ``setup`` in setup.py."""
    tree = ast.parse((ROOT / 'setup.py').read_text(encoding='utf-8'))
    keywords = {k.arg: k.value for node in ast.walk(tree) if isinstance(node, ast.Call)
                for k in node.keywords}
    return ast.literal_eval(keywords[name])


SCRIPTS = dict(line.split(' = ') for line in setup_argument('entry_points')['console_scripts'])


def test_every_file_names_the_same_version():
    """Check package.xml, setup.py, the package itself and the changelog's newest release."""
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()
    changelog = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    released = re.search(r'^(\d+\.\d+\.\d+)\b', changelog, re.MULTILINE)
    versions = {manifest.findtext('version'), setup_argument('version'),
                gms_flex_control.__version__, released and released.group(1)}
    assert versions == {gms_flex_control.__version__}


@pytest.mark.parametrize('script', SCRIPTS)
def test_every_executable_can_be_imported(script):
    module, function = SCRIPTS[script].split(':')
    if '.nodes.' in module and util.find_spec('rclpy') is None:
        pytest.skip('the nodes need ROS 2: install the extra [ros]')
    assert callable(getattr(import_module(module), function))


def public(node, trail=''):
    """Yield (name, definition) of what a module offers; functions in functions are its own."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.FunctionDef, ast.ClassDef)) and not child.name.startswith('_'):
            yield trail + child.name, child
            if isinstance(child, ast.ClassDef):
                yield from public(child, f'{trail}{child.name}.')


def test_everything_public_says_what_it_is_and_returns():
    """The linter checks form only; what an effect overrides is documented in its base."""
    inherited, unsaid = {*vars(Effect), *vars(Term), *vars(Change)}, []
    for path in sorted((ROOT / 'gms_flex_control').rglob('*.py')):
        for name, node in public(ast.parse(path.read_text(encoding='utf-8'))):
            silent = not ast.get_docstring(node) and not (
                'effects' in path.parts and name.rpartition('.')[2] in inherited)
            if silent or isinstance(node, ast.FunctionDef) and node.returns is None:
                unsaid.append(f'{path.relative_to(ROOT)}: {name}')
    assert unsaid == []


def test_the_package_is_installed_whole_and_nothing_else():
    """Neither bench/ nor scripts/ nor test/ is in a wheel or among what colcon installs."""
    there = {'.'.join(path.parent.relative_to(ROOT).parts)
             for path in (ROOT / 'gms_flex_control').rglob('__init__.py')}
    done = subprocess.run(
        [sys.executable, '-c', 'import json; from setuptools.dist import Distribution; '
         'from distutils.core import run_setup; built = run_setup("setup.py", stop_after="init"); '
         'print(json.dumps([built.packages, built.py_modules, built.data_files]))'],
        cwd=ROOT, capture_output=True, text=True, check=True)
    packages, modules, files = json.loads(done.stdout)
    assert set(packages) == there and not modules
    assert not any(Path(name).parts[0] in ('bench', 'scripts', 'test')
                   for _, names in files for name in names)


def test_every_requirement_is_locked():
    """Check that constraints.txt names each direct dependency, so that no version drifts."""
    extras = setup_argument('extras_require')
    wanted = {re.match(r'[\w.-]+', r).group().lower().replace('.', '-')
              for r in sum(extras.values(), setup_argument('install_requires'))}
    locked = {line.partition('==')[0].strip() for line in
              (ROOT / 'constraints.txt').read_text(encoding='utf-8').splitlines() if '==' in line}
    wanted.discard('gms_flex_control')  # an extra that takes another in
    assert wanted <= locked, f'run make lock: {sorted(wanted - locked)} missing'


def test_without_the_packages_of_pypi_only_bags_are_missing():
    """The nodes of the loop run; what needs a bag says what to install."""
    pytest.importorskip('rclpy')
    program = ('import sys; sys.modules |= dict.fromkeys(("mcap", "rosbags", "threadpoolctl"))\n'
               'from gms_flex_control.cli.main import main\n'
               'from gms_flex_control.nodes import controller_node, plant_node, trajectory_node\n'
               'sys.exit(main(["info", "bag"]))')
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith('gms_flex info: bags need mcap and rosbags for Python: pip ins')


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Pretend that the package lives in the site-packages of a prefix without its share."""
    package = tmp_path / 'lib' / 'python3.12' / 'site-packages' / 'gms_flex_control'
    package.mkdir(parents=True)
    monkeypatch.setattr(file_io, '__file__', str(package / 'file_io.py'))
    monkeypatch.setattr(file_io.sys, 'prefix', str(tmp_path / 'elsewhere'))
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    return tmp_path


def add_share(prefix):
    """Put package.xml and config/ where setup.py's data_files go."""
    share = prefix / 'share' / 'gms_flex_control'
    (share / 'config').mkdir(parents=True)
    shutil.copy(ROOT / 'package.xml', share)
    return share


def test_parameter_files_are_found_in_the_prefix_or_through_the_ament_index(
        installed, monkeypatch):
    there = [add_share(installed / 'overlay'), add_share(installed)]
    assert file_io.share_path() == there[1]
    shutil.rmtree(there[1])
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{installed / "underlay"}:{installed / "overlay"}')
    assert file_io.share_path() == there[0]


def test_a_package_without_its_files_says_where_it_looked(installed):
    with pytest.raises(ConfigError, match=f'none of .*{installed}.* install the package'):
        file_io.share_path()


def test_every_picture_is_shown_and_made_by_a_script():
    scripts = ''.join(path.read_text('utf-8') for path in (
        *(ROOT / 'scripts').glob('*.py'), *(ROOT / 'bench').rglob('*.py')))
    pages = ''.join(path.read_text('utf-8') for path in (
        ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md'))))
    pictures = {path.name for path in (ROOT / 'docs' / 'images').iterdir()}
    assert pictures == set(re.findall(r'\]\((?:docs/|\.\./)?images/([^)]+)\)', pages))
    for name in pictures:  # screenshots.py names what it makes without the ending
        assert f"'{name}'" in scripts or f"'{Path(name).stem}'" in scripts, name


@pytest.mark.parametrize('script', re.findall(
    r'PYTHONPATH=(\S+) \$\(BIN\)/python (\S+)', (ROOT / 'Makefile').read_text()))
def test_a_script_of_the_makefile_finds_what_it_imports(script):
    path, file = script
    start = 'import runpy, sys; runpy.run_path(sys.argv[1])'
    done = subprocess.run([sys.executable, '-P', '-c', start, file], cwd=ROOT, check=False,
                          env=os.environ | {'PYTHONPATH': path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(shutil.which('make') is None, reason='make is not installed')
def test_what_the_caller_has_set_does_not_reach_what_make_starts():
    leaks = ['PYTHONPATH', 'AMENT_PREFIX_PATH', 'VIRTUAL_ENV', 'PYTHONDONTWRITEBYTECODE']
    done = subprocess.run(['make', '--no-print-directory', '--eval=leaks: ; @env', 'leaks'],
                          cwd=ROOT, env=os.environ | dict.fromkeys([*leaks, 'KEPT'], 'of_caller'),
                          check=True, capture_output=True, text=True)
    assert [line for line in done.stdout.splitlines() if 'of_caller' in line] == ['KEPT=of_caller']


ROBOT = load_robot(robot_file())
N, BLOCKS = ROBOT.friction.stiffness.shape
ARRAYS = {'/reference': 5 * N, '/effort_controller/commands': N,  # topic: numbers in it
          '/cascade_controller/blocks': N * BLOCKS}
STATES = {'/joint_states': [*ROBOT.joints, *ROBOT.motors],
          '/cascade_controller/state': list(ROBOT.joints)}
FIELDS = ('position', 'velocity', 'effort')


def foxglove():
    return json.loads((ROOT / 'layouts' / 'foxglove.json').read_text())


def plotjuggler():
    return ElementTree.parse(ROOT / 'layouts' / 'plotjuggler.xml').getroot()


def test_plotjuggler_draws_series_that_exist():
    """A joint state is /topic/joint/field to it, an array /topic/data[i]."""
    root = plotjuggler()
    known = {f'{topic}/data[{i}]' for topic, size in ARRAYS.items() for i in range(size)}
    known |= {f'{topic}/{joint}/{field}' for topic, joints in STATES.items()
              for joint in joints for field in FIELDS}
    drawn = [curve.get('name') for curve in root.iter('curve')]
    assert drawn
    assert set(drawn) <= known
    for splitter in root.iter('DockSplitter'):
        sizes = splitter.get('sizes').split(';')
        assert int(splitter.get('count')) == len(sizes) == len(splitter)


def test_plotjuggler_subscribes_to_what_it_draws():
    """What its plugin does not find in the layout it takes as false or 0."""
    root = plotjuggler()
    plugin, = root.iterfind('Plugins/plugin')
    assert root.find('previouslyLoaded_Streamer').get('name') == plugin.get('ID')
    settings = {setting.tag: setting.get('value') for setting in plugin}
    topics = settings.pop('selected_topics').split(';')
    drawn = {curve.get('name') for curve in root.iter('curve')}
    assert sorted(topics) == sorted(topic for topic in (*ARRAYS, *STATES)
                                    if any(name.startswith(f'{topic}/') for name in drawn))
    assert int(settings.pop('max_array_size')) >= max(ARRAYS.values())
    assert settings == {'use_header_stamp': 'false', 'discard_large_arrays': 'true',
                        'boolean_strings_to_number': 'true', 'remove_suffix_from_strings': 'true'}


def test_foxglove_draws_fields_that_exist():
    for name, panel in foxglove()['configById'].items():
        for path in panel.get('paths', ()):
            topic, field, index = re.fullmatch(r'(/[\w/]+)\.(\w+)\[(\d+)\]',
                                               path['value']).groups()
            size = ARRAYS[topic] if field == 'data' else len(STATES[topic])
            assert field in ('data', *FIELDS), name
            assert int(index) < size, name
