# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex torsion`: how well a flexible joint explains one recorded axis."""

from dataclasses import asdict
import json
import math
from pathlib import Path

from gms_flex_control.cli.output import conclude


def add_parser(subparsers):
    """Add the verb to the tool's parser."""
    parser = subparsers.add_parser(
        'torsion', help='a first flexible-joint model of one recorded axis',
        description='Fit inertia, Coulomb and viscous friction to the torque of one axis, divide '
                    'the torque by a given stiffness, and compare with the measured difference '
                    'of motor and link encoder. For axes that do not act on each other and carry '
                    'no gravity.')
    parser.add_argument('bag', help='bag with angles of both sides and the torque of the motor')
    parser.add_argument('--joint', required=True, help='link name')
    parser.add_argument('--stiffness', required=True, type=float, metavar='K',
                        help='of the joint [N m/rad]')
    parser.add_argument('--motor-inertia', type=float, default=0.0, metavar='J',
                        help='reflected to the joint [kg m^2]; default 0, not known')
    parser.add_argument('--out', metavar='DIR',
                        help='folder for report.html, pictures and robot.yaml')
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.set_defaults(run=run)


def run(args):
    """Print the study, write the report if asked to, and return the exit code."""
    from gms_flex_control.analysis.torsion import study
    from gms_flex_control.bags.reader import read_recording
    from gms_flex_control.reports.torsion import text, torsion_answer, write_torsion_report
    from gms_flex_control.schema.files import save_robot

    found = study(read_recording(args.bag), args.joint, args.stiffness, args.motor_inertia)
    print(json.dumps(as_dict(found), indent=2, allow_nan=False) if args.json else text(found))
    if args.out:
        page = write_torsion_report(found, args.out)
        robot = Path(args.out) / 'robot.yaml'
        save_robot(found.robot, robot, comment=comment(found))
        if not args.json:
            conclude(torsion_answer(found, args.out), {'report': page, 'robot': robot})
    return 0


def comment(study):
    """Return the head of the robot file: what was fitted and what is assumed."""
    given = 'as given' if study.motor_inertia else 'ASSUMED to be half of M + J'
    return (f'First model of {study.joint} from {study.source}, by gms_flex torsion.\n'
            'M + J, coulomb and viscous were fitted to the torque; stiffness as given;\n'
            f'J {given}; Stribeck velocity, block stiffness and attraction are ASSUMED:\n'
            'the data do not identify them.')


def as_dict(study):
    """Return the figures of a TorsionStudy as plain values; no spring is stiffness None."""
    measured, error = study.torque_error
    explanations = [{**asdict(e), 'stiffness': e.stiffness if math.isfinite(e.stiffness)
                     else None} for e in study.explanations]
    return {'joint': study.joint, 'source': study.source, 'samples': len(study.time),
            'inertia': study.inertia, 'motor_inertia': study.motor_inertia,
            'coulomb': study.coulomb, 'viscous': study.viscous,
            'torque': {'rms_measured': measured, 'rms_error': error,
                       'relative_error': error / measured},
            'torsion_offset': study.torsion_offset, 'explanations': explanations}
