# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Files for machines: report.json, and friction.yaml for controller, plant and tools."""

from dataclasses import replace
import math
from pathlib import Path

from gms_flex_control import __version__
from gms_flex_control.data.conditions import NAME, with_found
from gms_flex_control.file_io import plain, write_text
from gms_flex_control.identification import outcome
from gms_flex_control.params.robot import RobotParams, UNCERTAIN
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.files import save_values, wrapped
import numpy as np

REPORT_FORMAT = 1
_BY_JOINT = ('motor_inertia', 'stiffness', 'damping')  # of the arm's kinds, one number each
# times what is usual: intervals know nothing of what a model lacks, nor of other days
_LEAST_SD, _MOST_SD = 0.5, 4.0


def report_json(identification: outcome.Identification) -> dict:
    """Return an identification as plain data for JSON, without the long arrays; None for NaN."""
    words = identification.in_units
    return plain({
        'format': REPORT_FORMAT, 'version': __version__, 'sources': identification.sources,
        'holdouts': identification.holdouts,
        'duration': identification.duration,
        'period': identification.period, 'seconds': identification.seconds,
        'warnings': plain(identification.warnings, words),
        'joints': [plain(_joint(result), words) for result in identification.joints],
        'others': plain(_estimates(identification.others), words)})


def _joint(result):
    return {
        'joint': result.joint, 'side': result.side,
        'summary': [text for text, _ in outcome.joint_sentences(result)],
        'estimates': _estimates(result),
        'candidates': [candidate._asdict() for candidate in result.candidates],
        'held_out': result.held_out._asdict(), 'warnings': result.warnings}


def _estimates(result):
    return [estimate._asdict() | {'standing': outcome.standing(estimate)}
            for estimate in result.estimates]


def condition_files(identification: outcome.Identification, folder) -> dict:
    """Return by number of a source where `write_conditions` writes what was found of it."""
    names = [Path(bag).name for bag in identification.sources]
    return {r: Path(folder) / f'{name}{f"_{r + 1}" * (names.count(name) > 1)}.{NAME}'
            for r, name in enumerate(names)
            if identification.constants or r in identification.loads}


def write_conditions(identification: outcome.Identification, folder) -> None:
    """Write a recording.yaml with the torque constants and loads found, for bags that need it."""
    motors = dict(zip(identification.robot.joints, identification.robot.motors, strict=True))
    for r, path in condition_files(identification, folder).items():
        write_text(path, with_found(identification.sources[r], identification.constants,
                                    identification.loads.get(r), motors))


def friction_values(identification: outcome.Identification) -> dict:
    """
    Return the flat parameters that were identified.

    Names of joints and motors, friction of all joints, and what else the fit has changed; of a
    robot that no file has described, the whole arm. A joint the fit made rigid, for want of a
    trusted spring, keeps motor and stiffness of the believed robot.
    """
    found = robot_values(identification.robot)
    believed = robot_values(identification.believed)
    values = {name: believed[name] for name in ('joints', 'motors')}
    for name, value in found.items():
        part = name.split('.')[0]
        if part in ('friction', 'identified_from') or (
                part == 'arm' and not identification.described) or (
                part in ('arm', 'effects') and value != believed.get(name)
                and not (name.endswith('.stiffness') and math.isinf(value))):
            values[name] = value
    for prefix in (f'friction.{joint}.' for joint in identification.robot.joints):
        # blocks at the end that carry nothing are left out
        count = 1 + max(i for i, weight in enumerate(values[f'{prefix}weight']) if weight > 0.0)
        for name in ('stiffness', 'weight'):
            values[prefix + name] = values[prefix + name][:count]
    return values | {f'uncertainty.{joint}.{kind}': sd
                     for (kind, joint), sd in uncertainty_of(identification).items()}


# of kinds of UNCERTAIN, the estimates that tell how well they are known
_OF_ARM, _OF_FRICTION = (
    {name: kind.known_by.removeprefix(part) for name, kind in UNCERTAIN.items()
     if kind.known_by.startswith(part)} for part in ('arm.', 'friction.'))


