# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Learned terms: physical by construction, found in hidden robots, absent from clean ones."""

from dataclasses import replace
import json
from types import SimpleNamespace

from bench.hidden_robots import outsiders
from bench.hidden_robots.cases import make_case
from core_runs import effect_on
from gms_flex_control.compiled import compiled
from gms_flex_control.control.feedforward import as_parameters
from gms_flex_control.discrepancy.learned_words import described, formula_of
from gms_flex_control.discrepancy.learning import learn
from gms_flex_control.discrepancy.result import UNEXPLAINED
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.effects import base as sig
from gms_flex_control.effects import learned, registry, table
from gms_flex_control.effects.base import Stage
from gms_flex_control.errors import ParameterError
from gms_flex_control.reports.answers import discrepancy_answer
from gms_flex_control.reports.discrepancy_values import report_values, write_robot
from gms_flex_control.schema.files import load_robot, save_robot
import numpy as np
import pytest

HEIGHT, PLACE, WIDTH = 0.05, 0.1, 0.08  # of the hidden bump [N m, rad, rad]
KNOTS = learned.KNOTS
# (lowest, highest, ...) of each kind: a range of the variable within the cycles below
RANGES = {'learned_position': (-0.5, 0.7, 1.0, 24.0), 'learned_torsion': (-0.5, 0.7, 0.0, 6.0),
          'learned_rate_friction': (0.0, 5.0, 1.0, 24.0, 0.02),
          'learned_position_friction': (-0.5, 0.7, 2.0, 24.0, 0.01),
          'learned_position_drag': (-0.5, 0.7, 0.0, 3.0, 0.02),
          'learned_load_friction': (0.0, 2.0, 1.0, 24.0, 0.02),
          'learned_hysteresis': (0.002, 0.5), 'learned_resonance': (2.0, 16.0, 0.05)}
SIGNALS = {Stage.LINK: sig.LINK_TORQUE, Stage.SPRING: sig.SPRING, Stage.FRICTION: sig.FRICTION}


def spec_of(name, weights, joint='joint1'):
    """Return a term with weights (K,) and the ranges above."""
    return effect_on(joint, name, *map(float, weights), *RANGES[name])


def positive(name, rng):
    """Return random weights that a kind allows, some of them zero."""
    kind = registry.find(name)
    weights = rng.uniform(0.0, 0.1, kind.count) * (rng.random(kind.count) < 0.7)
    return weights if kind.parameters[0].lower == 0.0 else weights - 0.05


@compiled
def along(stage, signal, q, rate, load, dt, constants, signals, memory, out):
    """Fill torques (T,) that a term adds to a signal; its angle and torsion are q (T,)."""
    for k in range(len(q)):
        signals[0, :] = 0.0
        signals[0, sig.Q_LINK], signals[0, sig.DQ_LINK] = q[k], rate[k]
        signals[0, sig.TORSION] = q[k]
        before = load[k] if signal != sig.SPRING else 0.0
        signals[0, sig.SPRING] = before
        table.run_stage(stage, signals, memory, dt, constants)
        out[k] = signals[0, signal]


def energy_given(spec, q, load, dt):
    """Return the energy that a term gives along a motion q (T,), and what it moves either way."""
    kind = registry.find(spec.name)
    out, steps = np.empty(len(q)), np.diff(q)
    # a body acts over the step that it foresees, friction by rate over the step behind
    ahead, behind = spec.name == 'learned_resonance', spec.name.endswith(('drag', 'rate_friction',
                                                                         'load_friction'))
    rate = np.append(steps, 0.0) if ahead else np.append(0.0, steps)
    along(int(kind.stage), SIGNALS[kind.stage], q, rate / dt, load, dt,
          table.build([spec], ['joint1']), np.zeros((1, sig.WIDTH)),
          np.zeros(table.MEMORY_SIZE), out)
    force = out if kind.stage == Stage.LINK else -out
    mean = force[:-1] if ahead else force[1:] if behind else 0.5 * (force[1:] + force[:-1])
    power = mean * steps
    return power.sum(), np.abs(power).sum()


