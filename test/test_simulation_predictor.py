# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The predictor of an identification: against the plant, finite differences, closed forms."""

from dataclasses import dataclass, replace

from core_runs import effect_on, push_plant
from gms_flex_control import friction as gms
from gms_flex_control import records
from gms_flex_control.dynamics import chain
from gms_flex_control.identification.coordinates import Coordinates, friction_record, MOST_BLOCKS
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import (
    EncoderParams,
    FrictionParams,
    RobotParams,
    STRIBECK,
    StribeckParams,
)
from gms_flex_control.simulation import plant, predictor
import numpy as np
import pytest

PERIOD = 1e-3
STEADY = {'static': [0.108, 0.104], 'coulomb': [0.094, 0.090], 'velocity': [0.05, 0.04],
          'viscous': [0.066, 0.074], 'attraction': 1.5}
YIELDS = [3e-4, 2e-3, 1e-2]
OBSERVER, DRIFTING = 20.0, 2.0  # rad/s, s
FINE, OFF = 256, 2e-5  # steps of the plant in a sample; of 0.2 to 0.4 rad of travel [rad]
COUNT = 1e-9           # so small that readings are as exact as without [rad]


def arm_of(kind, n):
    """Return a rigid arm of n unlike links."""
    return ArmParams(kind=kind, mass=np.full(n, 0.8), length=np.full(n, 0.3), com=np.full(n, 0.2),
                     inertia=np.linspace(0.03, 0.02, n), motor_inertia=np.full(n, 0.01),
                     stiffness=np.full(n, np.inf), damping=np.zeros(n))


def params_of(record):
    """Return the FrictionParams of a record of the kernels."""
    sides = [StribeckParams(**{name: getattr(record, name)[row] for name in STRIBECK})
             for row in range(2)]
    return FrictionParams(forward=sides[0], backward=sides[1], stiffness=record.stiffness,
                          weight=record.weight, attraction=record.attraction)


@dataclass(frozen=True, eq=False)
class Case:
    """An arm, the parameters of its joints and the torque on it; what `predict` is called with."""

    arm: ArmParams
    torque: np.ndarray
    joint: int = 0
    n_extra: int = 0
    gain: float = OBSERVER
    drift: float = 0.0  # relative, of friction over DRIFTING

    @property
    def n(self):
        return self.arm.n_joints

    @property
    def coordinates(self):
        return Coordinates(len(YIELDS), free_weights=True, n_extra=self.n_extra)

    def free(self, joint=0):
        """Return the free numbers of a joint, each joint a little unlike the others."""
        extra = [0.01, -0.02][:self.n_extra]
        steady = {name: np.multiply(value, np.exp(0.05 * joint))
                  for name, value in STEADY.items()}
        return self.coordinates.pack(**steady, yields=YIELDS, weights=np.array([0.5, 0.3, 0.2]),
                                     extra=extra)

    @property
    def extra(self):
        """Return further torques that vary over time (T, R)."""
        time = PERIOD * np.arange(len(self.torque))
        return np.stack([np.sin(3.0 * time), np.cos(5.0 * time)], axis=1)[:, :self.n_extra].copy()

    @property
    def factor(self):
        """Return by what an effect multiplies friction (T, n)."""
        time = PERIOD * np.arange(len(self.torque))
        return np.ones((len(time), self.n)) + (
            self.drift * np.minimum(time / DRIFTING, 1.0))[:, None]

    def friction(self, free=None):
        thetas = [self.coordinates.unpack(self.free(j))[0] for j in range(self.n)]
        if free is not None:
            thetas[self.joint] = self.coordinates.unpack(free)[0]
        return friction_record(thetas)

    def gains(self):
        return np.stack([np.full(self.n, 2.0 * self.gain), np.full(self.n, self.gain ** 2)])

    def predict(self, angle, free=None, half=0.0, rate=None):
        """Return predicted angles, innovations (T, n) and jacobian (T, P)."""
        theta, directions = self.coordinates.unpack(self.free(self.joint) if free is None
                                                    else free)
        predicted, innovation = np.empty((2, *angle.shape))
        jacobian = np.empty((len(angle), len(directions[0])))
        planar = range(self.n) if self.arm.kind == 'planar' else [self.joint]
        carried = np.array([self.joint, *(j for j in planar if j != self.joint)])
        predictor.predict(
            np.ascontiguousarray(angle), np.zeros(self.n) if rate is None else rate,
            self.torque, self.factor, self.extra, theta[len(theta) - self.n_extra:], PERIOD,
            chain.constants_of(self.arm), self.friction(free), carried, directions,
            self.gains(), np.full(self.n, half), self.state(), plant.workspace(self.n),
            predicted, innovation, jacobian)
        return predicted, innovation, jacobian

    def state(self):
        return records.build(gms.state_layout(self.n, MOST_BLOCKS))

    def driven(self, substeps=1):
        """Return angles and rates (T, n) of the plant under the torque, from rest at zero."""
        names = tuple(f'joint{j + 1}' for j in range(self.n))
        effects = tuple(effect_on(name, 'friction_drift', self.drift, DRIFTING) for name in names)
        robot = RobotParams(joints=names, motors=('',) * self.n, arm=self.arm, effects=effects,
                            friction=params_of(self.friction()), encoder=EncoderParams())
        theta, _ = self.coordinates.unpack(self.free(self.joint))
        command = self.torque.copy()
        command[:, self.joint] += self.extra @ theta[len(theta) - self.n_extra:]
        run = push_plant(robot, command[:-1], PERIOD, substeps=substeps)
        start = np.zeros((1, 2, self.n))
        return np.moveaxis(np.concatenate([start, run[:, :2]]), 1, 0)


