# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How effects can join compiled kernels: the alternatives of docs/decisions.md, measured.

Every alternative runs the same ``apply`` functions of the catalogue over the same signals in a
compiled loop. Compile times come from fresh processes: with an empty cache, with a full one,
and for another combination of effects in a process that has met all of them before.
"""

import hashlib
from importlib.util import module_from_spec, spec_from_file_location
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from time import perf_counter

from bench.speed.simulation import EFFECTS
from bench.speed.timing import Measurement
from gms_flex_control.compiled import compiled
from gms_flex_control.effects import table
from gms_flex_control.effects.base import Stage, Term
from gms_flex_control.effects.registry import find, names
from gms_flex_control.effects.signals import (
    DQ_LINK,
    DQ_MOTOR,
    Q_LINK,
    Q_MOTOR,
    SPRING,
    TORQUE,
    WIDTH,
)
from gms_flex_control.params.robot import EffectSpec
import numba
from numba import types
from numba.extending import intrinsic
import numpy as np

JOINTS = ('joint1', 'joint2')
COUNTS = (0, 1, 3, 10)
_STAGES = len(Stage)
_ARRAY = types.Array(types.float64, 1, 'C')
_ARRAYS = types.void(_ARRAY, _ARRAY, _ARRAY, types.float64)


def entries(effects):
    """Return offsets of every effect: signals, params and memory (k, 3), and all parameters."""
    kinds = [find(name) for name, _ in effects]
    starts = np.cumsum([0, *(len(values) for _, values in effects)])[:-1]
    memory = np.cumsum([0, *(kind.memory_size for kind in kinds)])[:-1]
    joints = WIDTH * (np.arange(len(effects)) % len(JOINTS))
    offsets = np.array([joints, starts, memory], dtype=np.intp).T.reshape(-1, 3)
    return offsets, np.array([v for _, values in effects for v in values] + [0.0])


def _generated(lines):
    """Import a module written from ``lines``; the same lines give the same file, for the cache."""
    text = '\n'.join(lines)
    folder = Path(os.environ.get('NUMBA_CACHE_DIR') or tempfile.mkdtemp())
    path = folder / f'generated_{hashlib.sha256(text.encode()).hexdigest()[:12]}.py'
    if not path.exists():
        path.write_text(text, encoding='utf-8')
    spec = spec_from_file_location(path.stem, path)
    module = module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


@intrinsic
def pointer_at(typing_context, address):
    """Return a pointer to float64 for an address (intp), as ``apply`` takes it."""
    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

    return types.CPointer(types.float64)(types.intp), codegen


@numba.njit  # not cached: numba would not see that WIDTH has changed in its own module
def move(signals, dt):
    """Change what effects read, so that nothing they compute is the same in the next round."""
    for first in range(0, signals.shape[0], WIDTH):
        for k in (Q_LINK, DQ_LINK, Q_MOTOR, DQ_MOTOR):
            signals[first + k] += dt
        signals[first + TORQUE] = signals[first + SPRING] = signals[first + Q_LINK]


def _imports(chosen):
    lines = ['from numba import njit', f'from {__name__} import move, pointer_at',
             'from gms_flex_control.effects.registry import find']
    return [*lines, *(f'f_{name} = njit(cache=True)(find({name!r}).apply)' for name in chosen)]


def specialised(effects):
    """Return A: a loop generated for this very combination, all inlined."""
    offsets, params = entries(effects)
    module = _generated([
        *_imports(sorted({name for name, _ in effects})), '@njit(cache=True)',
        'def loop(count, signals, params, memory, dt):', '    for _ in range(count):',
        '        move(signals, dt)',
        *(f'        f_{name}(pointer_at(signals.ctypes.data + {8 * s}), '
          f'pointer_at(params.ctypes.data + {8 * p}), '
          f'pointer_at(memory.ctypes.data + {8 * m}), dt)'
          for (name, _), (s, p, m) in zip(effects, offsets, strict=True))])
    return lambda count, signals, memory, dt: module.loop(count, signals, params, memory, dt)


def switch(effects):
    """Return B: a loop over opcodes, one branch per effect of the catalogue."""
    offsets, params = entries(effects)
    terms = [name for name in names() if issubclass(find(name), Term)]
    codes = np.array([terms.index(name) for name, _ in effects], dtype=np.intp)
    branches = []
    for code, name in enumerate(terms):
        branches += [f'            {"elif" if code else "if"} code == {code}:',
                     f'                f_{name}(s, p, m, dt)']
    module = _generated([
        *_imports(terms), '@njit(cache=True)',
        'def loop(count, codes, offsets, signals, params, memory, dt):',
        '    for _ in range(count):', '        move(signals, dt)',
        '        for k in range(len(codes)):', '            code = codes[k]',
        '            s = pointer_at(signals.ctypes.data + 8 * offsets[k, 0])',
        '            p = pointer_at(params.ctypes.data + 8 * offsets[k, 1])',
        '            m = pointer_at(memory.ctypes.data + 8 * offsets[k, 2])', *branches])
    return lambda count, signals, memory, dt: module.loop(
        count, codes, offsets, signals, params, memory, dt)


@numba.njit(cache=True)
def first_class_loop(count, functions, offsets, signals, params, memory, dt):
    """Loop over a tuple of first-class functions."""
    for _ in range(count):
        move(signals, dt)
        for k in range(len(functions)):
            functions[k](signals[offsets[k, 0]:], params[offsets[k, 1]:],
                         memory[offsets[k, 2]:], dt)


def first_class(effects):
    """Return C: a loop over numba's first-class functions, array arguments."""
    offsets, params = entries(effects)
    if not effects:
        return specialised(effects)  # an empty tuple has no element type
    functions = tuple(_array_cfunc(name) for name, _ in effects)
    return lambda count, signals, memory, dt: first_class_loop(
        count, functions, offsets, signals, params, memory, dt)


