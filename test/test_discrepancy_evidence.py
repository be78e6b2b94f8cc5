# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The evidence of models: closed forms where all is linear and normal, and what is credible."""

from dataclasses import replace
from types import SimpleNamespace

from core_runs import affected, effect_on
from discrepancy_runs import driven_motion, retuned_of
from gms_flex_control.discrepancy import evidence
from gms_flex_control.discrepancy.evidence import doubted, log_determinant, posterior, state_of
from gms_flex_control.discrepancy.fitting import extended
from gms_flex_control.discrepancy.likelihood import Fitted, Likelihood, Sums
from gms_flex_control.effects.base import Scales, Travel
from gms_flex_control.params.robot import widened, with_effects
import numpy as np
import pytest
from scipy.stats import multivariate_normal

SD = np.array([0.5, 2.0])


class Linear:
    """Rows that are linear in two nuisance parameters, with noise of unit variance."""

    def __init__(self, offset, slopes):
        self._offset, self.slopes_by, self.sd = offset, slopes, SD
        self.known, self.robot = 0, SimpleNamespace(effects=(), joints=('j',), arm=SimpleNamespace(
            rigid=[True], stiffness=[np.inf]))
        self.encoder_noise = self

    def resting(self, robot):
        return np.zeros(2, dtype=bool)

    def weights(self, groups):
        return np.ones(len(self._offset))

    def informative(self, robot, numbers):
        return np.ones((2 + len(numbers), len(self._offset)))

    def sums(self, rows, robot, x, exact=False):
        return Sums(np.array([rows @ rows]), rows @ rows + np.sum((x / SD) ** 2),
                    np.array([False]))

    def likeliest(self):
        """Return the Fitted at the likeliest nuisance parameters."""
        a, y = self.slopes_by, self._offset
        x = np.linalg.solve(a @ a.T + np.diag(1.0 / SD ** 2), -a @ y)
        rows = y + x @ a
        return Fitted(self.robot, x, [], rows, self.sums(rows, self.robot, x))


@pytest.mark.parametrize('seed', range(3))
def test_the_evidence_of_a_linear_normal_model_is_exact(seed):
    """Y = -x A + noise with x ~ N(0, sd^2): y ~ N(0, 1 + A' diag(sd^2) A), and so its density."""
    rng = np.random.default_rng(seed)
    slopes = rng.standard_normal((2, 12)) * [[1.0], [0.2]]
    y = rng.standard_normal(12) - (SD * rng.standard_normal(2)) @ slopes
    given = Linear(y, slopes)
    state = state_of(given, given.likeliest(), slopes, 50)
    exact = multivariate_normal.logpdf(y, cov=np.eye(12) + (slopes.T * SD ** 2) @ slopes)
    assert state.evidence == pytest.approx(2.0 * exact + 12.0 * np.log(2.0 * np.pi), rel=1e-9)


def test_an_effect_has_the_odds_of_one_among_all_against_it():
    """The same rows with one effect more whose parameter changes nothing, and none that counts."""
    rng = np.random.default_rng(1)
    slopes = rng.standard_normal((2, 12))
    given = Linear(rng.standard_normal(12), slopes)
    model = given.likeliest()
    few, many = (state_of(given, model, slopes, count).evidence for count in (2, 200))
    assert few == many  # no effect, no odds
    reported = SimpleNamespace(name='motor_torque_bias', joint='j', values=(0.0,))
    with_one = Fitted(SimpleNamespace(**vars(given.robot) | {'effects': (reported,)}), model.x, [],
                      model.whitened, model.sums)
    given.scales_of = lambda joint: Scales(0.1, 1.0, 0.0, 0.0, 1.0, 0.01, 0.1,
                                           Travel(-1.0, 1.0, 2.0), 20.0)
    columns = np.concatenate([slopes, np.zeros((1, 12))])
    one = [state_of(given, with_one, columns, count).evidence for count in (2, 200)]
    assert one[0] - one[1] == pytest.approx(2.0 * np.log(100.0))
    assert few - one[1] == pytest.approx(2.0 * np.log(200.0))


@pytest.mark.parametrize('ratio', [-0.5, 0.3])
def test_a_softer_spring_has_less_density_where_noise_is_not_of_encoders(robot, gains, ratio):
    """Each torsion counts log(1 + ratio), where variance is a hundred times null simulations'."""
    likelihood = Likelihood([driven_motion(robot, gains, seed=1, duration=6.0)], robot)
    spec = effect_on('joint2', 'stiffness_error', ratio)
    model = likelihood.fitted(with_effects(robot, spec), np.zeros(len(likelihood.sd)))
    sums = model.sums._replace(groups=100.0 * likelihood.groups.count)
    torsions = np.sum(likelihood.groups.channel == 1)  # of two joints, link equations first
    assert log_determinant(likelihood, replace(model, sums=sums)) == pytest.approx(
        torsions * np.log1p(ratio), rel=0.05)
    assert log_determinant(likelihood, likelihood.fitted(robot, model.x)) == pytest.approx(0.0)


