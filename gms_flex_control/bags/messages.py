# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the messages of the control loop mean: labels, layouts and tables over time."""

from gms_flex_control.bags.cdr import pack_multi_array
from gms_flex_control.errors import BagError
import numpy as np

STAMP_LABEL = 'stamp:'
SOURCE_LABEL = 'source:'


def pack_command(torque, stamp=None, source=None):
    """
    Pack a torque command.

    Parameters
    ----------
    torque : sequence of float
        One per joint [N m].
    stamp : int, optional
        Stamp of the joint state it answers [ns].
    source : str, optional
        Who sends it.

    Returns
    -------
    bytes
        A Float64MultiArray; with neither stamp nor source it has no layout at all.

    """
    dims = [] if stamp is None and source is None else [('joint', len(torque), len(torque))]
    if stamp is not None:
        dims.append((f'{STAMP_LABEL}{stamp}', 1, 1))
    if source is not None:
        dims.append((f'{SOURCE_LABEL}{source}', 1, 1))
    return pack_multi_array(dims, torque)


def pack_reference(values, stamp, kind='derivative'):
    """Pack a reference, rows x joints (``kind`` names the rows), for the time ``stamp`` [ns]."""
    values = np.asarray(values, dtype=float)
    rows, joints = values.shape
    dims = [(kind, rows, rows * joints), ('joint', joints, joints),
            (f'{STAMP_LABEL}{stamp}', 1, 1)]
    return pack_multi_array(dims, values.ravel().tolist())


def pack_supply(voltage, stamp):
    """Pack the voltage of the drives' supply [V] at the time ``stamp`` [ns]."""
    return pack_multi_array([('supply', 1, 1), (f'{STAMP_LABEL}{stamp}', 1, 1)],
                            [float(voltage)])


def pack_blocks(values, stamp=None):
    """Pack the block torques of the observer, joints x blocks [N m]."""
    values = np.asarray(values, dtype=float)
    joints, blocks = values.shape
    dims = [('joint', joints, joints * blocks), ('block', blocks, blocks)]
    if stamp is not None:
        dims.append((f'{STAMP_LABEL}{stamp}', 1, 1))
    return pack_multi_array(dims, values.ravel().tolist())


def stamp_of(dims):
    """Return the nanoseconds of the first 'stamp:' label in a layout, None if there is none."""
    for label, _, _ in dims:
        if label.startswith(STAMP_LABEL):
            text = label[len(STAMP_LABEL):]
            try:
                return int(text)
            except ValueError:
                raise BagError(f'has the label {label!r}, expected '
                               f'{STAMP_LABEL}<whole nanoseconds>') from None
    return None
