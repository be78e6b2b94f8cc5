# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`python -m bench torsion`: whether a spring or a delay explains the torsion of an axis."""

from dataclasses import asdict
from functools import partial
import json
import math
from pathlib import Path

from bench.real_machines.torsion import rms, study
from gms_flex_control.answer import align, Answer, command, measured
from gms_flex_control.cli.options import add_verb, JSON, option, Verb
from gms_flex_control.cli.terminal import conclude
from gms_flex_control.data.reader import read_recording
from gms_flex_control.reports.page import Report, Series
from gms_flex_control.schema.files import save_robot
import numpy as np

VERB = Verb(
    'torsion', lambda args: torsion(args), 'a first flexible-joint model of one recorded axis',
    'Fit inertia, Coulomb and viscous friction to the torque of one axis, divide the torque by a '
    'given stiffness, and compare with the measured difference of motor and link encoder. For '
    'axes that do not act on each other and carry no gravity.', (
        option('bag', help='bag with angles of both sides and the torque of the motor'),
        option('--joint', required=True, help='link name'),
        option('--stiffness', required=True, type=float, metavar='K',
               help='of the joint [N m/rad]'),
        option('--motor-inertia', type=float, default=0.0, metavar='J',
               help='reflected to the joint [kg m^2]; default 0, not known'),
        option('--out', metavar='DIR', help='folder for report.html, pictures and robot.yaml'),
        JSON), ())
add_parser = partial(add_verb, VERB)


def torsion(args) -> int:
    """Fit a first flexible-joint model, write the report if asked to; return 0."""
    found = study(read_recording(args.bag), args.joint, args.stiffness, args.motor_inertia)
    print(json.dumps(_torsion_values(found), indent=2, allow_nan=False) if args.json
          else torsion_text(found))
    if args.out:
        page = write_torsion_report(found, args.out)
        robot = Path(args.out) / 'robot.yaml'
        given = 'as given' if found.motor_inertia else 'ASSUMED to be half of M + J'
        save_robot(found.robot, robot, comment=(
            f'First model of {found.joint} from {found.source}, by python -m bench torsion.\n'
            'M + J, coulomb and viscous were fitted to the torque; stiffness as given;\n'
            f'J {given}; Stribeck velocity, block stiffness and attraction are ASSUMED:\n'
            'the data do not identify them.'))
        if not args.json:
            conclude(torsion_answer(found, args.out),
                     {'report': page, 'robot': robot})
    return 0


def _torsion_values(found):
    """Return the figures of a TorsionStudy as plain values; no spring is stiffness None."""
    measured, error = found.torque_error
    explanations = [asdict(one) | {
        'stiffness': one.stiffness if math.isfinite(one.stiffness) else None}
        for one in found.explanations]
    return {'joint': found.joint, 'source': found.source, 'samples': len(found.time),
            'inertia': found.inertia, 'motor_inertia': found.motor_inertia,
            'coulomb': found.coulomb, 'viscous': found.viscous,
            'torque': {'rms_measured': measured, 'rms_error': error,
                       'relative_error': error / measured},
            'torsion_offset': found.torsion_offset, 'explanations': explanations}


def torsion_text(study) -> str:
    """Return a TorsionStudy as lines of text."""
    measured_rms, error = study.torque_error
    first = study.explanations[0]
    return '\n'.join([
        f'{study.source}, {study.joint}: {len(study.time)} samples, '
        f'{int(study.moving.sum())} of them moving',
        f'inertia M + J {study.inertia:.5g} kg m^2, J taken as {study.motor_inertia:.5g}; '
        f'Coulomb {study.coulomb[0]:.4g} / {study.coulomb[1]:.4g} N m forward / backward, '
        f'viscous {study.viscous:.4g} N m s/rad',
        f'motor torque: rms measured {measured_rms:.4g} N m, rms error {error:.4g} N m, relative '
        f'error {error / measured_rms:.3f}',
        f'torsion: rms measured {_mdeg(rms(study.torsion)):.4g} mdeg, rms error '
        f'{_mdeg(first.rms_error):.4g} mdeg, relative error {first.relative_error:.3f} (mean of '
        f'{_mdeg(study.torsion_offset):.4g} mdeg taken off)',
        '', align(*_explanations(study)), '', torsion_verdict(study)])


def _explanations(study):
    header = ['torsion explained by', 'stiffness [N m/rad]', 'delay [ms]', 'rms error [mdeg]',
              'relative error']
    return header, [
        [e.name, f'{e.stiffness:.4g}' if np.isfinite(e.stiffness) else '-',
         f'{1e3 * e.delay:.3f}', f'{_mdeg(e.rms_error):.3f}', f'{e.relative_error:.3f}']
        for e in study.explanations]


def torsion_verdict(study) -> str:
    """Return in a sentence or two what the torsion shows."""
    spring, delay, both, free = study.explanations
    lines = []
    if delay.relative_error < spring.relative_error:
        lines.append(f'A delay of {1e3 * delay.delay:.2f} ms between the encoders explains the '
                     'torsion better than the spring does: it is not flexibility.')
    if both.relative_error >= delay.relative_error:
        lines.append('With the delay, the given spring does not improve the model: these data do '
                     'not confirm its stiffness.')
    if free.stiffness < 0:
        lines.append('With the delay, the best spring has negative stiffness: what remains is '
                     'not the torsion of a spring.')
    return ' '.join(lines) or 'The given spring explains the torsion better than a delay does.'


def torsion_answer(study, folder) -> Answer:
    """Return what the torsion shows (Answer), robot.yaml of the study being in ``folder``."""
    *constrained, free = study.explanations
    return Answer(
        f'{torsion_verdict(study)} The floor is what spring and delay together leave, both free.',
        ('measured', 'left', 'floor'), tuple(
            measured(f'{one.name} [mdeg]', *np.degrees((rms(study.torsion), one.rms_error,
                                                        free.rms_error))) for one in constrained),
        command('discrepancy', study.source, '--robot', Path(folder) / 'robot.yaml', '--out',
                Path(folder) / 'gap'))


def write_torsion_report(study, folder) -> Path:
    """Write report.html of a TorsionStudy to a folder, and return its path."""
    folder = Path(folder)
    report = Report(f'Torsion of {study.joint}', torsion_answer(study, folder),
                    f'{study.source}: flexible joint of a decoupled axis, measured and modelled')
    group = f'torsion {study.source}'
    delayed = study.explanations[1].delay * (study.velocity - study.velocity.mean())
    report.chart(
        'torsion: motor - link, without its mean', study.time, [
            Series('measured', _mdeg(study.torsion), role='c0'),
            Series('spring torque / stiffness', _mdeg(study.torsion_model), role='reference',
                   dashed=True),
            Series('delay between the encoders', _mdeg(delayed), role='c2')],
        y_label='torsion [mdeg]', group=group)
    report.heading('Motor torque').chart(
        'torque', study.time, [
            Series('measured', study.torque, role='c0'),
            Series('inertia and friction', study.torque_model, role='reference', dashed=True),
            Series('error', study.torque - study.torque_model, role='c1', hidden=True)],
        y_label='torque [N m]', group=group)
    report.table(*_explanations(study), caption='What explains the torsion')
    return report.write(folder / 'report.html')


def _mdeg(values):
    return 1e3 * np.degrees(values)
