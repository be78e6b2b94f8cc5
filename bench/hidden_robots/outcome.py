# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""One hidden robot tried: what the workflow and its peers answer, as plain values."""

import math
import resource
import sys
import time

from bench.hidden_robots import peers
from bench.hidden_robots.cases import make_case
from bench.hidden_robots.hide import truth_values
from bench.hidden_robots.judgement import judged, ranked, RIGHT, WORKFLOW
from gms_flex_control.discrepancy.evidence import state_of
from gms_flex_control.discrepancy.fitting import refitted, retuned
from gms_flex_control.discrepancy.gap import free_runs
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.search import count_of
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.params.robot import with_effects
from gms_flex_control.simulation import plant
import numpy as np

# what a numerical failure raises; it counts against the tool and does not end the bench
_FAILURES = (GmsFlexError, ArithmeticError, LookupError, ValueError)


def try_job(job, with_peers=True):
    """
    Draw a hidden robot and ask the workflow, and its peers if wanted, what is hidden.

    Return ``key``, ``truth``, ``answers`` (tool -> list of [effect, joint]), ``verdict``,
    ``findings``, ``models``, ``noise``, ``gap``, ``seconds``, ``megabytes``; ``error`` where the
    workflow failed; ``truth_gains`` of a missed single effect, see `gain_of_truth` (dict).
    """
    case = make_case(job.kind, job.seed, population=job.population, plant=job.plant,
                     duration=job.duration)
    without = tuple(spec.name for spec in case.truth.effects) if job.kind == 'deleted' else ()
    outcome = {'key': job.key, 'truth': truth_values(case.truth), 'answers': {}}
    answer, result = ask_workflow(case, without)
    outcome |= answer
    if outcome['gap']:
        outcome['gap']['free_true'] = free_error_of_truth(case)
    outcome['megabytes'] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1024.0 if sys.platform != 'darwin' else 1024.0 ** 2)
    outcome['answers'][WORKFLOW] = [[one['effect'], one['joint']] for one in ranked(
        outcome['findings'])]
    if job.kind == 'single' and result is not None and judged(outcome) != RIGHT:
        outcome['truth_gains'] = gain_of_truth(result, *case.truth.effects)
    if with_peers:
        answers, error = ask_peers(case, without)
        outcome['answers'] |= answers
        if error:
            outcome['peer_error'] = error
    return finite(outcome)


def ask_workflow(case, without):
    """
    Return what the workflow says of a Case, asked without the effects named.

    As plain values (dict), and its Discrepancy, None where it failed.
    """
    options = SearchOptions(without=without) if without else SearchOptions()
    begin = time.perf_counter()
    try:
        result = find_discrepancy([case.recording], case.nominal, options, holdout=[case.held_out])
    except _FAILURES as error:
        return {'error': f'{type(error).__name__}: {error}', 'verdict': 'error', 'findings': [],
                'models': [], 'noise': [], 'gap': None,
                'seconds': time.perf_counter() - begin}, None
    seconds = time.perf_counter() - begin
    return {'verdict': result.verdict, 'seconds': seconds, 'gap': gap_of(result.gap),
            'findings': [{
                'effect': one.effect, 'joint': one.joint, 'main': bool(one.main),
                'score': float(one.score), 'probability': float(one.probability),
                'held_out': one.held_out._asdict(), 'torque': float(one.torque),
                'parameters': {name: float(value) for name, value in one.parameters.items()},
                'runner_up': str(one.runner_up),
                'indistinguishable_from': list(map(list, one.indistinguishable_from))}
                for one in result.named],
            'models': [{'effects': [list(one) for one in model.effects],
                        'probability': float(model.probability)}
                       for model in result.searched.models],
            'noise': [one._asdict() for one in result.data.noise]}, result


def ask_peers(case, without):
    """Return what each peer names, lists of [effect, joint], and '' or why none of them does."""
    try:
        return {name: [list(one) for one in answer]
                for name, answer in peers.ask(case, without).items()}, ''
    except _FAILURES as error:
        return {name: [] for name in peers.names()}, f'{type(error).__name__}: {error}'


def gain_of_truth(result, effect):
    """
    Return 2 log evidence of the true effect over nothing, all fitted; None if unknown.

    Below thresholds.EVIDENCE the data do not speak for it.
    """
    if result.behind is None:
        return None
    likelihood = result.behind.likelihood
    try:
        nothing, own = retuned(likelihood, likelihood.robot, result.behind.before.x)
        begin = with_effects(likelihood.robot, effect)
        with_it, without_it = (
            state_of(likelihood, *state, count_of(likelihood, ()))
            for state in (refitted(likelihood, begin, nothing.x, own), (nothing, own)))
    except _FAILURES:
        return None
    return with_it.evidence - without_it.evidence


def free_error_of_truth(case):
    """
    Return the rms error of free runs of the true robot of a Case, list per joint [rad].

    Along the recording held out, as the gap has it of a model: runs begin at what encoders read,
    and nobody knows the noise of the drives, so no model has less but by chance.
    """
    robot = case.truth.robot
    _, link, motor = free_runs(motion_of(case.held_out, robot), plant.constants_of(robot))
    return np.sqrt(np.mean(link ** 2 + motor ** 2, axis=(0, 1)) / 2.0).tolist()


def gap_of(gap):
    """Return the gap of a result as lists of floats, None where there is none."""
    if gap is None:
        return None
    return {name: [float(value) for value in getattr(gap, name)]
            for name in ('retuned', 'after', 'floor', 'free_before', 'free_after')}


def finite(value):
    """Return plain values with None for every number that is not finite."""
    if isinstance(value, dict):
        return {name: finite(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