@pytest.mark.parametrize('name', RANGES)
def test_random_closed_cycles_give_no_energy(name):
    """Each begins and ends at rest at the same place; loads are whatever they like."""
    rng, dt = np.random.default_rng(3), 1e-3
    time = np.arange(2001) * dt
    for _ in range(1000):
        orders, sizes = rng.integers(1, 9, 4), rng.uniform(-0.15, 0.15, 4)
        q = rng.uniform(-0.3, 0.5) + sum(size * (1.0 - np.cos(2.0 * np.pi * order * time / 2.0))
                                         for size, order in zip(sizes, orders, strict=True))
        load = 2.0 * np.sin(rng.uniform(1.0, 30.0) * time + rng.uniform(0.0, 6.0))
        given, moved = energy_given(spec_of(name, positive(name, rng)), q, load, dt)
        assert given <= 2e-3 * moved, (given, moved)
        if name in ('learned_position', 'learned_torsion'):
            assert given >= -2e-3 * moved


@pytest.mark.parametrize('name', [name for name in RANGES if registry.find(
    name).parameters[0].lower == 0.0])
def test_a_negative_weight_is_refused_where_it_could_give_energy(name):
    kind = registry.find(name)
    weights = [-0.01] + [0.0] * (kind.count - 1)
    given = dict(zip((one.name for one in kind.parameters), (*weights, *RANGES[name]),
                     strict=True))
    with pytest.raises(ParameterError, match='w01 must be a number from 0'):
        kind.values(given, name)


def test_a_curve_is_zero_or_flat_beyond_its_range_or_repeats():
    rng, weights = np.random.default_rng(1), np.random.default_rng(1).normal(size=KNOTS)
    x = np.sort(rng.uniform(-3.0, 3.0, 300))
    for knots in (KNOTS, 3):
        inner, outer, y = (np.linspace(-1.0, 1.0, knots + 2), np.linspace(-1.0, 1.0, knots),
                           weights[:knots])
        for ends, expected in (
                (0.0, np.interp(x, inner, [0.0, *y, 0.0])), (1.0, np.interp(x, outer, y)),
                (2.0, np.interp(x, np.linspace(-1.0, 1.0, knots, endpoint=False), y,
                                period=2.0))):
            p = np.array([*weights, -1.0, 1.0, ends, knots])
            assert np.allclose([learned.curve(at, p) for at in x], expected, atol=1e-12)


def test_terms_come_back_from_a_robot_file_as_they_were(robot, tmp_path):
    rng = np.random.default_rng(2)
    effects = tuple(spec_of(name, positive(name, rng), 'joint2') for name in RANGES)
    save_robot(replace(robot, effects=effects), tmp_path / 'robot.yaml')
    assert set(load_robot([tmp_path / 'robot.yaml']).effects) == set(effects)
    kept = {one.name for one in as_parameters(replace(robot, effects=effects)).effects}
    assert kept == {'learned_position', 'learned_position_friction', 'learned_hysteresis'}


X = np.linspace(-1.0, 2.0, 300)


@pytest.mark.parametrize('shape, y, numbers', [
    ('bump', 0.04 * np.exp(-((X - 0.31) / 0.1) ** 2) + 0.01, (0.04, 0.31, 0.1)),
    ('step', 0.02 * np.tanh((X - 0.7) / 0.02), (0.04, 0.7, 0.02)),
    ('tanh', 0.02 * np.tanh((X - 0.4) / 0.5), (0.04, 0.4, 0.5)),
    ('sine', 0.03 * np.sin(6.0 * X + 0.4), (0.03, 6.0)),
    ('linear', 0.02 * X + 0.01, (0.02,)), ('quadratic', 0.02 * (X - 0.5) ** 2, (0.02,)),
    ('constant', np.full_like(X, 0.02), (0.02,))])
