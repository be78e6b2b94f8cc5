# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Bad input of every verb of both tools: one sentence, exit code 2, and nothing is written."""

from pathlib import Path
import sys

from bench import __main__ as bench
from gms_flex_control.cli import main as tool
import pytest

pytestmark = pytest.mark.fast

ROOT = Path(__file__).resolve().parents[1]
OF_BENCH = tuple(verb for group in bench.GROUPS.values() for verb in group)
BAGS = {'info': '', 'paper-method': '', 'analyse': '--out {dir}',
        **dict.fromkeys(('identify', 'discrepancy'), '--robot {robot} --out {dir}')}
# what is wrong with the input of a verb that takes no bag
WRONG = {
    'demo': '--out {file}', 'demo-identify': '--plan {missing} --out {dir}',
    'demo-discrepancy': '--effect nothing --out {dir}', 'demo-next': '--out {file}',
    'simulate': '--robot {missing} --out {dir}', 'record': '--all --duration -1 --out {dir}',
    'import-csv': '{missing} --map import_kr300.yaml --out {dir}',
    'check-gains': '--robot {missing}', 'speed': '--robot {missing}',
    'recover': '--seeds 0', 'hide': '--seeds x --out {dir}',
    'score': '--kind single --seeds x --out {dir}', 'faults': '--only nonsense',
    'coverage': '--seeds x --out {dir}', 'real-machines': 'nonsense --out {dir}',
    'learn': '--machines nonsense --out {dir}',
    'next': '{missing} --robot {missing} --limits {missing} --out {dir}',
    'plan': '--robot {missing} --out {dir}',
    'real-arm': '--data {missing}', 'hidden-arms': '--seeds many',
    'base-parameters': '--seeds many', 'growth': '--joints 0',
    'urdf': '--robot {missing}', 'tune': '--robot {missing} --out {dir}', 'compare': '{missing}',
    'view': '{missing}', 'effects': 'backlsh', 'export': '--to mujoco --robot {missing}'}
