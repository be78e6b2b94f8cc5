# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Plant, encoders and controller in one compiled loop, and the plant sample by sample."""

from dataclasses import dataclass

from gms_flex_control.compiled import compiled
from gms_flex_control.control import cascade, feedforward
from gms_flex_control.effects import base as sig
from gms_flex_control.records import boxed, views
from gms_flex_control.simulation import encoder, plant
import numpy as np

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """What happened at T sample times; the command at k acts from sample k to k + 1."""

    time: np.ndarray          # (T,) [s]
    reference: np.ndarray     # (T, 5, n) desired link angle and derivatives
    measured: np.ndarray      # (T, 4, n) q_link, dq_link, q_motor, dq_motor
    true: np.ndarray          # (T, 4, n) the same without encoders
    command: np.ndarray       # (T, n) demanded torque of the sample [N m]
    applied: np.ndarray       # (T, n) given by the actuators over the sample before [N m]
    friction: np.ndarray      # (T, n) of the blocks, and viscous [N m]
    friction_hat: np.ndarray  # (T, n) its estimate [N m]


@compiled
def sense(sensed, state, time, period, constants, encoders, work) -> None:
    """Measure one sample with the noise drawn before: sensor effects first, then encoders."""
    plant.sensed(state, state.applied, time, period, constants, work)
    encoder.measure(sensed, work.signals, period, encoders)


@compiled
def _run_loop(reference, is_effort, travel, supply, begin, first, period, substeps, plant_state,
              plant_constants, plant_work, sensed, encoders, rng, control_state, feed_state,
              control_constants, feed_constants, control_work, angles, torques):
    """Fill ``angles`` (T, 8, n) and ``torques`` (T, 4, n); return samples, see `Loop.run`."""
    n, measured = plant_state.q_link.shape[0], sensed.output
    for k in range(reference.shape[0]):
        time = begin + (first + k) * period
        encoder.draw(sensed, encoders, rng)
        sense(sensed, plant_state, time, period, plant_constants, encoders, plant_work)
        if is_effort:
            for j in range(n):
                limit = control_constants.torque_limit[j]
                control_state.command[j] = min(max(reference[k, 0, j], -limit), limit)
        else:  # as a node that has no earlier state to form a difference with
            elapsed = period if first + k > 0 else 0.0
            cascade.tick(control_state, measured, reference[k], elapsed, control_constants,
                         control_work)
            feedforward.feed(control_state, measured, reference[k], elapsed, feed_constants,
                             feed_state)
        plant.friction(plant_state, plant_constants, plant_work)
        arrived = False
        for j in range(n):
            angles[k, 0, j], angles[k, 1, j] = measured.q_link[j], measured.dq_link[j]
            angles[k, 2, j], angles[k, 3, j] = measured.q_motor[j], measured.dq_motor[j]
            angles[k, 4, j], angles[k, 5, j] = plant_state.q_link[j], plant_state.dq_link[j]
            angles[k, 6, j], angles[k, 7, j] = plant_state.q_motor[j], plant_state.dq_motor[j]
            torques[k, 0, j], torques[k, 1, j] = control_state.command[j], plant_state.applied[j]
            torques[k, 2, j] = plant_work.friction[j]
            torques[k, 3, j] = control_state.friction_hat[j]
            arrived |= abs(measured.q_link[j] - angles[0, 0, j]) > travel[j]
            plant_work.signals[j, sig.SUPPLY] = supply[k]
        plant.advance(plant_state, control_state.command, time, period, substeps,
                      plant_constants, plant_work)
        if arrived:
            return k + 1
    return reference.shape[0]


