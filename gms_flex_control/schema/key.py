# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What is known of one parameter."""

from dataclasses import dataclass
import math
from typing import Any

REQUIRED = object()
SMALLEST = 1e-12  # of what must be above zero


@dataclass(frozen=True)
class Key:
    """
    One parameter.

    Parameters
    ----------
    name : str
        Full name, such as ``gains.joint1.kd_link``.
    kind : {'double', 'integer', 'string', 'double_array', 'string_array', 'boolean'}
        Its ROS type.
    description, unit : str
        What it is, and in what unit.
    default : object
        ``REQUIRED`` if a file must give it.
    lower, upper : float
        Closed range of numbers.
    choices : tuple of str
        Allowed values of a string; empty if any.
    live : bool
        Whether it may change while the node runs.
    unless : tuple of (str, str)
        Of a parameter that must be given: name and value of another beside which it need not,
        and is 0 then.

    """

    name: str
    kind: str
    description: str
    unit: str = ''
    default: Any = REQUIRED
    lower: float = -math.inf
    upper: float = math.inf
    choices: tuple = ()
    live: bool = False
    unless: tuple = ()

    def default_beside(self, given):
        """Return the default beside the values ``given`` (dict), REQUIRED if it has none."""
        if self.unless and given.get(self.unless[0]) == self.unless[1]:
            return 0.0
        return self.default
