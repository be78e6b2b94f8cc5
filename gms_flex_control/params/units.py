# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Units of linear axes in what is printed: m for rad, mm for mrad, N for N m, kg for kg m^2."""

from functools import reduce
import re

from gms_flex_control.params.arm import ArmParams

_OF_LINEAR = ((r'\bkg m\^2', 'kg'), (r'\b([mk]?N) m\b', r'\1'), (r'\bmrad\b', 'mm'),
              (r'\brad\b', 'm'))


def in_units(arm: ArmParams, text: str) -> str:
    """Return a text that is written for rotary axes, its units those of an arm."""
    if arm.axes == 'rotary':
        return text
    return reduce(lambda told, unit: re.sub(*unit, told), _OF_LINEAR, text)
