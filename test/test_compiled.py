# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Kernels on disk, of arms with other numbers of joints and from other processes."""

from concurrent.futures import ThreadPoolExecutor
import ctypes
import subprocess
import sys
from threading import Barrier

from gms_flex_control.compiled import compiled_effect
from gms_flex_control.effects.registry import find
import numpy as np
from processes import environment_of

ONE_AFTER_ANOTHER = """
import sys
import numpy as np
from gms_flex_control.dynamics.chain import inverse_dynamics
from gms_flex_control.params.arm import ArmParams

for n in map(int, sys.argv[1:]):
    arm = ArmParams(kind='decoupled', mass=[0.0] * n, length=[0.0] * n, com=[0.0] * n,
                    inertia=[0.03] * n, motor_inertia=[0.005] * n, stiffness=[np.inf] * n,
                    damping=[0.0] * n)
    for samples in (1, 50, 301, 1200):
        second = np.linspace(1.0, 2.0, samples * n).reshape(samples, n)
        still = np.zeros((samples, n))
        torque = inverse_dynamics(still, still, second, arm)
        assert np.allclose(torque, (arm.inertia + arm.motor_inertia) * second, rtol=1e-12)
# numba's own way to look for BLAS takes longer than all that is loaded here
assert 'scipy.linalg' not in sys.modules
"""


def test_kernels_cached_for_one_arm_serve_no_other(tmp_path):
    """
    A process that loads what two others compiled, for 1 and for 7 joints, calls each for its own.

    Rigid axes have the torque of their inertia. Taken for the other arm, a kernel writes beyond
    its arrays: wrong numbers, or the end of the process.
    """
    for joints in (['1'], ['7'], ['7', '1']):
        done = subprocess.run([sys.executable, '-c', ONE_AFTER_ANOTHER, *joints],
                              check=False, text=True, capture_output=True, timeout=300,
                              env=environment_of(NUMBA_CACHE_DIR=str(tmp_path), MALLOC_CHECK_='3'))
        assert done.returncode == 0, f'{joints}: {done.stderr}'


def test_an_effect_that_divides_by_zero_gives_infinity_as_kernels_do(capfd):
    """A C function that raised would end early, with a traceback for each of a million calls."""
    def apply(s, p, memory, dt):
        s[0] = p[0] / p[1]

    signals = (ctypes.c_double * 1)()
    compiled_effect(apply).ctypes(signals, (ctypes.c_double * 2)(1.0, 0.0), signals, 1e-3)
    assert signals[0] == np.inf
    assert capfd.readouterr().err == ''


def test_an_effect_has_one_address_in_all_threads():
    """By which a model is asked whether it holds that effect: of two, one would not be found."""
    threads = 4
    together = Barrier(threads)

    class Drag(find('viscous_error')):
        @staticmethod
        def apply(s, p, memory, dt):
            s[0] += p[0] * s[1]

    def address(_):
        together.wait(timeout=10.0)
        return Drag.compiled().address

    with ThreadPoolExecutor(threads) as pool:
        assert len(set(pool.map(address, range(threads)))) == 1