def uncertainty_of(identification: outcome.Identification) -> dict[tuple[str, str], float]:
    """
    Return how well friction and arm are known, by (kind, joint) as a robot has it, from intervals.

    Relative standard deviations, the largest where the data leave all estimates of a kind open.
    """
    values = _uncertainty_of_arm(identification)
    for result in identification.joints:
        for kind, name in _OF_FRICTION.items():
            own = [one for one in result.estimates if one.name.startswith('friction.')
                   and one.name.split('.')[-1].partition('[')[0] == name]
            sizes = [outcome.spread(one) / outcome.CONFIDENT for one in own
                     if not one.flags and one.value]
            sizes = [size for size in sizes if np.isfinite(size) and size > 0.0]
            if not sizes and any(outcome.standing(one) in (
                    outcome.NOT_IDENTIFIABLE, outcome.DOUBTFUL) for one in own):
                sizes = [np.inf]
            if sizes:
                usual = UNCERTAIN[kind].sd
                values[kind, result.joint] = float(np.clip(
                    np.median(sizes), _LEAST_SD * usual, _MOST_SD * usual))
    return values


def with_friction_of(robot: RobotParams, identification: outcome.Identification) -> RobotParams:
    """Return a robot with the friction identified, known as well as its intervals say."""
    joints = {one.joint for one in identification.joints}
    known = {key: sd for key, sd in robot.uncertainty.items()
             if key[0] not in _OF_FRICTION or key[1] not in joints}
    known |= {key: sd for key, sd in uncertainty_of(identification).items()
              if key[0] in _OF_FRICTION}
    return replace(robot, friction=identification.robot.friction, uncertainty=known)


def _uncertainty_of_arm(identification):
    """
    Return the same of links and motors.

    What the data determine by itself is as sure as its interval says. Links that carry each other
    are known together, but priors are independent: they are no less sure than what is left open.
    What stays as it was described, the data being no better, stays as sure as that is.
    """
    values, arm = {}, identification.robot.arm
    for result in identification.joints:
        j = identification.robot.joints.index(result.joint)
        named = {one.name: one for one in result.estimates}
        found = {kind: named.get(f'arm.{result.joint}.{name}') for kind, name in _OF_ARM.items()}
        sizes = {kind: np.inf if one.flags else outcome.spread(one) / outcome.CONFIDENT
                 for kind, one in found.items() if one and one.value and not (
                     one.flags and _is_as_described(identification, kind, j))}
        if identification.spread is not None:
            weight, inertia, motor = identification.spread[:, j]
            sizes |= {'gravity': min(weight, _MOST_SD * UNCERTAIN['gravity'].sd),
                      'inertia': min(inertia, _MOST_SD * UNCERTAIN['inertia'].sd)}
            if arm.rigid[j]:
                sizes['motor_inertia'] = motor
        elif 'inertia' in sizes and arm.rigid[j]:  # is that of the motor as well
            motor = arm.motor_inertia[j]
            of_link = found['inertia'].value - motor
            sizes['inertia'] = np.inf if of_link <= 0.0 else np.hypot(
                sizes['inertia'] * found['inertia'].value,
                UNCERTAIN['motor_inertia'].sd * motor) / of_link
        for kind, size in sizes.items():
            usual = UNCERTAIN[kind].sd
            values[kind, result.joint] = float(max(
                size if np.isfinite(size) else _MOST_SD * usual, _LEAST_SD * usual))
    return values


def _is_as_described(identification, kind, j):
    """Return whether a kind of parameter of the j-th joint is what the user's file says."""
    own, described = (getattr(one.arm, kind, None) for one in (
        identification.robot, identification.believed))
    return identification.described and kind in _BY_JOINT and own[j] == described[j]


def write_friction(identification: outcome.Identification, path) -> None:
    """Write friction.yaml: a ROS parameter file to be loaded after the robot's own."""
    save_values(friction_values(identification), path, comment=_comment(identification))


def _comment(identification):
    lines = [f'Friction identified by gms_flex identify {__version__}.',
             'Load it after the robot file: [robot.yaml, friction.yaml].',
             f'{outcome.data_sentence(identification)}.',
             *identification.warnings]
    for result in identification.joints_and_others:
        lines.append(f'{result.joint}:' + (
            '' if result is identification.others else
            f' held-out torque error {outcome.percent(result.held_out.relative)}, with '
            f'Coulomb + viscous alone {outcome.percent(result.held_out.coulomb_viscous)}'))
        lines += [f'  {outcome.short_name(estimate.name, result.joint)}: '
                  f"{', '.join(estimate.flags).upper()}; {estimate.note}".rstrip('; ')
                  for estimate in result.estimates if estimate.flags]
    return wrapped(lines)
