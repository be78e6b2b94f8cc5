# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Compilation of the inner loops, cached on disk by the content of all kernels.

numba invalidates a cached function when its own file changes, but not when a function it calls
in another file does. The cache folder is therefore named after a hash of every kernel source.

Linear algebra runs in one thread: our matrices are small and our own threads and processes keep
all cores busy; threads of BLAS would wait for a core of their own while others spin.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import wraps
import hashlib
from itertools import count
import os
from pathlib import Path
import sys
import tempfile
from threading import RLock
from types import ModuleType

import numba
from numba import types
from numba.core import config
from numba.core.bytecode import FunctionIdentity
from numba.extending import intrinsic, overload

# numba asks whether there is a BLAS by importing all of scipy.linalg, which takes longer than to
# load the kernels, none of which calls a BLAS; were one to, numba would import it then
_BLAS = 'scipy.linalg.cython_blas'
if _BLAS not in sys.modules:
    sys.modules[_BLAS] = ModuleType(_BLAS)
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules[_BLAS]

_PACKAGE = Path(__file__).parent
# what has kernels that others call
KERNELS = ('friction.py', 'effects', 'dynamics', 'trajectory', 'control', 'simulation', 'hardware',
           'identification/inertial_parameters.py', 'discrepancy/null_simulation.py',
           'discrepancy/residuals.py')

_POINTER = types.CPointer(types.float64)
# signals of the joint, parameters, memory, substep
EFFECT_SIGNATURE = types.void(_POINTER, _POINTER, _POINTER, types.float64)


def _kernel_hash(further):
    digest = hashlib.sha256(f'{numba.__version__}'.encode())
    sources = [Path(__file__)]
    for place in (*(_PACKAGE / name for name in KERNELS), *further):
        # an effect is called by address: nothing else compiles it in
        sources += [place] if place.is_file() else sorted(
            source for source in place.rglob('*.py') if source.parent.name != 'catalogue')
    for source in sources:
        digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder(*further: Path) -> str | None:
    """Return where kernels of these sources and of ``further`` folders are cached, or None."""
    name = f'kernels-{_kernel_hash(further)}'
    home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    user_id = os.getuid() if hasattr(os, 'getuid') else 'user'
    candidates = [_PACKAGE / '__pycache__', Path(home) / 'gms_flex_control',
                  Path(tempfile.gettempdir()) / f'gms_flex_control-{user_id}']
    if config.CACHE_DIR:
        candidates.insert(0, Path(config.CACHE_DIR))
    for parent in candidates:
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(parent / name, os.W_OK) and (parent / name).stat().st_uid == os.getuid():
            return str(parent / name)
    return None


# numba names a symbol after a counter of functions and the types of arguments, without the shape
# of a record's fields. Were the counter to begin at 1 in every process, as it does, kernels for
# one and for seven joints, cached by two processes, would have the same name in a third, which
# calls one of them for both and overwrites memory.
FunctionIdentity._unique_ids = count(int.from_bytes(os.urandom(6), 'big'))

_CACHE_FOLDER = cache_folder()
_ONE_AT_A_TIME = RLock()  # numba looks at one setting for all threads
_EFFECTS = {}             # C functions of effects by their Python functions


@contextmanager
def _cached_in(folder):
    with _ONE_AT_A_TIME:
        previous = config.CACHE_DIR
        config.CACHE_DIR = folder or previous
        try:
            yield folder is not None
        finally:
            config.CACHE_DIR = previous


def compiled(function, folder=_CACHE_FOLDER, **options) -> Callable:
    """
    Compile a numerical function with numba, without the GIL, cached on disk where possible.

    No fast-math: a run gives the same bits whether it is stepped from Python or in one loop.
    Kernels are inlined where others call them: a call hands over each array as seven numbers.
    Kernels outside the package name the ``folder`` that `cache_folder` returns for theirs.
    """
    with _cached_in(folder) as cache:
        return numba.njit(cache=cache, nogil=True, error_model='numpy', forceinline=True,
                          no_cfunc_wrapper=True, **options)(function)


def compiled_part(function) -> Callable:
    """Compile what other kernels alone call, without a wrapper for Python."""
    return compiled(function, no_cpython_wrapper=True)


def compiled_choice(choose) -> Callable:
    """
    Compile a function that stands for one of several kernels, chosen when it is compiled.

    ``choose`` gets the arguments, or in a kernel their types (numba.types), and returns the
    kernel, whose arguments have the same names.
    """
    @wraps(choose)
    def from_python(*args):
        choose(*args)(*args)

    @wraps(choose)
    def kernel_of(*types_of_arguments):
        return choose(*types_of_arguments).py_func

    overload(from_python, jit_options={'error_model': 'numpy', 'nogil': True})(kernel_of)
    return from_python


def compiled_effect(function) -> Callable:
    """
    Compile an effect's ``apply`` to a C function that kernels call by its address.

    Of one ``apply`` all threads get the same: its address says which effect acts.
    """
    if function not in _EFFECTS:
        with _cached_in(_CACHE_FOLDER) as cache:
            if function not in _EFFECTS:
                _EFFECTS[function] = numba.cfunc(
                    EFFECT_SIGNATURE, cache=cache, error_model='numpy')(function)
    return _EFFECTS[function]


@intrinsic
def call_effect(typing_context, address, signals, params, memory, dt) -> tuple:
    """Call the effect compiled at ``address``; all but ``dt`` are addresses (intp)."""
    from llvmlite import ir

    def codegen(context, builder, signature, args):
        pointer = ir.PointerType(ir.DoubleType())
        function_type = ir.FunctionType(
            ir.VoidType(), [pointer, pointer, pointer, ir.DoubleType()])
        function = builder.inttoptr(args[0], ir.PointerType(function_type))
        arguments = [builder.inttoptr(arg, pointer) for arg in args[1:4]]
        builder.call(function, [*arguments, args[4]])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp, types.intp, types.float64), codegen


try:
    from threadpoolctl import threadpool_limits
except ImportError:  # no rosdep key; without it all is as right, and slower on a busy machine
    threadpool_limits = None


def in_one_thread() -> AbstractContextManager:
    """Return a context: until it is left, BLAS uses one thread, then as many as before."""
    return threadpool_limits(1, 'blas') if threadpool_limits else nullcontext()
