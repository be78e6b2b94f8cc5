# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Files somebody else wrote: too large, folded up, pointing elsewhere, with markup for names."""

from contextlib import suppress
from pathlib import Path
import re
import shutil

from gms_flex_control.cli.main import main
from gms_flex_control.data.bag import Bag
from gms_flex_control.data.csv_map import load_map
from gms_flex_control.data.metadata import load
from gms_flex_control.errors import BagError, ConfigError, ImportDataError
from gms_flex_control.schema.files import load_robot
from html_page import Page
import pytest

REAL = Path(__file__).parent / 'data' / 'ros2_bag_record' / 'rosbag2_mcap'
EVIL = '<script>alert(1)</script>'
# each level stands for ten of the one before: 10^9 entries in 500 bytes
BOMB = '\n'.join(['l0: &l0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]', *(
    f'l{k}: &l{k} [{", ".join([f"*l{k - 1}"] * 10)}]' for k in range(1, 9))])
READERS = {'parameters': (load_robot, ConfigError), 'map': (load_map, ImportDataError),
           'metadata': (load, BagError)}
HOSTILE = {
    'aliases': (BOMB, 'aliases'), 'nesting': ('[' * 500, 'nested too deeply'),
    'size': ('#' * 10_000_001, 'larger than')}


@pytest.mark.parametrize('what', HOSTILE)
@pytest.mark.parametrize('reader', READERS)
def test_hostile_yaml_is_refused_in_a_sentence(reader, what, tmp_path):
    (read, error), (text, sentence) = READERS[reader], HOSTILE[what]
    file = tmp_path / 'metadata.yaml'
    file.write_text(text)
    with pytest.raises(error, match=f'{re.escape(str(file))}.*{sentence}'):
        read(file)


@pytest.mark.parametrize('reader', READERS)
def test_yaml_makes_no_objects(reader, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'file.yaml').write_text('a: !!python/object/apply:os.system ["touch owned"]')
    read, error = READERS[reader]
    with suppress(error):  # a tag it does not know may be an error or a plain value
        read(tmp_path / 'file.yaml')
    assert not (tmp_path / 'owned').exists()


@pytest.mark.parametrize('name', ['../outside.mcap', '/{}/outside.mcap', '../bag/../outside.mcap'])
def test_paths_in_metadata_never_lead_out_of_the_bag(name, tmp_path):
    """The file outside is a sound bag, so that reading it would succeed."""
    shutil.copytree(REAL, tmp_path / 'bag')
    inside = next((tmp_path / 'bag').glob('*.mcap'))
    outside = tmp_path / 'outside.mcap'
    shutil.move(inside, outside)
    metadata = tmp_path / 'bag' / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(inside.name, name.format(tmp_path)))
    bag = Bag(tmp_path / 'bag')
    assert sum(map(len, bag.batches())) == 0
    assert any('is missing' in str(damage) for damage in bag.damage)
    assert outside.read_bytes() == (REAL / inside.name).read_bytes()


def test_names_from_a_bag_are_only_text_in_the_report(tmp_path, capsys):
    """Joint names and the folder's name hold markup; analysed as a user does it."""
    files = []
    for name in ('robot', 'controller', 'sinusoid'):
        source = Path(__file__).parents[1] / 'config' / f'{name}.yaml'
        files += [f'--{name.replace("sinusoid", "trajectory")}', str(tmp_path / f'{name}.yaml')]
        Path(files[-1]).write_text(re.sub(
            r'\bjoint1(_motor)?\b', lambda found: f"'{EVIL}{found[1] or ''}'", source.read_text()))
    bags = [tmp_path / f'{EVIL.replace("/", "")}_{mode}' for mode in ('none', 'gms')]
    for bag, mode in zip(bags, ('none', 'gms'), strict=True):
        assert main(['simulate', *files, '--out', str(bag), '--compensation', mode,
                     '--duration', '2']) == 0, capsys.readouterr()
    assert main(['analyse', *map(str, bags), '--out', str(tmp_path / 'out')]) in (0, 1)
    html = (tmp_path / 'out' / 'report.html').read_text()
    page = Page(html)
    assert page.tags.count('script') == 3 and not page.handlers  # data, uPlot, report.js
    assert EVIL not in html and 'alert(1)' in html
