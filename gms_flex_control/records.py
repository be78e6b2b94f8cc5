# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Numpy records: how parameters and states reach the compiled kernels.

A record is one block of memory with named fields of fixed shape, so a kernel gets a single
pointer, knows every loop's length when it is compiled and counts no references. Reasons and
measurements: docs/decisions.md.
"""

from types import SimpleNamespace

import numpy as np

FLOAT = np.float64
FLAG = np.uint8  # numba knows no arrays of bool inside a record


def layout(*fields) -> np.dtype:
    """Return the dtype of a record of fields (name, type or other layout, shape), for `build`."""
    return np.dtype((np.record, np.dtype(list(fields), align=True)))


def build(dtype, **values) -> np.record:
    """
    Return a new record of a `layout`, zero where no value is given, values broadcast to fields.

    It owns its memory; ``.copy()`` gives an independent one.
    """
    whole = np.zeros(1, dtype)
    for name, value in values.items():
        whole[name][0] = value
    return whole[0]


def views(record) -> SimpleNamespace:
    """Return the fields of a record as attributes that Python finds at once, in its own memory."""
    fields = {name: getattr(record, name) for name in record.dtype.names}
    return SimpleNamespace(**{
        name: views(field) if isinstance(field, np.record) else field
        for name, field in fields.items()})


def boxed(record) -> np.ndarray:
    """
    Return a copy of a record as an array (1,), for calls from Python at every tick.

    numba takes the array in 0.1 microseconds, the record in 4: it asks a record for its buffer,
    and numpy then writes out a description of all its fields. ``array[0]`` is a record in the
    array's memory.
    """
    return np.array([record], record.dtype)