def _array_cfunc(name):
    return numba.cfunc(_ARRAYS, cache=True)(find(name).apply)


@intrinsic
def call_with_arrays(typing_context, address, signals, params, memory, dt):
    """Call a C function at ``address`` whose arguments are numba's array structures."""
    from llvmlite import ir

    def codegen(context, builder, signature, args):
        kinds = [context.get_value_type(kind) for kind in signature.args[1:]]
        pointer = ir.PointerType(ir.FunctionType(ir.VoidType(), kinds))
        builder.call(builder.inttoptr(args[0], pointer), args[1:])
        return context.get_dummy_value()

    return types.void(types.intp, _ARRAY, _ARRAY, _ARRAY, types.float64), codegen


@numba.njit(cache=True)
def address_array_loop(count, addresses, offsets, signals, params, memory, dt):
    """Loop over addresses of functions with array arguments."""
    for _ in range(count):
        move(signals, dt)
        for k in range(len(addresses)):
            call_with_arrays(addresses[k], signals[offsets[k, 0]:], params[offsets[k, 1]:],
                             memory[offsets[k, 2]:], dt)


def address_arrays(effects):
    """Return D: a loop over addresses of C functions with array arguments."""
    offsets, params = entries(effects)
    functions = [_array_cfunc(name) for name, _ in effects]
    addresses = np.array([function.address for function in functions], dtype=np.intp)
    return lambda count, signals, memory, dt, keep=functions: address_array_loop(
        count, addresses, offsets, signals, params, memory, dt)


@compiled
def table_loop(count, flat, signals, memory, dt, terms):
    """Loop as the plant does: every stage of the effect table, which comes boxed."""
    for _ in range(count):
        move(flat, dt)
        for stage in range(_STAGES):
            table.run_stage(stage, signals, memory, dt, terms[0])


def address_pointers(effects):
    """Return E: a loop over addresses with pointers, as the package does."""
    specs = [EffectSpec(name=name, joint=JOINTS[k % len(JOINTS)], values=values)
             for k, (name, values) in enumerate(effects)]
    terms = np.array([table.build(specs, JOINTS)])
    return lambda count, signals, memory, dt: table_loop(
        count, signals, signals.reshape(len(JOINTS), WIDTH), memory, dt, terms)


ALTERNATIVES = {'A specialised': specialised, 'B switch': switch, 'C first-class': first_class,
                'D address, arrays': address_arrays, 'E address, pointers': address_pointers}


def time_one(alternative, count, loops):
    """Return compile time, that of another combination [s], and run time per substep [ns]."""
    build, dt = ALTERNATIVES[alternative], 1e-4
    signals, memory = np.full(len(JOINTS) * WIDTH, 0.1), np.zeros(16)

    def first_call(effects):
        begin = perf_counter()
        loop = build(effects)
        loop(1, signals, memory, dt)
        return loop, perf_counter() - begin

    loop, compile_time = first_call(EFFECTS[:count])
    _, another_time = first_call(EFFECTS[:count][::-1])
    times = []
    for _ in range(7):
        signals[:] = 0.1
        begin = perf_counter()
        loop(loops, signals, memory, dt)
        times.append(perf_counter() - begin)
    return {'compile': compile_time, 'another': another_time, 'run': 1e9 * min(times) / loops}


def _in_fresh_process(alternative, count, loops, cache):
    code = (f'import json\nfrom {__name__} import time_one\n'
            f'print(json.dumps(time_one({alternative!r}, {count}, {loops})))')
    done = subprocess.run(
        [sys.executable, '-c', code], check=True, capture_output=True, text=True,
        env={**os.environ, 'NUMBA_CACHE_DIR': cache})
    return json.loads(done.stdout.splitlines()[-1])


def measure(robot, gains, quick=False):
    """
    Measure every alternative with 0, 1, 3 and 10 effects.

    Parameters
    ----------
    robot, gains
        Not used: the signals are those of two joints.
    quick : bool
        Only 3 effects, and fewer loops.

    Returns
    -------
    list of Measurement
        Run time per substep, and compile times: cold, cached, another combination.

    """
    rows = []
    for count in (3,) if quick else COUNTS:
        for name in ALTERNATIVES:
            with tempfile.TemporaryDirectory() as cache:
                cold = _in_fresh_process(name, count, 10_000 if quick else 1_000_000, cache)
                warm = _in_fresh_process(name, count, 10_000, cache)
            rows += [Measurement(suite='effects', name=f'{name}, {count} effects: {what}',
                                 value=value, unit=unit) for what, value, unit in (
                ('run', cold['run'], 'ns / substep'),
                ('first compilation', cold['compile'], 's'),
                ('another combination', cold['another'], 's'),
                ('new process, cached', warm['compile'], 's'))]
    return rows