# further options that cannot be meant, and what is said of them
OPTIONS = [
    ('view live --namespace a.b', "--namespace: '/a.b/plant' is not the full name of a node"),
    ('view live --controller arm', "--controller: 'arm' is not the full name of a node"),
    ('view live bag', 'only bags are drawn over each other'),
    ('view live --robot {robot}', '--robot: the running controller says it; leave it out'),
    ('view live --joints a b', '--joints: the running controller says it'),
    ('record --topics /a-b --out {dir}', "'/a-b': topic name must not contain characters other"),
    ('record --topics / --out {dir}', "'/': topic name must not end with a '/'"),
    ('record --topics 1x --out {dir}', "'1x': topic name must not have a token that starts with"),
    *((f'{verb} {{missing}} --robot {{robot}} --out {{bag}}', '{bag}: is a bag; name another')
      for verb in ('identify', 'discrepancy')),
    *((f'identify {{bag}} --out {{dir}} {words}', sentence) for words, sentence in (
        ('--robot {arm}', "lacks joint 'joint3'"), ('--robot absent.yaml', 'cannot be read'),
        ('--robot {robot} --blocks 4 0', '--blocks 0: give numbers from 1 to 8'),
        ('--robot {robot} --blocks 4 99', '--blocks 99: give numbers from 1 to 8'),
        ('--robot {robot} --joints joint9', '--joints joint9: the robot has joint1, joint2'),
        ('--robot {robot} --joints joint2', 'act on each other'),
        ('--robot {robot} --out {file}', 'is a file; name a folder'))),
    ('analyse {bag} --out {bag}', '--out {bag}: is a bag; name another folder for what comes of'),
    ('tune --out {bag}', '--out {bag}: is a bag'),
    ('urdf --ros2-control=', "--ros2-control '': give one word, such as my_hardware/MySystem"),
    ('urdf --name=', "--name '': give one word, such as arm"),
    ('info /dev/null', '/dev/null: is not a bag file (expected .mcap or .db3'),
    ('info {packed}', '{packed}: cannot be unpacked ('),
    ('urdf --limits {robot}', 'no limits.<joint> is in it'),
    ('urdf --out {file}/arm.urdf', '{file}/arm.urdf: {file} is a file; name a folder'),
    ('urdf --out /proc/foo', '/proc/foo: cannot be written (No such file or directory)'),
    ('analyse {missing} --out /proc/foo', '--out /proc/foo: /proc cannot be written'),
    ('info {empty}', '{empty}: is empty (0 bytes)'),
    ('next {folder} --robot {robot} --limits {bridge} --out x', 'name a folder that gms_flex'),
    ('demo --out {dir} --duration -1', '--duration'),
    *((f'discrepancy {{missing}} --robot {{robot}} --out {{dir}} {words}', sentence)
      for words, sentence in (('--without backlsh', "did you mean 'backlash'"),
                              ('--max-effects 0', '--max-effects 0: must be at least 1'))),
    *((f'simulate --out {{dir}} {words}', sentence) for words, sentence in (
        ('--duration 0', '--duration must be'),
        ('--duration nan', '--duration nan: must be finite'),
        ('--compensation GMS', '--compensation GMS: must be one of none, gms_paper'),
        ('--compensation GMS', "did you mean 'gms'?"),
        ('--compensation gms gms', 'make 2 bags named sinusoid_gms; give each once'),
        ('--trajectory sinusoid sinusoid', 'make 2 bags named sinusoid_gms; give each once'),
        ('--trajectory {robot}', '--trajectory {robot}: states no trajectory.* parameter'),
        ('--set friction.joint1.forward.static=1e300',
         'friction.joint1.forward.static must be above 0, at most 1e+09 N m, got 1e+300'),
        ('--duration 0.1 --out {file}/x', '{file}/x: cannot be written ({file} is a file; name a'),
        ('--duration 0.1 --out {folder}', 'exists already'),
        ('--set gains.joint1.kd_lnk=1', 'gains.joint1.kd_lnk is not a known parameter; did you '
         "mean 'gains.joint1.kd_link'?"),
        ('--set gains.joint1.kd_link', 'must have the form NAME=VALUE'),
        ('--set gains.joint1.kd_link=[1', "'[1' is not a YAML value"),
        ('--set trajectory.joint1.amplitude=1.0e+300',
         'trajectory.joint1.amplitude must be from -1e+06 to 1e+06 rad, got 1e+300'),
        ('--set rate=fast', "rate must be a number [Hz], got 'fast'"),
        ('--set rate=.nan', 'rate must be finite, got nan'),
        ('--robot {arm}', '--controller needs a file: gains of config/ are for joint1, joint2'),
        ('--trajectory sinus', '--trajectory sinus: no such file'),
        ('--trajectory absent.yaml', 'absent.yaml: cannot be read'),
        ('--set trajectory.type=torque_levels', 'is an open-loop torque'),
        ('--set arm.joint1.stiffness=1e7', 'the simulation diverged at'),
        ('--robot {folder}', 'cannot be read'))),
    *((f'compare --out {{dir}} {words}', sentence) for words, sentence in (
        ('--draws -1', '--draws -1'), ('--rate 0', '--rate 0'),
        ('nowhere.yaml', 'nowhere.yaml'),
        ('--draws 0 --workers 0 --out {missing}', '--workers 0'),
        ('--out /proc/cmp', '--out /proc/cmp: /proc cannot be written'))),
    *((f'tune --out {{dir}} {words}', sentence) for words, sentence in (
        ('--rate 0', '--rate 0'), ('--damping 0.5', 'at least 1'),
        ('--delay-margin nan', '--delay-margin nan: must be at least 0'),
        ('--bandwidth inf', '--bandwidth inf: must be finite'),
        ('--seed -1 --verify 1', '--seed -1: must be at least 0'),
        ('--workers 0', '--workers 0: must be at least 1'),
        ('--torque-limit 1 2 3', 'each of the 2 joints'),
        ('--robot {robot}', '--torque-limit is required'),
        ('--out {robot}/tuned', 'is a file; name a folder'),
        ('--out /proc/tuned', '/proc cannot be written'))),
    *((f'score --out {{dir}} {words}', sentence) for words, sentence in (
        ('--kind singel', "did you mean 'single'?"), ('--set huge', 'known: full, quick'),
        ('--share 0', 'more than 0, at most 1'),
        ('--share nan', '--share nan: must be finite'), ('--kind single --plant x', 'soft, stiff'),
        ('--kind clean --duration nan', '--duration nan: must be finite'))),
    ('plan --robot {arm} --seed -1 --out {dir}', '--seed -1: must be at least 0'),
    ('plan --robot {robot} --out {dir}', 'for decoupled axes or a planar arm use identification'),
    ('import-csv {empty} --map import_kr300.yaml --out {dir}', '{empty}: is empty (0 bytes)'),
    ('import-csv {robot} --map {file} --out {dir}', 'import map; were file and --map exchanged?'),
    ('analyse {bag} {bag} --out {dir}', '{bag} is given twice'),
    ('hide --out {dir} --kind clean --duration=-3', '--duration -3: give 2 to 3600 s'),
    ('hide --out {dir} --seeds 3:3', 'must be a number or A:B'),
    ('faults --soak nan', '--soak'), ('faults --only silense', "did you mean 'silence'"),
    ('faults --priority 100', '--priority 100: expected 1 to 99')]