@pytest.mark.parametrize('noise', [0.0, 0.02])
def test_a_robot_of_which_all_torques_are_believed_less_explains_nothing(robot, gains, noise):
    """
    Whatever acts on links, less torque of all that is read leaves less of it.

    Nor where some of it is taken for noise of drives [N m].
    """
    hidden = affected(robot, 'joint2', 'position_friction', 0.35, 3.0, 0.0)
    likelihood = Likelihood([driven_motion(hidden, gains, seed=1, duration=6.0)],
                            widened(robot, 100.0))
    likelihood = likelihood.with_noise(np.full((1, 4), noise))
    less = np.array([-0.6 * (one.name in ('inertia', 'stiffness', 'motor_inertia', 'level',
                                          'viscous', 'blocks'))
                     for one in likelihood.nuisances])
    weak = replace(robot,
                   effects=tuple(effect_on(joint, 'torque_gain', -0.6) for joint in robot.joints))
    weaker, believed = (
        state_of(likelihood, model, np.zeros((len(less) + len(model.robot.effects),
                                              len(model.whitened))), 50)
        for model in (likelihood.fitted(weak, less), likelihood.fitted(robot, 0.0 * less)))
    assert weaker.evidence < believed.evidence


def test_a_saturation_takes_all_that_is_beyond_its_limit(robot, gains):
    """Of a drive that gives half of what is beyond, a saturation would have to be smaller."""
    limit = 0.12
    saturation = affected(robot, 'joint2', 'actuator_saturation', limit)
    whole, free = (driven_motion(one, gains, seed=1, duration=10.0) for one in (saturation, robot))
    asked = free.samples.command.copy()
    asked[:, 1] += asked[:, 1] - np.clip(asked[:, 1], -limit, limit)
    for motion, half in ((whole, False), (free.with_torque('asked', lambda command: asked), True)):
        likelihood = Likelihood([motion], robot)
        model = likelihood.fitted(saturation, np.zeros(len(likelihood.sd)))
        columns = extended(likelihood, model, retuned_of(likelihood)[1])
        assert np.mean(np.abs(motion.samples.command[:, 1]) > limit) > 0.05
        assert evidence.is_of_other_size(likelihood, model, columns, 50) == half


def state(likely, *effects):
    """Return a State of effects (name, joint) with 2 log evidence."""
    specs = tuple(effect_on(joint, name) for name, joint in effects)
    robot = SimpleNamespace(effects=specs)
    return evidence.State(SimpleNamespace(robot=robot), None, None, likely)


A, B = ('a', 'joint1'), ('b', 'joint2')


def test_probabilities_of_models_sum_to_one_and_follow_the_evidence():
    """Odds of exp(half a difference); equal sets count once, at their best."""
    found = posterior([state(0.0), state(4.0, A), state(6.0, A, B), state(5.0, B, A)], 0)
    assert [names for names, _ in found] == [{A, B}, {A}, set()]
    shares = np.array([share for _, share in found])
    assert shares.sum() == pytest.approx(1.0)
    assert shares[0] / shares[1] == pytest.approx(np.exp(1.0))
    assert shares[1] / shares[2] == pytest.approx(np.exp(2.0))
    assert posterior([state(-1e5, A), state(-2e5, B)], 0)[0][1] == pytest.approx(1.0)
    assert [names for names, _ in posterior([state(0.0, A), state(1.0, A, B)], 1)] == [{B}, set()]


def test_the_likeliest_model_has_even_odds_with_effects_that_matter_in_no_prediction():
    states = [state(1.0), state(4.0, A), state(40.0, A, B), state(30.0, B)]
    odds = dict(posterior(states, 0, {B}))
    assert list(odds)[:2] == [{A, B}, {A}]
    assert odds[frozenset({A})] == odds[frozenset({A, B})] == pytest.approx(0.5, abs=0.01)
    assert odds[frozenset({B})] / odds[frozenset({A, B})] == pytest.approx(np.exp(-5.0))
    assert dict(posterior(states[:1], 0, {B})) == {frozenset(): 1.0}


@pytest.mark.parametrize(('shares', 'mass', 'count'), [
    ((0.96, 0.04), 0.95, 1), ((0.5, 0.3, 0.2), 0.75, 2), ((0.5, 0.3, 0.2), 0.95, 3),
    ((0.94, 0.02, 0.02, 0.02), 0.95, 2), ((1.0,), 0.95, 1)])
def test_the_credible_set_is_the_smallest_that_holds_enough(shares, mass, count):
    models = [(frozenset({(str(k), 'j')}), share) for k, share in enumerate(shares)]
    chosen = evidence.credible(models, mass)
    assert chosen == models[:count]
    assert sum(shares[:count]) >= mass > sum(shares[:count - 1])


def test_what_held_out_data_deny_counts_no_more_than_what_is_left():
    """Evidence of 30 for an effect that predicts worse: even odds, and others as they were."""
    kept = [state(10.0), state(4.0, B)]
    tried = [*kept, state(40.0, A), state(34.0, A, B)]
    odds = dict(posterior(doubted(kept, tried, 0), 0))
    assert odds[frozenset({A})] == pytest.approx(odds[frozenset()])
    for other, one in (({B}, ()), ({A, B}, {A})):
        assert odds[frozenset(other)] == pytest.approx(np.exp(-3.0) * odds[frozenset(one)])
    faint = [*kept, state(2.0, A)]
    assert posterior(doubted(kept, faint, 0), 0) == posterior(faint, 0)
