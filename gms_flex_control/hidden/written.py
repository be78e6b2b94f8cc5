# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What is hidden, as JSON, for whoever judges the answer."""

from dataclasses import replace

from gms_flex_control.effects.registry import find
import numpy as np


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
        Kind, seed, population, plant, motion, ``effects`` (main ones), ``clutter``,
        ``outsider``, ``belief_errors`` (joint -> kind -> relative error), ``torque_noise``.

    """
    outsider = None
    if truth.outsider is not None:
        outsider = {'name': truth.outsider, 'joint': truth.outsider_joint}
    return {'kind': truth.kind, 'seed': truth.seed, 'population': truth.population,
            'plant': truth.plant,
            'motion': truth.motion, 'effects': [described(spec) for spec in truth.effects],
            'clutter': [described(spec) for spec in truth.clutter], 'outsider': outsider,
            'belief_errors': {joint: {
                kind: float(error[j]) for kind, error in truth.belief_errors.items()}
                for j, joint in enumerate(truth.robot.joints)},
            'torque_noise': truth.torque_noise.tolist()}


def as_named(recording, motors):
    """
    Return a Recording as a bag has it, and the motor names of its joints.

    Parameters
    ----------
    recording : Recording
        Of a case.
    motors : sequence of str
        Of its joints.

    Returns
    -------
    recording : Recording
        With the motors for joints where nobody sees the links.
    motors : sequence of str

    """
    if np.isfinite(recording.q_link).any():
        return recording, motors
    nothing = np.full_like(recording.q_motor, np.nan)
    return replace(recording, joints=tuple(motors), q_link=recording.q_motor, q_motor=nothing,
                   dq_link=recording.dq_motor, dq_motor=nothing), [''] * len(motors)
