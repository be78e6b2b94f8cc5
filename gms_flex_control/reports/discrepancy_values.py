# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Files for machines of a discrepancy: report.json, and robot.yaml with what was found."""

import json
import math
from textwrap import wrap

from gms_flex_control import __version__
from gms_flex_control.discrepancy.describe import named
from gms_flex_control.discrepancy.residual_views import over_of
from gms_flex_control.effects.registry import find
from gms_flex_control.files import write_text
from gms_flex_control.schema.files import save_robot
import numpy as np

REPORT_FORMAT = 2
_COMMENT_WIDTH = 90
_LEAST = 1e-4     # change of a known parameter that is reported
_TORQUES = ('before', 'retuned', 'after', 'floor')
_OF_GAP = (*_TORQUES, 'rest_before', 'rest_after', 'free_before', 'free_after', 'free_floor')


def report_values(result, *, holdout=(), models=()):
    """
    Return a Discrepancy as plain data, without the search behind it.

    Parameters
    ----------
    result : Discrepancy
        What to report.
    holdout : sequence of str
        Recordings the gap was measured on, if not on blocks held out.
    models : sequence of Compared
        Models compared beside it.

    Returns
    -------
    dict
        Of str, int, float, bool, None, list and dict; a number that is not finite is None.
        SI units: torques in N m, free-run errors in rad.

    """
    joints = result.gap.joints if result.gap is not None else ()
    return plain({
        'format': REPORT_FORMAT, 'version': __version__, 'verdict': result.verdict,
        'words': result.words, 'sources': result.sources, 'holdout': holdout,
        'seconds': result.seconds, 'faults': result.faults,
        'findings': [finding_values(finding, joints) for finding in result.findings],
        'minor': [finding_values(finding, joints) for finding in result.minor],
        'credible': [{'effects': [{'effect': effect, 'joint': joint} for effect, joint in
                                  model.effects], 'probability': model.probability}
                     for model in result.models],
        'stand_ins': [{'effect': one.name, 'joint': one.joint, 'values': list(one.values)}
                      for one in result.stand_ins],
        'noise': [one._asdict() for one in result.noise],
        'unexplained': result.unexplained._asdict() if result.unexplained else None,
        'learned': [{'effect': one.effect, 'joint': one.joint, 'formula': one.formula,
                     'error': one.error, 'effective_parameters': one.freedom,
                     'nats': one.held_out.nats} for one in result.learned],
        'gap': gap_values(result.gap) if result.gap is not None else None,
        'recordings': list(result.recordings),
        'retuned': [{'parameter': name, 'joint': joint, 'change': change}
                    for name, joint, change in result.retuned],
        'tried': [one._asdict() for one in result.tried],
        'dependences': [over_values(one) for one in over_of(result)],
        'models': [model_values(model, joints) for model in models]})


def finding_values(finding, joints):
    """Return a Finding as a dict, residuals by the names of ``joints``."""
    return {
        'effect': finding.effect, 'joint': finding.joint,
        'parameters': {value.name: {'value': value.value, 'unit': value.unit, 'low': value.low,
                                    'high': value.high} for value in finding.values},
        'score': finding.score, 'probability': finding.probability,
        'held_out': finding.held_out._asdict(),
        'share': finding.share, 'torque': finding.torque,
        'evidence': finding.evidence, 'runner_up': finding.runner_up,
        'runner_up_score': finding.runner_up_score,
        'confusable_with': finding.confusable_with, 'tells_apart': finding.tells_apart,
        'rms_before': by_joint(joints, finding.rms_before),
        'rms_after': by_joint(joints, finding.rms_after)}


def described(spec):
    """Return an EffectSpec as a dict of effect, joint and parameters by name."""
    names = [parameter.name for parameter in find(spec.name).parameters]
    return {'effect': spec.name, 'joint': spec.joint,
            'parameters': dict(zip(names, spec.values, strict=True))}


