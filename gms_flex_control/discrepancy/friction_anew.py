# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Friction identified anew beside what was found to be missing.

Friction that was identified along the same recordings has taken up part of what the model lacks: a
Stribeck curve as wide as motion is fast, blocks too soft, Coulomb friction of another level. What
that spoils has names of its own. Beside effects, friction is identified as it is, and the search
that begins from there needs fewer of them. Joints of an arm in space are identified one by one:
those on which the effects do not act keep the friction they have.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from gms_flex_control.discrepancy.describe import listed
from gms_flex_control.discrepancy.gap import HeldOut
from gms_flex_control.discrepancy.result import Discrepancy
from gms_flex_control.discrepancy.thresholds import BETTER, NOT_CLEARLY, PRACTICAL
from gms_flex_control.effects import table as effect_table
from gms_flex_control.effects.base import Stage, Term
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.output import with_friction_of
from gms_flex_control.params.key import SMALLEST
from gms_flex_control.params.robot import RobotParams, with_effects
import numpy as np

_ROUNDS = 3  # of identification at most: joints that act on each other need more than one


def with_friction_anew(search: Callable, recordings: Sequence, robot: RobotParams,
                       widened: float, say: Callable) -> Discrepancy:
    """
    Return the Discrepancy with the friction that predicts best beside what it names.

    ``search`` RobotParams -> Discrepancy. That of ``robot`` is returned unless its friction was
    identified along the ``recordings``; ``widened`` as for `identify`.
    """
    found = search(robot)
    if not {one.identity for one in recordings} <= set(robot.identified_from):
        return found
    before, given, beside, failed = found.gap.before, robot, (), set()
    for _ in range(_ROUNDS):
        kept, others = _beside(found, robot, beside)
        others = [spec for spec in others if spec.key not in failed]
        if not others or not _leaves_something(found):
            break
        tried = (*kept, others[0])
        joints = _acted_on(found, given, beside, tried)
        if not joints:
            failed.add(others[0].key)
            continue
        say(f'friction anew, beside {listed(tried)}')
        try:
            anew = _identified(recordings, given, tried, widened, joints)
            other = search(anew)
        except GmsFlexError:  # what was found is an answer as well
            break
        if _is_better(other, found):
            found, given, beside = other, anew, tried
        else:
            failed.add(others[0].key)
        del other  # two searches fill the memory
    if not beside:
        return found
    return replace(found, gap=replace(found.gap, before=before), identified_beside=beside).saying(
        f'Friction was identified anew beside {listed(beside)}: the values given had taken up '
        'some of it.')


def _beside(found, robot, before):
    """
    Return the EffectSpecs of ``before`` that are still found, and others to go beside them.

    What friction takes up by itself is not among these. Most of what acts on friction only mends
    what another effect has spoilt, so it comes after others. Those come first that are of joints
    which nothing explains: there what only resembles the cause may be it.
    """
    given = {spec.key for spec in robot.effects}
    specs = {spec.key: spec for spec in found.robot.effects if spec.key not in given}
    kept = [specs.pop(spec.key) for spec in before if spec.key in specs]
    named = [specs[one.key] for one in found.added if one.key in specs]
    open_joints = found.unexplained.joints if found.unexplained else ()

    def rank(spec):
        kind = find(spec.name)
        acts_on_friction = issubclass(kind, Term) and kind.stage == Stage.FRICTION
        if spec.joint in open_joints:
            return 0, acts_on_friction, spec not in named
        return 1, spec not in named, acts_on_friction
    return kept, sorted((spec for spec in (*named, *found.stand_ins)
                         if spec.key in specs and find(spec.name).acts_along_motion
                         and not effect_table.changes_friction(spec, robot)), key=rank)


def _leaves_something(found):
    """Return whether more than one effect is there, or clearly more than noise is left."""
    return (found.is_open or len(found.named) + len(found.stand_ins) > 1
            or found.gap.is_above_floor(BETTER))


def _is_better(other, found):
    """
    Return whether a Discrepancy has fewer effects than another, or predicts clearly better.

    Neither torque nor free runs are clearly worse. Friction was fitted to what the gap is measured
    on, unless that is another recording: more effects fit that alone. So it has more of them only
    beside something that is left, and each predicts clearly better. Where something is left, it
    names something if the other does.
    """
    if other.is_open and found.added and not other.added:
        return False
    more = len(other.robot.effects) - len(found.robot.effects)
    if more > 0 and not found.is_open:
        return False
    gains = np.nan_to_num([_gain(name, floor, other.gap, found.gap) for name, floor in (
        ('after', 'floor'), ('free_after', 'free_floor'))])
    clearly = np.log1p(NOT_CLEARLY)
    return gains.min() > -clearly and (more < 0 or gains.sum() > max(more, 1) * clearly)


def _gain(name, floor, *gaps):
    """
    Return the mean logarithm of what a second Gap leaves over what the first does.

    Down to the noise floor, of which a null simulation of a wrong model says too much: what is
    left is hardly less.
    """
    left, noise = (np.array([getattr(gap, which) for gap in gaps]) for which in (name, floor))
    noise = np.nan_to_num(noise.min(axis=0), nan=SMALLEST)
    left = np.maximum(left, np.minimum(noise, np.sqrt(BETTER) * left.min(axis=0)))
    return float(np.mean(np.log(left[1] / left[0])))


def _acted_on(found, robot, before, beside):
    """
    Return the joints (str) whose friction is another beside effects than beside those ``before``.

    All, where links of a plane are predicted together.
    """
    if robot.arm.frames is None:
        return robot.joints
    likelihood = found.behind.likelihood
    one, two = (likelihood.fitted(with_effects(robot, *specs), np.zeros(
        len(likelihood.nuisances))) for specs in (before, beside))
    acts = HeldOut(likelihood).action(one, two) >= PRACTICAL * likelihood.coulomb
    return tuple(joint for joint, own in zip(robot.joints, acts, strict=True) if own)


def _identified(recordings, robot, beside, widened, joints):
    """Return a robot with friction of ``joints`` (str), and its sd, as found beside effects."""
    found = identify(recordings, with_effects(robot, *beside),
                     options=IdentifyOptions(widened=widened, joints=joints))
    return with_friction_of(robot, found)