def torque_of(n, seconds=3.0):
    """Return torques (T, n) from zero that stick, break away, slide and turn."""
    time = PERIOD * np.arange(round(seconds / PERIOD))
    return np.stack([(0.11 + 0.08 * np.sin(3.0 * time)) * np.sin((2.1 - 0.6 * j) * time)
                     for j in range(n)], axis=1)


CASES = {
    'one joint': Case(arm_of('decoupled', 1), torque_of(1)),
    'further torques': Case(arm_of('decoupled', 1), torque_of(1), n_extra=2),
    'second of two decoupled': Case(arm_of('decoupled', 2), torque_of(2), joint=1),
    'second of two coupled': Case(arm_of('planar', 2), torque_of(2), joint=1),
    'friction that an effect multiplies': Case(arm_of('planar', 2), torque_of(2), drift=-0.4)}


def measured(case):
    """Return angles near those of the plant: what keeps innovations from being zero."""
    q, _ = case.driven()
    time = PERIOD * np.arange(len(q))[:, None]
    return q + 1e-3 * np.sin(7.0 * time + np.arange(case.n))


@pytest.mark.parametrize('name', CASES)
def test_the_true_parameters_follow_the_plant_to_rounding(name):
    """With the plant's own step, uncorrected."""
    case = replace(CASES[name], gain=0.0)
    q, dq = case.driven()
    predicted, _, _ = case.predict(q)
    assert np.ptp(q) > 0.1
    np.testing.assert_allclose(predicted, q - 0.5 * PERIOD * dq, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize('name', [name for name in CASES if 'effect' not in name])
def test_where_encoders_count_a_plant_of_far_smaller_steps_is_followed(name):
    """Viscous friction of the rate at the beginning of each sample would be 8e-5 off."""
    case = replace(CASES[name], gain=0.0)
    q, _ = case.driven(FINE)
    predicted, _, _ = case.predict(q, half=COUNT)
    np.testing.assert_allclose(predicted, q, rtol=0.0, atol=OFF)


@pytest.mark.parametrize('half', [0.0, COUNT])
@pytest.mark.parametrize(('name', 'tolerance'), [
    ('one joint', 1e-4), ('further torques', 1e-4), ('second of two decoupled', 1e-4),
    ('second of two coupled', 0.005), ('friction that an effect multiplies', 0.005)])
def test_derivatives_are_those_of_the_innovation(name, tolerance, half):
    """Central differences, each free number on its own, rms relative to that of the derivative."""
    case = CASES[name]
    angle, free, step = measured(case), case.free(case.joint), 3e-7
    _, _, jacobian = case.predict(angle, half=half)
    for p, unit in enumerate(np.eye(len(free))):
        up, down = (case.predict(angle, free + sign * step * unit, half)[1][:, case.joint]
                    for sign in (1, -1))
        slope = (down - up) / (2.0 * step)
        off = np.sqrt(np.mean((jacobian[:, p] - slope) ** 2) / np.mean(slope ** 2))
        assert off < tolerance, f'free number {p} is off by {off:.2g}'


def test_within_a_count_nothing_is_seen_and_nothing_corrected():
    case = CASES['one joint']
    q, _ = case.driven()
    free, _, _ = replace(case, gain=0.0).predict(q, half=COUNT)
    off = 0.4e-3 * np.sign(np.sin(50.0 * np.arange(len(q))))[:, None]
    off[0] = 0.0
    predicted, innovation, jacobian = case.predict(free + off, half=0.5e-3)
    np.testing.assert_array_equal(predicted, free)
    assert not innovation.any() and not jacobian.any()


def test_outside_a_count_the_distance_to_it_is_seen():
    case = replace(CASES['one joint'], gain=0.0)
    free, _, exact = case.predict(case.driven()[0], half=COUNT)
    angle = free.copy()
    angle[1000:, 0] += 0.7e-3
    angle[2000:, 0] -= 1.4e-3
    _, innovation, jacobian = case.predict(angle, half=0.5e-3)
    assert not innovation[:1000].any() and not jacobian[:1000].any()
    np.testing.assert_allclose(innovation[1000:2000], 0.2e-3, rtol=1e-9)
    np.testing.assert_allclose(innovation[2000:], -0.2e-3, rtol=1e-9)
    np.testing.assert_array_equal(jacobian[1000:], exact[1000:])


def test_an_angle_that_was_lost_corrects_nothing():
    """The angles before a hole do not feel it, those in it run freely, and none is a NaN."""
    case = CASES['second of two coupled']
    angle = measured(case)
    whole, _, _ = case.predict(angle)
    holed = angle.copy()
    holed[1000:1200, 1] = np.nan
    predicted, innovation, jacobian = case.predict(holed)
    np.testing.assert_array_equal(predicted[:1001], whole[:1001])
    assert not innovation[1000:1200, 1].any() and innovation[1000:1200, 0].all()
    assert not jacobian[1000:1200].any() and jacobian[1200:].any()
    assert np.isfinite(predicted).all() and not np.allclose(predicted[1100], whole[1100])
    loose = replace(case, gain=0.0)
    np.testing.assert_array_equal(loose.predict(holed)[0], loose.predict(angle)[0])


def simulated_freely(case, angle, first, stride, horizon):
    """Return angles (S, horizon, n) of free simulations."""
    theta, _ = case.coordinates.unpack(case.free(case.joint))
    starts = (len(angle) - 1 - horizon - first) // stride + 1
    predicted = np.empty((starts, horizon, case.n))
    predictor.simulate_freely(
        np.ascontiguousarray(angle), np.zeros(case.n), case.torque, case.factor, case.extra,
        theta[len(theta) - case.n_extra:], PERIOD, chain.constants_of(case.arm),
        case.friction(), case.joint, case.gains(),
        np.zeros(case.n), first, stride, horizon, case.state(), case.state(),
        plant.workspace(case.n), predicted)
    return predicted


@pytest.mark.parametrize('name', CASES)
def test_free_simulations_from_the_true_state_are_the_plant(name):
    case = CASES[name]
    q, dq = case.driven()
    at_sample = q - 0.5 * PERIOD * dq  # of which the correction finds nothing to correct
    first, stride, horizon = 300, 400, 500
    free = simulated_freely(case, at_sample, first, stride, horizon)
    assert len(free) == 6
    for start, path in enumerate(free):
        begin = first + start * stride
        np.testing.assert_allclose(path, at_sample[begin:begin + horizon], rtol=0.0, atol=1e-12)
