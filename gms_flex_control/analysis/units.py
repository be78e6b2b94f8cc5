# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Units other people's logs come in, and what a column's name says about its unit."""

import math
import re

_TURN = 2 * math.pi
# unit -> factor to SI; None: needs more than a factor (see import_map)
LENGTH = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6}  # of a linear axis: m stands for rad, N for N m
SPEED = {'m/s': 1.0, 'mm/s': 1e-3, 'mm/min': 1e-3 / 60, 'm/min': 1 / 60}
FORCE = {'N': 1.0, 'mN': 1e-3, 'kN': 1e3}
POSITION = {'rad': 1.0, 'mrad': 1e-3, 'deg': _TURN / 360, 'mdeg': _TURN / 360e3,
            'turn': _TURN, 'counts': None, **LENGTH}
VELOCITY = {'rad/s': 1.0, 'mrad/s': 1e-3, 'deg/s': _TURN / 360, 'mdeg/s': _TURN / 360e3,
            'rpm': _TURN / 60, 'turn/s': _TURN, 'counts/s': None, **SPEED}
TORQUE = {'N m': 1.0, 'mN m': 1e-3, 'kN m': 1e3, 'N cm': 1e-2, 'A': None, 'mA': None,
          'pwm': None, **FORCE}
TIME = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9}
UNITS = {'position': POSITION, 'velocity': VELOCITY, 'torque': TORQUE, 'time': TIME}

_ALIASES = {
    'radian': 'rad', 'radians': 'rad', 'degree': 'deg', 'degrees': 'deg', '°': 'deg',
    'rev': 'turn', 'turns': 'turn', 'count': 'counts', 'ticks': 'counts', 'dps': 'deg/s',
    'rad_s': 'rad/s', 'rads': 'rad/s', 'rad_per_s': 'rad/s', 'deg_s': 'deg/s',
    'deg_per_s': 'deg/s', 'mdeg_s': 'mdeg/s', 'mrad_s': 'mrad/s', 'rev/min': 'rpm', 'nm': 'N m',
    'n.m': 'N m', 'n*m': 'N m', 'n m': 'N m', 'mnm': 'mN m', 'knm': 'kN m', 'ncm': 'N cm',
    'sec': 's', 'seconds': 's', 'second': 's', 'msec': 'ms', 'usec': 'us', 'µs': 'us',
    'amp': 'A', 'amps': 'A', 'ampere': 'A', 'a': 'A', 'milliamp': 'mA', 'ma': 'mA',
    'newton': 'N', 'n': 'N', 'kn': 'kN', 'meter': 'm', 'metre': 'm', 'millimeter': 'mm',
    'millimetre': 'mm', 'µm': 'um', 'micron': 'um', 'm_s': 'm/s', 'mm_s': 'mm/s',
    'nmm': 'mN m', 'n mm': 'mN m'}
_AMBIGUOUS = ('m', 'n', 'a', 'ma')  # q_m is rather the motor's angle than metres


def canonical(unit):
    """Return the name of a unit used here ('Nm' -> 'N m'), itself if it has no other."""
    text = str(unit).strip()
    return _ALIASES.get(text.lower(), text)


def unit_in_name(column, quantity):
    """
    Return the unit a column's name ends in.

    Parameters
    ----------
    column : str
        For instance ``'q_link1_deg'``, ``'speed [rpm]'``.
    quantity : str
        A key of ``UNITS``: only its units are looked for.

    Returns
    -------
    str or None
        Canonical name; None if the name tells none.

    """
    text = column.strip().lower().replace('²', '2')
    bracket = re.search(r'[\[(]\s*([^\])]*?)\s*[\])]\s*$', text)
    parts = re.split(r'[_\s.]+', text)
    candidates = [bracket.group(1)] if bracket else [
        '_'.join(parts[-count:]) for count in (3, 2, 1) if len(parts) > count]
    for candidate in candidates:
        if candidate in _AMBIGUOUS and not bracket:
            continue
        for known in UNITS[quantity]:
            if canonical(candidate).lower() == known.lower():
                return known
    return None
