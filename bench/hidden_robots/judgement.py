# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Answers judged by what was hidden: right, wrong, and how far the numbers are off."""

from gms_flex_control.params.robot import WHOLE_ARM
import numpy as np

WORKFLOW = 'workflow'  # among those that answer
RIGHT, BELIEF, CONFUSABLE, WRONG, UNEXPLAINED, NOTHING, FAULT = (
    'right', 'belief', 'indistinguishable', 'wrong', 'unexplained', 'nothing', 'fault')
FAR_OFF = 0.04  # what is believed that far from the truth may be named
# effects that are errors of belief: which, of populations.belief_errors
BELIEFS = {
    'stiffness_error': ('stiffness',), 'motor_inertia_error': ('motor_inertia',),
    'link_inertia_error': ('link_inertia', 'coupling'),
    'tip_payload': ('link_inertia', 'coupling'), 'coulomb_error': ('level',),
    'viscous_error': ('viscous',), 'stribeck_error': ('static', 'velocity'),
    'presliding_error': ('blocks',), 'friction_asymmetry': ('asymmetry',),
    'viscous_asymmetry': ('viscous_asymmetry',)}
# effects whose torques are functions of the same things: one stands in for another that is not
# in the catalogue
RELATIVES = (
    {'coulomb_error', 'friction_drift', 'friction_asymmetry', 'position_friction',
     'load_friction', 'stribeck_error', 'presliding_error', 'motor_coulomb', 'viscous_error',
     'shear_thinning'},
    {'viscous_error', 'quadratic_drag', 'motor_viscous', 'spring_damping', 'shear_thinning'},
    {'stiffness_error', 'stiffness_drift', 'spring_cubic', 'spring_hysteresis', 'backlash',
     'actuator_deadzone', 'spring_damping'},
    {'constant_link_torque', 'spring_offset', 'motor_torque_bias', 'friction_asymmetry',
     'gravity_tilt', 'link_encoder_eccentricity'},
    {'link_inertia_error', 'tip_payload', 'motor_inertia_error', 'motor_inertia_coupling',
     'torque_gain', 'stiffness_error', 'actuator_saturation'},
    {'actuator_lag', 'input_delay', 'encoder_skew', 'spring_damping', 'motor_viscous'},
    {'kinematic_error', 'torque_ripple', 'link_encoder_eccentricity'},
    {'spring_hysteresis', 'presliding_error', 'motor_coulomb', 'actuator_deadzone'},
)
_UNIT = {'friction_drift': 'duration', 'stiffness_drift': 'duration'}


def ranked(findings):
    """Return findings (dicts) with the large ones first, else in their order."""
    return sorted(findings, key=lambda one: not one['main'])


def hidden_names(outcome, part='effects'):
    """Return (effect, joint) of what is hidden, list; ``part`` 'effects' or 'clutter'."""
    return [(one['effect'], one['joint']) for one in outcome['truth'][part]]


def names_given(outcome, tool=WORKFLOW):
    """Return (effect, joint) a tool named, the most important first; None if not asked."""
    answers = outcome['answers']
    return [tuple(one) for one in answers[tool]] if tool in answers else None


def is_belief_error(outcome, effect, joint):
    """
    Return whether what is named is an error of belief the robot truly has.

    Of the workflow's findings the sign counts as well.
    """
    errors = outcome['truth']['belief_errors']
    found = [next(iter(one['parameters'].values())) for one in outcome['findings']
             if (one['effect'], one['joint']) == (effect, joint)]
    return any(abs(error) > FAR_OFF and (not found or not found[0] or error * found[0] > 0.0)
               for kind in BELIEFS.get(effect, ())
               for error in (one[kind] for name, one in errors.items()
                             if joint in (name, WHOLE_ARM)))


def not_believed(outcome):
    """Return the findings (dicts) that are no errors of belief the robot truly has."""
    return [one for one in outcome['findings']
            if not is_belief_error(outcome, one['effect'], one['joint'])]


