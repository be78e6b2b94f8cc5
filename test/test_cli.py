# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""All verbs of both tools alike: help with examples, exit codes, JSON, colours, completion."""

from argparse import Namespace
import ast
import ctypes
from itertools import chain
import json
import os
from pathlib import Path
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
import warnings

from bench import __main__ as bench
from gms_flex_control.cli import main as tool
from gms_flex_control.cli.terminal import progress
from gms_flex_control.cli.verbs import GROUPS
from gms_flex_control.data.bag import BagWarning
from gms_flex_control.effects import registry
import numba
import numpy as np
from processes import environment_of, TOOL
import pytest

ROOT = Path(__file__).resolve().parents[1]
VERBS = tool.VERBS
OF_BENCH = tuple(verb for group in bench.GROUPS.values() for verb in group)
WITHOUT_TABLE = {'urdf', 'view', 'export', 'coverage', 'learn', 'real-machines',
                 'hidden-arms', 'base-parameters', 'growth', 'real-arm', 'paper-method'}


@pytest.mark.parametrize('verb', (*VERBS, *OF_BENCH))
def test_the_help_of_a_verb_has_examples_that_parse(verb, capsys):
    """An option that it does not have is bad input."""
    its_tool, prog = (tool, 'gms_flex') if verb in VERBS else (bench, bench.PROG)
    parser = its_tool.build_parser().verbs[verb]
    text = parser.format_help()
    assert parser.description
    assert verb in WITHOUT_TABLE or '--json' in text
    _, found, examples = text.partition('examples:\n')
    assert found, f'{verb}: add examples beside the other ones'
    commands = [line for line in examples.replace('\\\n', ' ').splitlines() if line.strip()]
    assert commands
    for command in commands:
        inner = re.search(r'\$\((.*)\)', command)
        words = (inner.group(1) if inner else command.split('>')[0]).strip()
        start = f'{prog} {verb}'
        assert words.startswith(start)
        parser.parse_args(shlex.split(words.removeprefix(start)))
    with pytest.raises(SystemExit) as ended:
        its_tool.main([verb, '--no-such-option'])
    assert ended.value.code == tool.BAD_INPUT
    assert f'usage: {prog} ' in capsys.readouterr().err


@pytest.mark.parametrize(('its_tool', 'verbs'), [(tool, VERBS), (bench, OF_BENCH)])
def test_the_bare_command_is_the_help_with_verbs_by_group(its_tool, verbs, capsys):
    assert its_tool.main([]) == tool.OK
    printed, reported = capsys.readouterr()
    assert printed == its_tool.build_parser().format_help() and reported == ''
    _, *groups = printed.split('\nverbs ')
    listed = [re.findall(r'^  ([a-z-]+) ', group, re.MULTILINE) for group in groups]
    assert sorted(sum(listed, [])) == sorted(verbs)
    if its_tool is tool:
        assert len(listed[0]) == 11 and 'identify' in listed[0]


@pytest.mark.parametrize(('typed', 'meant'), [
    ('idenify', "'identify'"), ('chek-gains', "'check-gains'"), ('xyz', 'known: import-csv, ')])
def test_a_misspelt_verb_is_answered_with_the_nearest(typed, meant, capsys):
    with pytest.raises(SystemExit) as ended:
        tool.main([typed, 'bag'])
    reported = capsys.readouterr().err
    assert ended.value.code == tool.BAD_INPUT
    assert f'there is no verb {typed!r}; ' in reported and meant in reported


def test_an_unknown_option_is_answered_with_the_nearest_and_the_usage_of_the_verb(capsys):
    near = "there is no option --hold-out; did you mean '--holdout'?"
    for words, said in ((['--hold-out', 'c'], near), (['-x'], 'unrecognized arguments: -x')):
        with pytest.raises(SystemExit) as ended:
            tool.main(['identify', 'a', *words, '--out', 'd'])
        reported = capsys.readouterr().err
        assert ended.value.code == tool.BAD_INPUT
        assert said in reported and 'usage: gms_flex identify ' in reported


