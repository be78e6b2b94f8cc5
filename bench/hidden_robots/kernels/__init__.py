# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The compiled parts of the hidden robots; they share none with the simulation."""

from functools import partial
from pathlib import Path

from gms_flex_control import compiled as kernels

compiled = partial(kernels.compiled, folder=kernels.cache_folder(Path(__file__).parent))