def judged(outcome, tool=WORKFLOW):
    """
    Return what the first name given by a tool is worth, of an outcome with one main effect.

    'right' (effect and joint), 'belief' (a parameter that truly is far from what is believed),
    'indistinguishable' (another, which the answer says to be so from the right one), 'wrong',
    'unexplained', 'nothing' found, or 'fault' of data or tool.
    """
    given, hidden = names_given(outcome, tool), hidden_names(outcome)[0]
    if tool == WORKFLOW and outcome['verdict'] in ('bad_data', 'error'):
        return FAULT
    if given:
        if given[0] == hidden:
            return RIGHT
        if is_belief_error(outcome, *given[0]):
            return BELIEF
        if tool == WORKFLOW:
            first = ranked(outcome['findings'])[0]
            if list(hidden) in first['indistinguishable_from']:
                return CONFUSABLE
        return WRONG
    if tool == WORKFLOW and outcome['verdict'] == 'unexplained':
        return UNEXPLAINED
    return NOTHING


def holds_truth(outcome):
    """
    Return whether the credible set has the hidden effects, and no others, in one of its models.

    Errors of belief that the robot truly has may be there or not.
    """
    hidden = set(hidden_names(outcome))
    return any({tuple(one) for one in model['effects'] if tuple(one) in hidden
                or not is_belief_error(outcome, *one)} == hidden for model in outcome['models'])


def unrelated(first, second):
    """Return whether two effects (str) are neither the same nor relatives."""
    return first != second and not any(first in group and second in group
                                       for group in RELATIVES)


def parameter_error(outcome):
    """Return the relative error of the first parameter of a rightly named effect, or None."""
    hidden = outcome['truth']['effects'][0]
    for one in outcome['findings']:
        if (one['effect'], one['joint']) == (hidden['effect'], hidden['joint']):
            found, true = (_size(hidden['effect'], values['parameters'])
                           for values in (one, hidden))
            return abs(found / true - 1.0) if true and found is not None else None
    return None


def _size(effect, parameters):
    """Return the first parameter, per unit of the one that only sets its unit."""
    values = {name: value for name, value in parameters.items() if value is not None}
    if len(values) < len(parameters):
        return None
    size = next(iter(values.values()))
    return size / values[_UNIT[effect]] if effect in _UNIT else size


def energy_ratio(outcome):
    """
    Return held-out residual energy above the floor, after / before; None if unknown.

    Before means that the known parameters are re-tuned already.
    """
    gap = outcome['gap']
    if not gap or None in (*gap['retuned'], *gap['after'], *gap['floor']):
        return None
    before, after, floor = (np.array(gap[name]) for name in ('retuned', 'after', 'floor'))
    above = float(np.sum(np.maximum(before ** 2 - floor ** 2, 0.0)))
    left = float(np.sum(np.maximum(after ** 2 - floor ** 2, 0.0)))
    return left / above if above > 0.0 else None


def free_ratio(outcome):
    """Return the rms of the free run's error, after / before; None if unknown."""
    before, after, _ = _free_errors(outcome)
    return after / before if before and after is not None else None


def free_ratio_above_truth(outcome):
    """
    Return the free run's error above that of the true robot, after / before; None if unknown.

    Also where the model without effects errs no more than the truth does.
    """
    before, after, floor = _free_errors(outcome)
    if None in (before, after, floor) or before <= floor:
        return None
    return float(np.sqrt(max(after ** 2 - floor ** 2, 0.0) / (before ** 2 - floor ** 2)))


def _free_errors(outcome):
    """Return errors of free runs (rms of all joints) before, after and of the truth, or None."""
    gap = outcome['gap'] or {}
    return [float(np.linalg.norm(gap[name])) if None not in gap.get(name, [None]) else None
            for name in ('free_before', 'free_after', 'free_true')]