def test_a_curve_is_put_into_words_by_what_it_was_made_of(shape, y, numbers):
    found = formula_of(X, y + 2e-4 * np.random.default_rng(0).normal(size=len(X)))
    assert found.shape == shape and found.error < 0.05
    assert np.allclose(np.abs(found.numbers[:len(numbers)]), np.abs(numbers), rtol=0.05, atol=0.01)


@pytest.mark.parametrize('name, words', [
    ('learned_rate_friction', '1.2 N per m/s'), ('learned_hysteresis', '1.2 N in all'),
    ('learned_resonance', '1.2 kg at')])
def test_of_a_linear_axis_words_are_of_forces_and_metres(name, words):
    """The curve rises by 1.2 N over 1 m/s; weights of the others add up to 1.2."""
    count = registry.find(name).count
    weights, ends = (np.linspace(0.0, 6.0, count), RANGES[name]) if name == (
        'learned_rate_friction') else (np.full(count, 1.2 / count), RANGES[name])
    spec = effect_on('slide', name, *weights, *ends)
    arm = SimpleNamespace(axes='linear')
    assert words in described(spec, (0.0, 5.0) if name == 'learned_rate_friction' else None,
                              arm)[0]


@pytest.fixture(scope='module')
def bump():
    """Return a case with a hidden bump, what is found without a name, and what is learned."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(outsiders, 'draw_values', lambda rng, name, k: (HEIGHT, PLACE, WIDTH))
        case = make_case('outside', 0, effect='local_bump', plant='stiff', duration=30.0)
    found = find_discrepancy([case.recording], case.nominal, SearchOptions(most=1),
                             holdout=[case.held_out])
    return case, found, learn(found, holdout=[case.held_out])


def test_a_hidden_bump_is_recovered_at_its_place_with_its_height(bump):
    case, found, result = bump
    assert found.verdict == UNEXPLAINED
    term, = result.learned
    assert (term.effect, term.joint) == ('learned_position', case.truth.outsider_joint)
    spec = next(one for one in result.robot.effects if one.name == term.effect)
    seen = case.recording.q_link[:, result.robot.joints.index(term.joint)]
    x = np.linspace(max(seen.min(), PLACE - 3 * WIDTH), min(seen.max(), PLACE + 3 * WIDTH), 200)
    curve = np.array([learned.curve(one, np.array(spec.values)) for one in x])
    truth = HEIGHT * np.exp(-((x - PLACE) / WIDTH) ** 2)
    off = curve - truth
    assert np.std(off) < 0.1 * HEIGHT  # a constant is also the friction's
    assert abs(x[np.argmax(curve)] - PLACE) < 0.02
    assert abs(np.ptp(curve) - np.ptp(truth)) < 0.15 * HEIGHT
    assert 'bump' in term.formula and term.error < 0.2


def test_with_the_bump_learned_held_out_torque_and_free_runs_are_closer(bump):
    _, found, result = bump
    before, after = found.gap, result.gap
    excess = [np.sum(np.maximum(one.after ** 2 - one.floor ** 2, 0.0)) for one in (before, after)]
    assert excess[1] < 0.3 * excess[0]
    assert np.sum(after.free_after ** 2) < 0.6 ** 2 * np.sum(before.free_after ** 2)


def test_what_was_learned_is_in_the_files_and_the_report_says_how_to_learn(bump, tmp_path):
    _, found, result = bump
    values = json.loads(json.dumps(report_values(result)))
    assert values['learned'][0]['formula'] == result.learned[0].formula
    assert 'Learned, without a name: a torque over the link angle' in result.words
    write_robot(result, tmp_path / 'robot.yaml')
    assert load_robot([tmp_path / 'robot.yaml']).effects == result.robot.effects
    assert 'bump' in (tmp_path / 'robot.yaml').read_text()
    assert '--learn' in discrepancy_answer(found, tmp_path).command
    assert '--learn' not in discrepancy_answer(result, tmp_path).command
