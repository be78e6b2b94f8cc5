# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The package's own errors and warnings: each says what, where, the value and the way out."""

from collections.abc import Generator
from contextlib import contextmanager
from difflib import get_close_matches
import warnings


class GmsFlexError(Exception):
    """Anything this package refuses; a front end prints it as one sentence."""


class ParameterError(GmsFlexError, ValueError):
    """A physical parameter or gain is outside what the model allows."""


class ConfigError(GmsFlexError):
    """A parameter file cannot be read or has a wrong key, type or shape."""


class TrajectoryError(GmsFlexError, ValueError):
    """A trajectory cannot be built from its parameters."""


class SimulationError(GmsFlexError):
    """A simulation left the finite numbers."""


class BagError(GmsFlexError):
    """A bag cannot be read or written, or lacks what the analysis needs."""


class ImportDataError(GmsFlexError):
    """A foreign log does not fit its map or is not usable as a recording."""


class IdentificationError(GmsFlexError):
    """A recording does not determine what is wanted, or would determine it wrongly."""


class BatchError(GmsFlexError):
    """A batch of many items cannot be begun or finished."""


@contextmanager
def own_warnings() -> Generator[list, None, None]:
    """Yield a list that collects warnings of this package; those of numpy and scipy are lost."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        warnings.simplefilter('ignore', RuntimeWarning)
        yield caught


def nearest(name, known) -> str:
    """Return '; did you mean ...?' with the nearest of ``known``; '' if none is near."""
    near = get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    return f'; did you mean {near[0]!r}?' if near else ''


def did_you_mean(name, known) -> str:
    """Return the same, or a list of all that is ``known``."""
    return nearest(name, known) or (f"; known: {', '.join(known)}" if known else '')