def over_values(one):
    """Return an Over as a dict: shares of the residual, and of bins whose band is off zero."""
    models = ('before', 'after', 'nothing_missing')
    return {'joint': one.joint, 'equation': one.equation, 'variable': one.variable,
            'share': dict(zip(models, one.shares, strict=True)),
            'off_zero': dict(zip(models, one.off_zero, strict=True))}


def gap_values(gap):
    """Return a Gap as a dict, each figure by joint."""
    return {name: by_joint(gap.joints, getattr(gap, name)) for name in _OF_GAP} | {
        'energy_ratio': gap.energy_ratio, 'closed_loop': loop_values(gap.closed_loop)}


def loop_values(again):
    """Return a ClosedLoop as a dict, each figure by joint; None as it is."""
    if again is None:
        return None
    return {'sources': again.sources} | {
        name: by_joint(again.joints, getattr(again, name)) for name in _TORQUES}


def model_values(model, joints):
    """Return a Compared as a dict, each figure by joint."""
    return {'model': model.name, 'missing': model.missing,
            'missing_retuned': model.missing_retuned} | {
        name: by_joint(joints, getattr(model, name))
        for name in ('torque', 'torque_retuned', 'free_run', 'free_run_retuned')}


def over_bags_values(result):
    """
    Return what is compared of a Discrepancy over bags, plain values for JSON.

    Parameters
    ----------
    result : Discrepancy
        Of one bag.

    Returns
    -------
    dict
        ``verdict``, ``words``, ``effects`` that matter and ``minor`` ones as text,
        ``unexplained`` in a sentence, ``estimates`` of
        their parameters, ``gap`` by joint, and ``reason``: the faults of bad data, else None.

    """
    gap = result.gap
    return plain({
        'reason': '; '.join(result.faults) or result.words if result.gap is None else None,
        'verdict': result.verdict, 'words': result.words,
        **{name: [f'{one.effect} of {one.joint}' for one in found] for name, found in (
            ('effects', result.findings), ('minor', result.minor))},
        'unexplained': result.unexplained and result.unexplained.sentence,
        'estimates': [_estimate(finding, value) for finding in result.named
                      for value in finding.values],
        'gap': None if gap is None else {
            name: by_joint(gap.joints, getattr(gap, name)) for name in _TORQUES}})


def _estimate(finding, value):
    return {'name': f'{finding.joint}.{finding.effect}.{value.name}', 'unit': value.unit,
            'value': value.value, 'low': value.low, 'high': value.high, 'flags': [],
            'standing': 'found'}


def by_joint(joints, values):
    """Return values (n,) by the names of joints."""
    return {joint: float(value) for joint, value in zip(joints, values, strict=True)}


def plain(value):
    """Return data as JSON knows it: no tuples, no numpy, None for what is not finite."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def as_json(values):
    """Return plain data as strict JSON text."""
    return json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False)


def write_report_values(values, path):
    """Write `report_values` to ``path``, whole or not at all."""
    write_text(path, as_json(values) + '\n')


def write_robot(result, path):
    """
    Write the robot with what was found: a ROS parameter file for nodes and tools.

    Parameters
    ----------
    result : Discrepancy
        With a robot.
    path : str or Path
        Where to.

    """
    save_robot(result.robot, path, comment=_comment(result))


def _comment(result):
    lines = [f'What gms_flex discrepancy {__version__} made of a robot file and of '
             f'{", ".join(result.sources)}.', f'Verdict: {result.verdict}.']
    for heading, findings in (('Effects that were missing', result.findings),
                              ('Small effects', result.minor)):
        if findings:
            lines.append(f'{heading}: ' + '; '.join(named(one) for one in findings) + '.')
    if result.learned:
        lines.append('Learned for what is unexplained: '
                     + '; '.join(one.formula for one in result.learned) + '.')
    changes = [f'{name} of {joint} {100.0 * change:+.2f} %'
               for name, joint, change in result.retuned if abs(change) >= _LEAST]
    if changes:
        lines.append('Known parameters re-tuned: ' + ', '.join(changes) + '.')
    return '\n'.join(part for line in lines for part in wrap(
        line, _COMMENT_WIDTH, subsequent_indent='    '))
