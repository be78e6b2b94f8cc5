# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""From recordings to friction parameters, their intervals and errors: the whole way."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import time
import warnings

from gms_flex_control.compiled import in_one_thread
from gms_flex_control.errors import IdentificationError, own_warnings
from gms_flex_control.identification import assumed_robot
from gms_flex_control.identification.criterion import NEXT_TO_NOTHING, WORTH
from gms_flex_control.identification.friction_fit import fit_beside
from gms_flex_control.identification.outcome import Identification
from gms_flex_control.identification.problem import Problem
from gms_flex_control.identification.recording_checks import OF_ALL, of_all, require, standing
from gms_flex_control.identification.selection import CANDIDATES
from gms_flex_control.identification.unseen_links import (
    driven_by_motors,
    with_links_if_known,
    words_of_computed,
)
from gms_flex_control.params.robot import RobotParams, widened
import numpy as np


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """How to identify."""

    estimate: str = 'friction'   # 'all': inertia, gravity, stiffness, motor inertia as well
    blocks: tuple = CANDIDATES   # numbers of blocks to try
    force: bool = False          # go on in spite of faults in the data
    widened: float = 1.0         # standard deviations of the arm's parameters, times the usual
    joints: tuple = ()           # that are fitted, () all: that of others is right, or, where
    #                              the arm is estimated as well, they are left out
    axes: str = 'rotary'         # or 'linear': of joints of which nothing is known


def identify(recordings: Sequence, robot: RobotParams | None = None, *, holdouts: Sequence = (),
             options: IdentifyOptions | None = None,
             say: Callable[[str], object] | None = None) -> Identification:
    """
    Identify the friction of a robot.

    Parameters
    ----------
    recordings : sequence of Recording or (Recording, sequence of Phase)
        What was recorded, and what the experiment was doing if that is known.
    robot : RobotParams, optional
        The robot as described; its inertia, stiffness and gravity are as sure as its
        `uncertainty` says, its friction is to be found. Without it each joint is a rigid axis of
        which nothing is known and all is estimated; those that stand still are left out.
    holdouts : sequence of Recording or (Recording, sequence of Phase)
        Recordings to predict only; by default blocks of time are held out.
    options : IdentifyOptions, optional
        How.
    say : callable, optional
        Called with what is being done.

    Returns
    -------
    Identification

    Raises
    ------
    IdentificationError
        If the data do not identify the friction, or would bias it; the sentence says why.

    """
    begin, options = time.monotonic(), options or IdentifyOptions()
    say = say or (lambda text: None)
    recordings, holdouts = ([one if isinstance(one, tuple) else (one, ()) for one in several]
                            for several in (recordings, holdouts))
    identities = tuple(one.identity for one, _ in recordings)
    with own_warnings() as caught, in_one_thread():  # joints have threads of their own
        say('checking the data')
        described = robot is not None
        if not described:
            robot, options = _unknown_axes(recordings, options), replace(options, estimate='all')
        whole = options.estimate == 'all'
        if whole and options.joints:
            robot, options = assumed_robot.only_joints(robot, options.joints), replace(
                options, joints=())
        model = assumed_robot.believed_model(widened(robot, options.widened), whole, options.force)
        recordings, holdouts = (
            [(_checked(assumed_robot.as_assumed(one, robot), model, options), phases)
             for one, phases in several] for several in (recordings, holdouts))
        for fault in of_all([one for one, _ in recordings], model):
            warnings.warn(fault.text, stacklevel=2)
        unknown = next((one.source for one, _ in holdouts if one.operation.load_unknown), None)
        if unknown:
            raise IdentificationError(f'{unknown}: its load is unknown, so that nothing can be '
                                      'predicted; give this recording to be fitted as well')
        currents = _currents_of(recordings, robot, whole)
        options = _of_moving_axes(options, [one for one, _ in recordings], model)
        in_space = model.arm.frames is not None
        first = Problem(recordings, holdouts, model, whole=whole, alone=in_space,
                        only=options.joints)
        problem, fits = _fitted(first, options, say)
        if (model.arm.kind == 'planar' and model.n_joints > 1 and not whole
                and problem.unexplained(fits).max() > NEXT_TO_NOTHING):
            say('each joint by itself')  # what the model lacks at one disturbs all together
            problem, fits = _better((problem, fits), _fitted(first.each_alone(), options, say))
        if problem.whole and (thinned := problem.thinned(fits)):
            say('viscous friction that bends')
            bent = _fitted(problem.beside_thinned(thinned), options, say)
            if len(bent[0].found_thinned(bent[1])) == len(thinned):
                problem, fits = _better(
                    (problem, fits), bent, [one.joint for one in thinned])
        if words := problem.words():
            warnings.warn(words, stacklevel=2)
        say('intervals and errors on data held out')
        joints, others, arm = problem.results(fits)
    rigid_body = replace(arm, uncertainty=robot.uncertainty) if whole else robot
    return Identification(
        robot=problem.with_friction(replace(rigid_body, identified_from=identities), fits),
        believed=robot, described=described,
        joints=joints, others=others, sources=tuple(one.source for one, _ in recordings),
        holdouts=tuple(one.source for one, _ in holdouts),
        duration=float(sum(one.time[-1] - one.time[0] for one, _ in recordings)),
        period=problem.bundle.period,
        warnings=tuple(dict.fromkeys(str(item.message) for item in caught)),
        seconds=time.monotonic() - begin, currents=currents,
        spread=problem.arm_fit.spread if whole else None, **problem.found_beside(robot.joints))


