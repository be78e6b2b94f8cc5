# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The way out of a misspelt name."""

from difflib import get_close_matches


def did_you_mean(name, known):
    """Return '; did you mean ...?' with the nearest of ``known``, or a list of all of them."""
    near = get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    if near:
        return f'; did you mean {near[0]!r}?'
    return f"; known: {', '.join(known)}" if known else ''
