# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The commands of the tutorials do what the tutorials say, and the documents' links lead on."""

import re
import subprocess

import pytest
from tutorial import is_as_documented, JUDGED, parts_of, place_of, ROOT, TUTORIALS


@pytest.mark.parametrize('name', ['without_ros', 'with_a_bag'])
def test_the_commands_print_what_the_tutorial_says(name, tmp_path):
    here, environment = place_of(tmp_path)
    commands = [one for _, block in parts_of(TUTORIALS / f'{name}.md') for one in block]
    script = '\n'.join(f'{{ {command}\n}} > out{k} 2>&1; echo $? > code{k}'
                       for k, (command, _) in enumerate(commands))
    subprocess.run(['bash', '-c', script], cwd=here, env=environment, timeout=900, check=False,
                   stdin=subprocess.DEVNULL)
    for k, (command, expected) in enumerate(commands):
        printed = (here / f'out{k}').read_text()
        assert is_as_documented(printed, expected), (
            f'{command}\nprinted\n{printed}\ninstead of\n{expected}')
        assert int((here / f'code{k}').read_text()) in JUDGED, f'{command}\n{printed}'
    if commands[-1][0].startswith('rm '):  # so that the page can be followed a second time
        assert list(here.rglob('metadata.yaml')) == []


@pytest.mark.parametrize('path', [
    path.relative_to(ROOT).as_posix() for path in (*ROOT.glob('*.md'), *ROOT.glob('docs/**/*.md'))
    if '_' not in path.parent.name])
def test_links_to_files_lead_somewhere(path):
    text = re.sub(r'```.*?```', '', (ROOT / path).read_text(encoding='utf-8'), flags=re.DOTALL)
    for target in re.findall(r'\]\(([^)#\s]+)', text):
        if '://' not in target:
            assert ((ROOT / path).parent / target).exists(), f'{path}: {target}'


def test_every_document_stands_in_the_contents():
    listed = (ROOT / 'docs' / 'index.md').read_text(encoding='utf-8').split()
    there = {path.relative_to(ROOT / 'docs').with_suffix('').as_posix()
             for path in (ROOT / 'docs').glob('**/*.md') if '_' not in path.parts[-2]}
    assert there - {'index'} <= set(listed)