def printed_of(words, folder, capsys):
    """Run words in which {places} stand; return what is said, that it is all there is checked."""
    places = {'missing': folder / 'missing', 'dir': folder / 'out', 'file': folder / 'file',
              'folder': folder / 'folder', 'empty': folder / 'empty.mcap',
              'packed': folder / 'packed.mcap.zstd', 'bag': ROOT / 'examples' / 'arm_with_play',
              'arm': ROOT / 'examples' / 'light_arm' / 'robot.yaml',
              'robot': ROOT / 'config' / 'robot.yaml', 'bridge': ROOT / 'config' / 'bridge.yaml'}
    places['file'].write_text('mine')
    places['empty'].touch()
    places['packed'].write_bytes(b'mine')
    places['folder'].mkdir()
    verb, *words = words.format(**places).split()
    its_tool, start = (tool, 'gms_flex') if verb in tool.VERBS else (bench, bench.PROG)
    assert its_tool.main([verb, *words]) == tool.BAD_INPUT
    printed, reported = capsys.readouterr()
    assert printed == '' and reported.startswith(f'{start} {verb}: ')
    assert reported.count('\n') == 1 and 'Errno' not in reported
    assert not places['dir'].exists() and list(places['folder'].iterdir()) == []
    assert places['file'].read_text() == 'mine'
    return reported, places


def test_every_verb_is_tested():
    assert {*tool.VERBS, *OF_BENCH} == {*WRONG, *BAGS}


@pytest.mark.parametrize('verb', [*BAGS, *WRONG])
def test_bad_input_of_a_verb_is_said_in_one_sentence(verb, tmp_path, capsys):
    words = WRONG[verb] if verb in WRONG else f'{{missing}} {BAGS[verb]}'
    printed_of(f'{verb} {words}', tmp_path, capsys)


@pytest.mark.parametrize(('words', 'sentence'), OPTIONS)
def test_what_is_wrong_with_an_option_is_said(words, sentence, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    reported, places = printed_of(words, tmp_path, capsys)
    assert sentence.format(**places) in reported


@pytest.mark.parametrize(('words', 'name'), [
    ('identify {bag} --robot', 'friction.yaml'), ('discrepancy {bag} --robot', 'robot.yaml'),
    ('discrepancy {bag} --robot {robot} --models', 'robot.yaml'),
    ('tune --robot', 'trajectory.yaml'), ('tune --controller', 'controller.yaml'),
    ('compare', 'trajectory.yaml'), ('compare --controller', 'trajectory.yaml'),
    ('plan --robot', 'trajectory.yaml'),
    ('next {bag} --robot {robot} --limits', 'identification.yaml'),
    ('urdf --robot', ''), ('urdf --limits', ''), ('export --to csv --robot', '')])
def test_what_is_read_is_not_written_over(words, name, tmp_path, capsys):
    """Not through a link either."""
    robot = ROOT / 'config' / 'robot.yaml'
    words = words.format(bag=ROOT / 'examples' / 'arm_with_play', robot=robot).split()
    kept, link = tmp_path / (name or 'arm.urdf'), tmp_path / 'link.yaml'
    kept.write_bytes(robot.read_bytes())
    link.symlink_to(kept)
    for given in (kept, link):
        out = tmp_path if name else kept
        assert tool.main([*words, str(given), '--out', str(out)]) == tool.BAD_INPUT
        assert f'{given} would be overwritten' in capsys.readouterr().err
    assert kept.read_bytes() == robot.read_bytes()


@pytest.mark.parametrize('words', [
    'record --all --out {dir}', 'view live', 'faults --list', 'demo --out {dir}',
    'demo-identify --out {dir}', 'demo-discrepancy --out {dir}', 'demo-next --out {dir}'])
def test_without_ros_the_extra_is_named(words, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'rclpy', None)  # importing it then fails
    assert "'.[ros]'" in printed_of(words, tmp_path, capsys)[0]