class Loop:
    """
    A robot and its controller, run along one reference after the other.

    ``robot`` is it as it is, ``model`` as the controller believes it to be, whose effects are
    compensated where a controller can (RobotParams). The sample ``period_ns`` is an integer, as
    the stamps of the nodes are [ns], with ``substeps`` of integration; ``seed`` is of the encoder
    noise. The links rest at ``q_link`` (n_joints,) at first, by default at zero [rad]; effects
    that depend on time see the first sample at ``begin`` [s].
    """

    def __init__(self, robot, model, *, period_ns=2_000_000, substeps=20, seed=0, q_link=None,
                 begin=0.0):
        n = robot.n_joints
        self.samples = 0                              # so far
        self.plant_state = plant.init(robot, q_link)  # may be changed before the first sample
        self._model, self._begin = feedforward.as_parameters(model), begin
        self._period_ns, self._substeps = period_ns, substeps
        self._plant = (self.plant_state, plant.constants_of(robot), plant.workspace(n))
        self._encoders = (encoder.init(n), encoder.constants_of(robot.encoder),
                          np.random.default_rng(seed))
        self._control_work = cascade.workspace(n)
        self._reset()

    def _reset(self):
        """Forget the motion so far: observer and filters begin anew."""
        self._control = cascade.init(self._model), feedforward.init(self._model.n_joints)

    def run(self, reference, gains, *, is_effort=False, travel=None, supply=None) -> Run:
        """
        Follow ``reference`` (T, 5, n_joints), a sample each, with ControllerParams ``gains``.

        If it ``is_effort`` its first row is a torque, after which the controller forgets its
        past. ``travel`` (n_joints,) ends it when a link has moved by more [rad]; ``supply`` (T,)
        is the voltage of the drives, by default not known [V].
        """
        # a copy: the loop is compiled anew for a read-only reference
        reference = np.array(reference, dtype=float, order='C')
        samples, _, n = reference.shape
        angles, torques = np.empty((samples, 8, n)), np.empty((samples, 4, n))
        done = _run_loop(
            reference, is_effort,
            np.full(n, np.inf) if travel is None else np.array(travel, dtype=float),
            np.zeros(samples) if supply is None else np.array(supply, dtype=float),
            self._begin, self.samples, self._period_ns / NANOSECONDS, self._substeps,
            *self._plant, *self._encoders, *self._control,
            cascade.constants_of(gains, self._model),
            feedforward.constants_of(gains, self._model), self._control_work, angles, torques)
        if is_effort:
            self._reset()
        time = (self.samples + np.arange(done)) * self._period_ns / NANOSECONDS
        self.samples += done
        angles, torques = angles[:done], torques[:done]
        return Run(time=time, reference=reference[:done], measured=angles[:, :4],
                   true=angles[:, 4:], command=torques[:, 0], applied=torques[:, 1],
                   friction=torques[:, 2], friction_hat=torques[:, 3])


def count_samples(duration: float, period_ns: int) -> int:
    """Return how many samples a run of ``duration`` [s] has, one at least."""
    return max(1, round(duration * NANOSECONDS / period_ns))


def run(robot, model, gains, trajectory, *, duration, period_ns=2_000_000, **options) -> Run:
    """
    Simulate the closed loop along a Trajectory from its beginning for ``duration`` [s].

    Robots, gains and ``options`` as of `Loop`. Releases the GIL.
    """
    time = np.arange(round(duration * NANOSECONDS / period_ns)) * period_ns / NANOSECONDS
    loop = Loop(robot, model, period_ns=period_ns, **options)
    return loop.run(trajectory.sample(time), gains)


@compiled
def _advance(state, command, time, period, substeps, constants, work):
    """Advance a plant by one sample; records come boxed, as Python hands them over fast."""
    plant.advance(state[0], command, time, period, substeps, constants[0], work[0])


@compiled
def _sense(sensed, state, time, period, constants, encoders, work):
    """Read the encoders; records come boxed."""
    sense(sensed[0], state[0], time, period, constants[0], encoders[0], work[0])


class SteppedPlant:
    """
    A simulated robot that is advanced sample by sample.

    ``period`` is the sample [s], with ``substeps`` of integration; ``seed`` is of the encoder
    noise; the links rest at ``q_link`` (n_joints,) at first [rad]. ``supply[:]`` is the voltage of
    its drives [V], 0 where it is not known, as at first.
    """

    def __init__(self, robot, *, period, substeps, seed=0, q_link=None):
        self._period, self._substeps, self._ticks = period, substeps, 0
        self._constants = boxed(plant.constants_of(robot))
        self._encoders = boxed(encoder.constants_of(robot.encoder))
        self._work = boxed(plant.workspace(robot.n_joints))
        self._state = boxed(plant.init(robot, q_link))
        self._sensed = boxed(encoder.init(robot.n_joints))
        self._noisy, self._rng = bool(robot.encoder.noise > 0), np.random.default_rng(seed)
        sensed = self._sensed[0]
        self.state, self.measured, self._normal = (
            self._state[0], views(sensed.output), sensed.normal)
        self.supply = self._work[0].signals[:, sig.SUPPLY]
        self.applied = self.state.applied  # torque given over the last sample (n_joints,) [N m]

    def measure(self) -> None:
        """Read the encoders into ``measured``."""
        if self._noisy:
            self._rng.standard_normal(out=self._normal)
        _sense(self._sensed, self._state, self._ticks * self._period, self._period,
               self._constants, self._encoders, self._work)

    def advance(self, command) -> None:
        """Hold ``command`` (n_joints,) [N m] for one sample, then read the encoders."""
        _advance(self._state, command, self._ticks * self._period, self._period, self._substeps,
                 self._constants, self._work)
        self._ticks += 1
        self.measure()
