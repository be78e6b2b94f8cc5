# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A discrepancy as plain values, report.json, robot.yaml, and rows of text."""

from gms_flex_control import __version__
from gms_flex_control.discrepancy.describe import angle_scale, named, torque_scale
from gms_flex_control.discrepancy.residual_views import over_of
from gms_flex_control.effects.registry import find
from gms_flex_control.file_io import plain
from gms_flex_control.schema.files import save_robot, wrapped

REPORT_FORMAT = 2
_LEAST = 1e-4     # change of a known parameter that is reported
_TORQUES = ('before', 'retuned', 'after', 'floor')
_OF_GAP = (*_TORQUES, 'rest_before', 'rest_after', 'free_before', 'free_after', 'free_floor')


def report_values(result, *, holdout=(), models=()) -> dict:
    """Return a Discrepancy as plain data for JSON, in SI units, ``models`` Compared beside it."""
    joints = result.gap.joints if result.gap is not None else ()
    return plain({
        'format': REPORT_FORMAT, 'version': __version__, 'verdict': result.verdict,
        'words': result.words, 'sources': result.data.sources, 'holdout': holdout,
        'seconds': result.searched.seconds, 'faults': result.data.faults,
        'findings': [_finding_values(finding, joints) | {'added': finding in result.added}
                     for finding in result.findings],
        'minor': [_finding_values(finding, joints) for finding in result.minor],
        'credible': [{'effects': [{'effect': effect, 'joint': joint} for effect, joint in
                                  model.effects], 'probability': model.probability}
                     for model in result.searched.models],
        **{name: [{'effect': one.name, 'joint': one.joint, 'values': list(one.values)}
                  for one in getattr(result, name)] for name in (
                      'stand_ins', 'identified_beside')},
        'noise': [one._asdict() for one in result.data.noise],
        'unexplained': result.unexplained._asdict() if result.unexplained else None,
        'learned': [{'effect': one.effect, 'joint': one.joint, 'formula': one.formula,
                     'error': one.error, 'effective_parameters': one.freedom,
                     'nats': one.held_out.nats} for one in result.learned],
        'gap': _gap_values(result.gap) if result.gap is not None else None,
        'recordings': list(result.data.differences),
        'retuned': [{'parameter': name, 'joint': joint, 'change': change}
                    for name, joint, change in result.retuned],
        'tried': [one._asdict() for one in result.searched.tried],
        'dependences': [over_values(one) for one in over_of(result)],
        'models': [{'model': one.name, 'missing': one.missing,
                    'missing_retuned': one.missing_retuned} | {
            name: _by_joint(joints, getattr(one, name))
            for name in ('torque', 'torque_retuned', 'free_run', 'free_run_retuned')}
            for one in models]})


def _finding_values(finding, joints):
    return {
        'effect': finding.effect, 'joint': finding.joint,
        'parameters': {value.name: {'value': value.value, 'unit': value.unit, 'low': value.low,
                                    'high': value.high} for value in finding.values},
        'score': finding.score, 'probability': finding.probability,
        'held_out': finding.held_out._asdict(),
        **{name: getattr(finding, name) for name in (
            'share', 'torque', 'evidence', 'runner_up', 'runner_up_score')},
        'indistinguishable_from': [{'effect': effect, 'joint': joint}
                                   for effect, joint in finding.indistinguishable_from],
        'discriminated_by': finding.discriminated_by,
        'rms_before': _by_joint(joints, finding.residual.before),
        'rms_after': _by_joint(joints, finding.residual.after)}


def described(spec) -> dict:
    """Return an EffectSpec as a dict of effect, joint and parameters by name."""
    names = [parameter.name for parameter in find(spec.name).parameters]
    return {'effect': spec.name, 'joint': spec.joint,
            'parameters': dict(zip(names, spec.values, strict=True))}


def over_values(one) -> dict:
    """Return an Over as a dict: shares of the residual, and of bins whose band is off zero."""
    models = ('before', 'after', 'nothing_missing')
    return {'joint': one.joint, 'equation': one.equation, 'variable': one.variable,
            'share': dict(zip(models, one.shares, strict=True)),
            'off_zero': dict(zip(models, one.off_zero, strict=True))}


def _gap_values(gap):
    again = gap.closed_loop
    return {name: _by_joint(gap.joints, getattr(gap, name)) for name in _OF_GAP} | {
        'energy_ratio': gap.energy_ratio,
        'closed_loop': None if again is None else {'sources': again.sources} | {
            name: _by_joint(again.joints, getattr(again, name)) for name in _TORQUES}}


def _by_joint(joints, values):
    return {joint: float(value) for joint, value in zip(joints, values, strict=True)}


def write_robot(result, path, words=str) -> None:
    """Write the robot with what was found, a ROS parameter file; ``words`` changes its units."""
    save_robot(result.robot, path, comment=words(_comment(result)))


def _comment(result):
    lines = [f'What gms_flex discrepancy {__version__} made of a robot file and of '
             f'{", ".join(result.data.sources)}.', f'Verdict: {result.verdict}.']
    for heading, findings in (('Effects that were missing', result.added),
                              ('Found, but not added', result.not_added),
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
    return wrapped(lines)


def _scales(compared):
    """Return the scales of torques and free-run errors, as given and re-tuned."""
    torque = torque_scale([one.torque for one in compared])
    angle = angle_scale([one.free_run for one in compared])
    return torque, torque, angle, angle


def comparison_rows(compared, joints) -> tuple:
    """Return header and rows of a table of models, in units that suit."""
    header = ['model']
    scales = _scales(compared)
    for what, scale in zip(('torque', 're-tuned', 'free run', 're-tuned'), scales, strict=True):
        header += [f'{what} {joint} [{scale.unit}]' for joint in joints]
    header += ['missing', 're-tuned']
    rows = [[one.name, *(scale.text(value) for scale, values in zip(scales, one[1:5], strict=True)
                         for value in values),
             f'{one.missing:.3g}', f'{one.missing_retuned:.3g}'] for one in compared]
    return header, rows


def comparison_text(compared, joints) -> str:
    """Return the models as lines of text, a block for each."""
    lines, (torque, _, angle, _) = [], _scales(compared)
    for one in compared:
        lines.append(f'{one.name}: missing {one.missing:.3g}, re-tuned {one.missing_retuned:.3g}')
        for j, joint in enumerate(joints):
            lines.append(
                f'  {joint}: residual torque {torque.text(one.torque[j])} (re-tuned '
                f'{torque.text(one.torque_retuned[j])}) {torque.unit}, free run '
                f'{angle.text(one.free_run[j])} ({angle.text(one.free_run_retuned[j])}) '
                f'{angle.unit}')
    return '\n'.join([*lines, 'missing: mean square of the whitened residuals above that of null '
                      'simulations'])
