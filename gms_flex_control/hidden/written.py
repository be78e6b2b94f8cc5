# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What is hidden, as JSON, for whoever judges the answer."""

from gms_flex_control.effects.registry import find


def described(spec):
    """Return an EffectSpec as a dict of effect, joint and parameters by name."""
    names = [parameter.name for parameter in find(spec.name).parameters]
    return {'effect': spec.name, 'joint': spec.joint,
            'parameters': dict(zip(names, spec.values, strict=True))}


def truth_values(truth):
    """
    Return a Truth as plain values.

    Parameters
    ----------
    truth : Truth
        Of a case, see hidden.cases.

    Returns
    -------
    dict
        Kind, seed, plant, motion, ``effects`` (main ones), ``clutter``, ``outsider``.

    """
    outsider = None
    if truth.outsider is not None:
        outsider = {'name': truth.outsider, 'joint': truth.outsider_joint}
    return {'kind': truth.kind, 'seed': truth.seed, 'plant': truth.plant,
            'motion': truth.motion, 'effects': [described(spec) for spec in truth.effects],
            'clutter': [described(spec) for spec in truth.clutter], 'outsider': outsider}