def test_warnings_of_numpy_stay_away_and_ours_are_sentences(monkeypatch, capsys):
    def warns(args):
        np.log(np.zeros(2))
        np.nanmean(np.full(2, np.nan))
        np.polyfit([1.0, 1.0], [1.0, 2.0], 1)
        warnings.warn('the bag has gaps', BagWarning, stacklevel=2)
        worker = subprocess.run([sys.executable, '-c', 'import numpy; numpy.log(numpy.zeros(2))'],
                                capture_output=True, text=True, check=True)
        print(worker.stderr, end='')
        return 0

    monkeypatch.setattr('gms_flex_control.cli.bags.info', warns)
    monkeypatch.setattr(sys, 'warnoptions', [])
    monkeypatch.delenv('PYTHONWARNINGS', raising=False)
    assert tool.main(['info', 'bag']) == tool.OK
    assert capsys.readouterr() == ('', 'gms_flex info: warning: the bag has gaps\n')
    assert 'PYTHONWARNINGS' not in os.environ


def test_an_older_python_is_answered_with_what_is_needed():
    done = subprocess.run(
        [sys.executable, '-c', "import sys; sys.version_info = (3, 10, 12, 'final', 0); "
         "sys.version = '3.10.12 (main)'; import gms_flex_control"],
        cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (
        1, 'gms_flex_control needs Python 3.11 or later, this is 3.10.12\n')
    ast.parse((ROOT / 'gms_flex_control' / '__init__.py').read_text(), feature_version=(3, 8))


@pytest.mark.parametrize('arguments', [
    ['--help'], ['tune', '--rate', 'x'], ['tune', '--out', 'x', '--rate', '0']])
def test_help_and_bad_arguments_start_no_compiler(arguments, tmp_path):
    script = tmp_path / 'script.py'
    script.write_text(
        'import sys\nfrom gms_flex_control.cli.main import main\ntry:\n'
        f'    main({arguments})\nexcept SystemExit:\n    pass\n'
        "sys.exit(str([one for one in ('numba', 'scipy', 'matplotlib') if one in sys.modules]))")
    ran = subprocess.run([sys.executable, str(script)], capture_output=True, text=True,
                         check=False, env=environment_of())
    assert ran.stderr.splitlines()[-1] == '[]', ran.stderr


@pytest.mark.parametrize('terminal', [True, False])
def test_a_command_that_compiles_says_so_on_a_terminal(terminal, monkeypatch, capsys):
    def compiles(args):
        return numba.njit(lambda x: x + 1)(-1)

    monkeypatch.setattr('gms_flex_control.cli.bags.info', compiles)
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: terminal)
    assert tool.main(['info', 'bag']) == tool.OK
    assert capsys.readouterr().err.count('compiling the inner loops') == terminal