def _unknown_axes(recordings, options):
    """Return a robot of axes asked for, by default of those that move; others are warned of."""
    recordings = [one for one, _ in recordings]
    still = () if options.joints else standing(recordings)
    if still:
        warnings.warn(f'{", ".join(one.source for one in recordings)}: no motion of '
                      f'{", ".join(still)}: left out', stacklevel=3)
    robot = assumed_robot.rigid_joints(options.joints or [
        joint for joint in recordings[0].joints if joint not in still])
    return replace(robot, arm=replace(robot.arm, axes=options.axes))


def _checked(recording, model, options):
    """
    Return a Recording with the angles of links that were not seen; IdentificationError if faulty.

    Such links move as their motors drive them.
    """
    whole, seen = options.estimate == 'all', with_links_if_known(recording, model)
    for fault in require(seen, model, force=options.force, rough=whole):
        if fault.kind not in (*OF_ALL, *(('torque_scale',) if whole else ())):
            warnings.warn(fault.text, stacklevel=3)
    if seen is recording:
        return recording
    computed = recording.motors_alone & seen.links_seen
    warnings.warn(words_of_computed(seen, computed), stacklevel=3)
    return driven_by_motors(seen, computed)


def _of_moving_axes(options, recordings, model):
    """Return IdentifyOptions without single axes that stand still: they keep their friction."""
    still = standing([one.of_joints(model.joints) for one in recordings])
    if model.arm.kind != 'decoupled' or options.estimate == 'all' or not still:
        return options
    return replace(options, joints=tuple(
        joint for joint in options.joints or model.joints if joint not in still))


def _fitted(problem, options, say):
    """Return the Problem, and the JointFit of each joint that is chosen."""
    fits = problem.search(options, say)
    if not problem.whole:
        say('links beside this friction')
        problem = problem.beside(fits)
        fits = fit_beside(problem.bundle, fits)
    return problem, problem.choose(fits, say)


def _better(usual, other, joints=()):
    """Return ``other`` Problem and JointFits where they explain more held-out torque of joints."""
    which = [not joints or joint in joints for joint in usual[0].robot.joints]
    left, right = (np.log(problem.unexplained(fits)[which]).mean() for problem, fits in (
        usual, other))
    return other if right < left + np.log(WORTH) else usual


def _currents_of(recordings, robot, whole):
    """Return whether efforts stay currents; IdentificationError where they cannot."""
    unknown = [joint for one, _ in recordings
               for joint, sd in zip(one.joints, one.scale_sd, strict=True)
               if joint in robot.joints and np.isinf(sd)]
    if not unknown or robot.arm.frames is not None:
        return False
    if not whole or robot.arm.kind != 'decoupled' or len(set(unknown)) < robot.n_joints:
        raise IdentificationError(
            f'{recordings[0][0].source}: the torque constant of {unknown[0]} is unknown, but '
            'inertia is in kg m^2: state it as torque_constant in recording.yaml, or leave '
            '--robot away, then all is identified per torque constant')
    return True
