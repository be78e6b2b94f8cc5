# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What verbs share: progress on the terminal, folders to be written, batches, and ROS."""

from collections.abc import Callable
import hashlib
from importlib import import_module
from pathlib import Path
import shutil
import sys
from tempfile import TemporaryDirectory
from textwrap import fill
from types import ModuleType

from gms_flex_control.answer import align, Answer, unbroken
from gms_flex_control.errors import BagError, ConfigError
from gms_flex_control.file_io import as_json, write_text

_BAG_FILES = ('.mcap', '.db3', '.zstd')
_INPUTS = 'robot', 'models', 'model', 'controller', 'limits', 'simulate'  # options with files
_WIDTH = 96  # of what is printed as sentences


def say(text: str) -> None:
    """Print a line of progress, beside the results and on a terminal only."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)


def progress(args, form: str = '{}') -> Callable[[str], None]:
    """Return what says a ``form`` of each text, or nothing with --json."""
    return (lambda _: None) if args.json else lambda text: say(form.format(text))


def import_ros(module: str = 'rclpy', hint: str = '') -> ModuleType:
    """Return a module that needs ROS 2; raise ConfigError, with a hint, where that is missing."""
    try:
        import_module('rclpy')
        return import_module(module)
    except ImportError as error:
        raise ConfigError(f'ROS 2 for Python is needed ({error}); source a workspace, or run '
                          f"pip install '.[ros]' in the clone{hint}") from error


def write_or_print(text: str, out, what: str) -> None:
    """Write a text to the file ``out`` and print its name with ``what``, or print it if None."""
    if out:
        write_text(out, text)
        print(f'{out}: {what}')
    else:
        print(text, end='')


def end(args, values, text: str = '', answer: Answer | None = None, files: dict | None = None,
        words=str, code: int = 0) -> int:
    """Print what a verb ends with, as JSON or as text, and return its exit code."""
    if args.json:
        print(as_json(values))
        return code
    if text:
        print(words(text))
    if answer is not None:
        conclude(answer, files, words)
    return code


def conclude(answer: Answer, files: dict, words=str) -> None:
    """Print what each of ``files`` holds and, at last, an Answer, ``words`` applied to it."""
    width = max(map(len, files))
    lines = [f'{name:<{width}}  {path}' for name, path in files.items()]
    print('\n'.join(['', *lines, '', answer_text(answer, words)]))


def answer_text(answer: Answer, words=str) -> str:
    """Return an Answer as lines of text, in which no arrow stands at an end."""
    sentence = fill(unbroken(words(answer.sentence)), _WIDTH, break_on_hyphens=False)
    rows = [[words(cell) for cell in one] for one in answer.numbers]
    return '\n\n'.join([sentence.replace('\u00a0→\u00a0', ' -> '), *(
        [align(answer.header, rows)] if rows else []), f'next: {answer.command}'])


def refuse_overwriting(args, *names: str, further=()) -> None:
    """Raise ConfigError if --out, or a file of these names in it, is a file to be read."""
    read = [file for option in _INPUTS for file in getattr(args, option, None) or ()]
    written = {Path(args.out, name).resolve() for name in names or ('',)} if args.out else ()
    for file in (*read, *further):
        if Path(file).resolve() in written:
            raise ConfigError(f'--out {args.out}: {file} would be overwritten, which is read; '
                              'name another')


def refuse_unwritable(args, *names: str) -> None:
    """
    Raise ConfigError if the folder --out, which is not made, takes nothing.

    Likewise if a file of these ``names`` in it is one that the verb reads.
    """
    refuse_overwriting(args, *names)
    out = args.out
    there = Path(out).absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    if not there.is_dir():
        raise ConfigError(f'--out {out}: {there} is a file; name a folder')
    if any(any(Path(out).glob(f'*{suffix}')) for suffix in _BAG_FILES):
        raise ConfigError(f'--out {out}: is a bag; name another folder for what comes of it')
    try:
        with TemporaryDirectory(prefix='.gms_flex_', dir=there):
            pass
    except OSError as error:
        raise ConfigError(f'--out {out}: {there} cannot be written ({error.strerror}); name '
                          'another folder') from error


def refuse_repeated(bags, holdout) -> None:
    """Raise ConfigError if a bag, or a copy of it, is given twice, to be fitted or held out."""
    given = {}
    for bag, held_out in [*((bag, False) for bag in bags), *((bag, True) for bag in holdout)]:
        alike = given.setdefault(_sizes(bag), []) if _recorded(bag) else []
        for other, fitted in alike:
            if _folder_of(bag) == _folder_of(other) or _digest(bag) == _digest(other):
                copied = '' if bag == other else f', with the same content as {other},'
                raise ConfigError(f'{bag}{copied} ' + (
                    'is among the bags and in --holdout; held-out data must not be fitted: leave '
                    'it out of one of them' if fitted and held_out else
                    'is given twice, which makes data look more certain; leave one out'))
        alike.append((bag, not held_out))


def _folder_of(bag):
    """Return the path of a bag, of its folder where a file of it is named."""
    path = Path(bag).resolve()
    return path.parent if (path.parent / 'metadata.yaml').is_file() else path


def _recorded(bag):
    path = _folder_of(bag)
    return [path] if path.is_file() else sorted(
        one for one in path.glob('*') if one.is_file() and one.suffix in _BAG_FILES)


def _sizes(bag):
    return tuple(sorted(one.stat().st_size for one in _recorded(bag)))


def _digest(bag):
    return sorted(hashlib.sha256(one.read_bytes()).digest() for one in _recorded(bag))


def refuse_foreign(out: Path, verb: str) -> None:
    """Raise BagError if the folder ``out`` holds anything but an earlier run of ``verb``."""
    if out.exists() and not (out.is_dir() and (_marker(out, verb).exists()
                                               or not any(out.iterdir()))):
        raise BagError(f'{out} exists and was not made by {verb}: name another --out')


def prepare(out: Path, verb: str) -> None:
    """Make the folder ``out`` anew, marked as one that ``verb`` may make anew."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    _marker(out, verb).touch()


def _marker(out, verb):
    return out / f'.gms_flex_{verb.replace("-", "_")}'