def test_progress_is_shown_on_a_terminal_and_never_beside_json(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    for as_json, shown in ((False, '  fit ...\n'), (True, '')):
        progress(Namespace(json=as_json), '  {} ...')('fit')
        assert capsys.readouterr() == ('', shown)


def test_every_effect_is_listed_with_its_parameters(capsys):
    assert tool.main(['effects']) == tool.OK
    text = capsys.readouterr().out
    assert tool.main(['effects', '--json']) == tool.OK
    found = {entry['name']: entry for entry in json.loads(capsys.readouterr().out)}
    assert tuple(found) == registry.names()
    for name, entry in found.items():
        assert f'{name}: {entry["what"]}\n' in text
        assert [one['key'].rpartition('.')[2] for one in entry['parameters']] == [
            one.name for one in registry.find(name).parameters]
    assert '    effects.<joint>.backlash.half_gap  [rad]  half width of the play\n' in text
    assert found['tip_payload']['parameters'][0]['key'] == 'effects.arm.tip_payload.mass'
    assert tool.main(['effects', 'backlash']) == tool.OK
    assert capsys.readouterr().out.splitlines() == text.splitlines()[
        text.splitlines().index('backlash: Play in the transmission'):][:2]


def test_an_error_of_the_program_is_no_finding(monkeypatch, capsys):
    def broken(args):
        raise ZeroDivisionError('of the program')

    monkeypatch.setattr('gms_flex_control.cli.bags.info', broken)
    assert tool.main(['info', 'bag']) == tool.OWN_ERROR
    reported = capsys.readouterr().err
    assert 'ZeroDivisionError: of the program' in reported
    assert 'please report it' in reported


@pytest.mark.parametrize('words, sentence', [
    ('info bag', 'gms_flex info: interrupted\n'),
    ('tune --out x', 'gms_flex tune: interrupted\n'),
    ('compare', 'gms_flex compare: interrupted\n')])
def test_ctrl_c_is_one_line_and_130(words, sentence, monkeypatch, capsys):
    """Also where a library makes another error of it, as numpy does while it is imported."""
    def cut_short(args):
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError('no module datetime') from None

    verb = next(one for one in chain(*GROUPS.values()) if one.name == words.split()[0])
    monkeypatch.setattr(f'gms_flex_control.cli.{verb.run}', cut_short)
    assert tool.main(words.split()) == tool.INTERRUPTED == 130
    assert capsys.readouterr().err == sentence
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert '130 interrupted' in tool.build_parser().format_help()


def test_ctrl_c_while_llvm_calls_back_is_not_lost(monkeypatch, capsys):
    """What is raised in a function that C calls goes no further: the verb would go on."""
    names = {'os': os, 'signal': signal}
    exec(compile('def called():\n    os.kill(os.getpid(), signal.SIGINT)\n',
                 '/site-packages/llvmlite/binding/executionengine.py', 'exec'), names)

    def compile_and_go_on(args):
        ctypes.CFUNCTYPE(None)(names['called'])()
        time.sleep(5.0)
        return 0

    monkeypatch.setattr('gms_flex_control.cli.bags.info', compile_and_go_on)
    assert tool.main(['info', 'bag']) == 130
    assert capsys.readouterr().err == 'gms_flex info: interrupted\n'


def test_ctrl_c_ends_workers_in_silence(tmp_path):
    """To the whole group of processes, as a terminal does."""
    process = subprocess.Popen(
        [sys.executable, '-m', 'bench', 'score', '--kind', 'single', '--seeds', '0:8',
         '--no-peers', '--out', str(tmp_path)], stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment_of())
    assert 'hidden robots' in process.stderr.readline()
    time.sleep(2.0)  # while they start, or work
    os.killpg(process.pid, signal.SIGINT)
    _, reported = process.communicate(timeout=60)
    assert (process.returncode, reported) == (130, 'python -m bench score: interrupted\n')


def test_the_shell_knows_what_may_follow(tmp_path):
    pytest.importorskip('argcomplete')
    answer, typed = tmp_path / 'answer', 'gms_flex simulate --compensation lu'
    subprocess.run(TOOL, check=False, env=environment_of(
        _ARGCOMPLETE='1', _ARGCOMPLETE_STDOUT_FILENAME=str(answer), COMP_LINE=typed,
        COMP_POINT=str(len(typed)), _ARGCOMPLETE_IFS='\n', COMP_TYPE='9'))
    assert 'lugre' in [word.strip() for word in answer.read_text().split('\n')]


@pytest.mark.parametrize('verb', ['tune', 'analyse'])
def test_a_full_disk_leaves_what_was_there_before(verb, tmp_path, capsys):
    """Files of more than some thousand bytes fail: small ones were there, pictures were not."""
    out, bag = tmp_path / 'out', tmp_path / 'bag'
    given = [str(bag)] if verb == 'analyse' else []
    if verb == 'analyse':
        assert tool.main(['simulate', '--duration', '1', '--out', str(bag)]) == 0
    tool.main([verb, *given, '--out', str(tmp_path / 'compiled')])
    before, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (6000, hard))
    try:
        code = tool.main([verb, *given, '--out', str(out)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, hard))
    assert code == 2 and 'File too large' in capsys.readouterr().err
    assert not out.exists()
