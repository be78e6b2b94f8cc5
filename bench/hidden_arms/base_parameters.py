# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Base parameters of hidden arms beside ordinary least squares on the same recordings.

    .venv/bin/python -m bench base-parameters --seeds 0:20

Ordinary least squares is what FIGAROH does: angles through a Butterworth filter, central
differences, regressor and torque decimated, friction of Coulomb, viscous part and offset by
joint, all joints alike, standard deviations as if samples were independent. A second arm has
flexible joints and GMS friction; its stiffnesses are found first.
"""

from dataclasses import replace
from functools import partial
import json
from typing import NamedTuple

from bench.hidden_arms.hidden_arms import NOISES, robot_near
from bench.hidden_arms.plant import recording_of
from bench.hidden_arms.wrong_links import ARM, base_values, hidden_arm, moved
from bench.hidden_robots.hide import seeds_of
from gms_flex_control import load_robot
from gms_flex_control.answer import align
from gms_flex_control.cli.options import add_verb, number, option, Verb
from gms_flex_control.compiled import in_one_thread
from gms_flex_control.file_io import write_text
from gms_flex_control.identification.arm_fit import with_motors
from gms_flex_control.identification.arm_regression import fit_base_parameters
from gms_flex_control.identification.inertial_parameters import (
    all_parameters,
    base_of,
    link_regressors,
)
from gms_flex_control.identification.motor_equation import motor_equation_of
from gms_flex_control.params.arm import Body
import numpy as np
from scipy.signal import butter, decimate, filtfilt

LOAD = Body(30.0, np.array([0.02, -0.01, 0.12]), np.diag([0.4, 0.3, 0.2]))
KNOWN = 0.05          # relative standard deviation below which a parameter counts as known
_ORDER, _CUTOFF, _DECIMATED = 4, 20.0, 10  # filter of angles [Hz]; samples of which one is kept
_CONFIDENT = 1.96     # standard deviations of a 95 % interval


class Score(NamedTuple):
    """What base parameters of one arm, one way, are like."""

    known: int      # parameters whose relative standard deviation says they are known
    worst: float    # largest relative error of these
    usual: float    # their median relative error
    held: float     # share of 95 % intervals of these that hold the truth


def ordinary_least_squares(recording, arm) -> tuple[np.ndarray, np.ndarray]:
    """Return base parameters and their standard deviations (B,) as FIGAROH finds them."""
    period, n = recording.period, arm.n_joints
    cutoff = butter(_ORDER, 2.0 * period * _CUTOFF)
    angle = filtfilt(*cutoff, recording.q_link, axis=0)
    rate = np.gradient(angle, period, axis=0)
    columns = link_regressors(angle, rate, np.gradient(rate, period, axis=0), arm)[
        :, :, base_of(arm)[0]]
    own = np.zeros((len(angle), n, 3 * n))
    for j in range(n):
        own[:, j, 3 * j:3 * j + 3] = np.stack(
            [np.sign(rate[:, j]), rate[:, j], np.ones(len(rate))], axis=1)
    inner = slice(5 * _ORDER * _DECIMATED, -5 * _ORDER * _DECIMATED)  # ends of filters
    table, torque = (decimate(part[inner], _DECIMATED, axis=0) for part in (
        np.concatenate([columns, own], axis=2), recording.tau_motor))
    table, torque = table.reshape(-1, table.shape[2]), torque.ravel()
    size = np.linalg.norm(table, axis=0)
    values = np.linalg.lstsq(table / size, torque, rcond=1e-10)[0] / size
    left = torque - table @ values
    inverse = np.linalg.pinv((table / size).T @ (table / size), rcond=1e-12, hermitian=True)
    error = np.sqrt(left @ left / (len(left) - len(values)) * np.diag(inverse)) / size
    return values[:columns.shape[2]], error[:columns.shape[2]]


def score_of(values, error, truth) -> Score:
    """Return the Score of values and standard deviations (B,)."""
    known = error < KNOWN * np.abs(values)
    off = np.abs(values - truth)
    relative = (off / np.maximum(np.abs(truth), np.abs(values)))[known]
    return Score(int(known.sum()), float(relative.max()), float(np.median(relative)),
                 float(np.mean(off[known] < _CONFIDENT * error[known])))


def scores_of(seed: int, seconds: float) -> dict:
    """Return the Scores of one hidden arm by way."""
    robot, arm, urdf = hidden_arm(seed)
    bare, heavy = (moved(urdf, robot.arm, seconds, seed=2 * seed + k, load=load)
                   for k, load in enumerate((None, LOAD)))
    one, two = (fit_base_parameters(recordings, robot) for recordings in ([bare], [bare, heavy]))
    truth = base_values(arm)
    return {'one recording': score_of(one.values, one.error, truth),
            'with and without a load': score_of(two.values, two.error, truth),
            'flexible joints': flexible_score(seed, seconds),
            'ordinary least squares': score_of(*ordinary_least_squares(bare, robot.arm), truth)}


def flexible_score(seed: int, seconds: float) -> Score:
    """Return the Score of the arm with flexible joints, links and friction some 1 % off."""
    believed, rng = load_robot(ARM), np.random.default_rng(seed)
    true = robot_near(believed, rng)
    recording = recording_of(true, believed, seconds=seconds, seed=seed,
                             noise=float(rng.choice(NOISES)), motors_only=False)
    motors = [motor_equation_of([recording], j).fit() for j in range(believed.n_joints)]
    fit = fit_base_parameters([recording], replace(
        believed, arm=with_motors(believed.arm, motors)))
    return score_of(fit.values, fit.error, base_of(believed.arm)[1] @ all_parameters(true.arm))


VERB = Verb(
    'base-parameters', lambda args: run(args),
    'links that a URDF has wrong, beside ordinary least squares',
    'Move six-axis arms whose links are 10 to 30 % off in MuJoCo, find their base parameters '
    'three ways, print errors and how often intervals hold.', (
        option('--seeds', default='0:20', metavar='A:B', help='of arms and motions'),
        number('--seconds', 'S', 16.0, 'of each recording'),
        option('--out', metavar='FILE', help='scores as JSON')), ())
add_parser = partial(add_verb, VERB)


def run(args) -> int:
    """Print the table; return 0."""
    seeds = seeds_of(args.seeds)
    with in_one_thread():
        scores = [scores_of(seed, args.seconds) for seed in seeds]
    if args.out:
        write_text(args.out, json.dumps(
            [{way: one._asdict() for way, one in each.items()} for each in scores],
            indent=1) + '\n')
    rows = []
    for way in scores[0]:
        own = [each[way] for each in scores]
        known = np.array([one.known for one in own])
        held = known @ [one.held for one in own] / known.sum()
        within = np.mean([one.worst < 0.03 for one in own])
        rows.append([way, f'{known.mean():.1f}', f'{np.median([one.usual for one in own]):.2%}',
                     f'{np.median([one.worst for one in own]):.1%}',
                     f'{max(one.worst for one in own):.1%}', f'{within:.0%}', f'{held:.1%}'])
    print(align(['way', 'known', 'median error', 'worst of an arm, median', 'worst',
                 'arms all within 3 %', 'intervals that hold'], rows))
    return 0
