# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex check-gains`: the stability conditions on the controller's gains, as a table."""

from dataclasses import asdict
import json
import math


def add_parser(subparsers):
    """Add the verb to the tool's parser."""
    parser = subparsers.add_parser(
        'check-gains', help='conditions on the gains: value, limit, verdict',
        description='Check the gains against Eq. (39), all rows, against the exact condition per '
                    'joint, and bound the residual set (43). Exit code 1 if a condition fails.')
    parser.add_argument('--robot', nargs='+', metavar='FILE',
                        help='robot files, later ones winning; default: the arm of the paper')
    parser.add_argument('--controller', nargs='+', metavar='FILE',
                        help='controller files, likewise; default: the gains of the paper')
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.set_defaults(run=run)


def run(args):
    """Print the report; return 0, or 1 where a condition does not hold."""
    from gms_flex_control.control.gain_conditions import check
    from gms_flex_control.resources import controller_file, robot_file
    from gms_flex_control.schema.files import load_controller, load_robot

    robot = load_robot(args.robot or robot_file())
    report = check(load_controller(args.controller or controller_file(), robot), robot)
    if args.json:
        print(json.dumps(as_dict(report), indent=2, allow_nan=False))
    else:
        print(text(report))
    return 0 if report.met else 1


def as_dict(report):
    """Return a GainReport as plain values; an infinite bound becomes None."""
    conditions = [{**asdict(c), 'met': c.met} for c in report.conditions]
    return {'met': report.met, 'conditions': conditions,
            'alpha': dict(zip(report.joints, report.alpha.tolist(), strict=True)),
            'mass_eigenvalues': report.mass_range, 'n1_eigenvalues': report.energy_range,
            'disturbance_bound': report.disturbance,
            'residual_bound': report.residual if math.isfinite(report.residual) else None}


def text(report):
    """Return a GainReport as a table and a few lines."""
    rows = [('joint', 'condition', 'value', 'limit', 'verdict')]
    for c in report.conditions:
        verdict = 'ok' if c.met else 'VIOLATED'
        if not c.met and c.kind == 'gershgorin':
            verdict = 'not met (sufficient only)'
        rows.append((c.joint, f'{c.condition}  ({_KINDS[c.kind]})', f'{c.value:.5g}',
                     f'{c.limit:.5g}', verdict))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    lines = [f'{row[0]:<{widths[0]}}  {row[1]:<{widths[1]}}  {row[2]:>{widths[2]}}  '
             f'{row[3]:>{widths[3]}}  {row[4]}'.rstrip() for row in rows]
    alphas = ', '.join(f'{joint} {alpha:.5g}'
                       for joint, alpha in zip(report.joints, report.alpha, strict=True))
    low, high = report.mass_range
    bottom, top = report.energy_range
    return '\n'.join([
        *lines, '',
        f'alpha, smallest eigenvalue of N_2 (37): {alphas}',
        f'eigenvalues over all configurations: M {low:.5g} to {high:.5g} kg m^2, '
        f'N_1 (34) {bottom:.5g} to {top:.5g}',
        *bound_lines(report)])


def bound_lines(report):
    """Return the residual set (43) of a GainReport, and what it is worth, as lines of text."""
    if not math.isfinite(report.residual):
        return ['residual set (43): none, because N_2 is not positive definite; stability is not '
                'guaranteed']
    bottom, top = report.energy_range
    pushed, spread = report.disturbance / report.alpha.min(), math.sqrt(top / bottom)
    return [
        'residual set (43): the norm of all errors together (angles, rates, block torques) ends '
        f'below {report.residual:.4g}.',
        '  Not a prediction: it assumes the largest error of all friction, at once and for ever, '
        'against the weakest',
        f'  damping (D_bar / alpha = {report.disturbance:.4g} / {report.alpha.min():.4g} = '
        f'{pushed:.3g}), and all of that energy in the lightest',
        f'  error (sqrt(lmax / lmin of N_1) = {spread:.3g}). Simulate what to expect: gms_flex '
        'tune, simulate']


_KINDS = {'gershgorin': 'Gershgorin', 'exact': 'exact, N_2 > 0'}
