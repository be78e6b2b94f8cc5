# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The cascade control law with friction compensation, Eqs. (8) to (12) and (27) to (30).

The link law demands an elastic torque u_ed; the motor law makes the motor follow the angle
that gives it. The motor needs two time derivatives of u_ed: they are taken analytically from
the model's acceleration and jerk, because encoders leave nothing of a numerical derivative.
"""

from functools import cache, lru_cache

from gms_flex_control import friction as gms
from gms_flex_control import records
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.control import compensation, feedforward, observer
from gms_flex_control.control.compensation import GMS, GMS_PAPER
from gms_flex_control.dynamics import chain
from gms_flex_control.params.gains import COMPENSATIONS, GAINS
from gms_flex_control.records import boxed, FLOAT, views
import numpy as np

# Mode gms. Where the reference rests, a stuck link is a stiff, hardly damped spring, and velocity
# feedback that comes through the motor too late shakes it: only this part of it is kept at
# speeds well below REST_VELOCITY [rad/s]. docs/model.md has the measurements.
REST_DAMPING, REST_VELOCITY = 0.3, 0.05
# A reference slower than this rests [rad/s, rad/s^2].
RESTING_SPEED, RESTING_ACCELERATION = 1e-6, 1e-5


@cache
def state_layout(n, n_blocks) -> np.dtype:
    """
    Return the dtype of what the controller remembers and what it answers, in one record.

    ``command`` (n,), motor torque [N m]; ``friction_hat`` (n,), estimate it compensates [N m];
    ``error``, ``error_rate`` (n,), tracking error actual - desired; ``observer``; ``q_before``
    (n,), link angle the observer saw at the tick before; ``deviation`` (n,), low-passed error;
    ``saturated`` (n,); ``started``, 0 before the first tick.
    """
    return records.layout(
        *((name, FLOAT, (n,)) for name in ('command', 'friction_hat', 'error', 'error_rate',
                                           'q_before', 'deviation', 'saturated')),
        ('started', FLOAT, (1,)), ('observer', observer.state_layout(n, n_blocks)))


@cache
def measured_layout(n) -> np.dtype:
    """Return the dtype of what is measured (n,): angles and velocities of both sides."""
    return records.layout(*((name, FLOAT, (n,)) for name in (
        'q_link', 'dq_link', 'q_motor', 'dq_motor')))


def measurement(n) -> np.record:
    """Return a record of `measured_layout`, zero."""
    return records.build(measured_layout(n))


@cache
def constants_layout(links, n, n_blocks) -> np.dtype:
    """Return the dtype of gains and model, ``links`` its arm's, as the kernels take them."""
    return records.layout(
        ('compensation', np.intp, (1,)), *((name, FLOAT, (n,)) for name in GAINS),
        ('chain', links), ('friction', gms.constants_layout(n, n_blocks)))


_VECTORS = ('displacement', 'sliding', 'dq_ref', 'ddq_ref', 'correction', 'correction_rate',
            'smooth', 'slope', 'spring', 'spring_rate', 'acceleration', 'jerk', 'scratch',
            'resting')


@cache
def work_layout(n) -> np.dtype:
    """Return the dtype of the work space of `tick`; nothing in it outlives a tick."""
    return records.layout(
        *((name, FLOAT, (n,)) for name in _VECTORS), ('torque', FLOAT, (3, n)),
        ('estimate', FLOAT, (3, n)), ('ref', FLOAT, (4, n)), ('rigid', FLOAT, (3, n)),
        ('chain', chain.work_layout(n)))


@lru_cache(maxsize=256)
def constants_of(gains, robot) -> np.record:
    """Return ControllerParams and the model of RobotParams as the record `tick` takes."""
    values, links = {name: getattr(gains, name) for name in GAINS}, chain.constants_of(robot.arm)
    return records.build(
        constants_layout(links.dtype, *robot.friction.stiffness.shape), **values,
        compensation=COMPENSATIONS.index(gains.compensation), chain=links,
        friction=gms.constants_of(robot.friction))


def init(robot) -> np.record:
    """Return a controller of ``robot`` before its first tick."""
    return records.build(state_layout(*robot.friction.stiffness.shape),
                         observer=observer.init(robot.friction))


def workspace(n) -> np.record:
    """Return work space for n joints."""
    return records.build(work_layout(n))


@compiled_part
def link_errors(state, measured, reference, constants, work) -> None:
    """Form the tracking errors, the reference velocity and the sliding variable, Eq. (12)."""
    for j in range(constants.kd_link.shape[0]):
        work.resting[j] = (constants.compensation[0] == GMS
                           and abs(reference[1, j]) < RESTING_SPEED
                           and abs(reference[2, j]) < RESTING_ACCELERATION)
        state.error[j] = measured.q_link[j] - reference[0, j]
        state.error_rate[j] = measured.dq_link[j] - reference[1, j]
        rate = state.error_rate[j]
        if work.resting[j]:
            rate *= _rest_damping(measured.dq_link[j])
        work.dq_ref[j] = reference[1, j] - constants.lambda_link[j] * state.error[j]
        work.ddq_ref[j] = reference[2, j] - constants.lambda_link[j] * rate
        work.sliding[j] = rate + constants.lambda_link[j] * state.error[j]


@compiled_part
def _rest_damping(velocity):
    """Return the part of the velocity feedback that stays at rest, see REST_DAMPING."""
    x = velocity / REST_VELOCITY
    return (REST_DAMPING + x * x) / (1.0 + x * x)


@compiled_part
def _spring_torques(state, measured, constants, work):
    """Write the torque of the joint springs and its rate, as the model has them."""
    links = constants.chain
    for j in range(constants.kd_link.shape[0]):
        torsion = measured.q_motor[j] - measured.q_link[j]
        torsion_rate = measured.dq_motor[j] - measured.dq_link[j]
        work.spring[j] = links.stiffness[j] * torsion + links.damping[j] * torsion_rate
        work.spring_rate[j] = links.stiffness[j] * torsion_rate
        if not links.flexible[j]:
            work.spring[j] = state.command[j]


@compiled_part
def _model_motion(state, measured, constants, work):
    """Form acceleration and jerk of the model, and the derivatives of F_hat on the way."""
    n = constants.kd_link.shape[0]
    links, out = constants.chain, work.estimate
    for j in range(n):
        work.chain.tau[j] = work.spring[j] - out[0, j]
    chain.accelerations(measured.q_link, measured.dq_link, links, work.chain)
    for j in range(n):
        work.acceleration[j], work.jerk[j] = work.chain.acceleration[j], 0.0
        work.ref[0, j], work.ref[1, j] = measured.dq_link[j], work.acceleration[j]
        work.ref[2, j], work.ref[3, j] = 0.0, 0.0
    if constants.compensation[0] == GMS_PAPER:
        observer.first_derivative(state.observer.blocks, measured.dq_link, work.acceleration,
                                  work.smooth, work.correction, constants.friction, out[1])
    chain.reference_torque(measured.dq_link, work.acceleration, work.jerk, work.ref[:3],
                           work.ref[1:], links, work.chain, work.rigid)
    for j in range(n):
        work.scratch[j] = work.spring_rate[j] - out[1, j] - work.rigid[1, j]
    chain.mass_solve(work.scratch, links, work.chain, work.jerk)


@compiled_part
def _friction_derivatives(state, measured, constants, work):
    """Complete F_hat with the derivatives the chosen compensation defines."""
    out = work.estimate
    if constants.compensation[0] == GMS_PAPER:
        for j in range(constants.kd_link.shape[0]):
            work.correction_rate[j] = constants.observer_gain[j] * (
                work.acceleration[j] - work.ddq_ref[j])
        observer.second_derivative(
            state.observer.blocks, measured.dq_link, work.acceleration, work.jerk, work.smooth,
            work.correction, work.slope, work.correction_rate, constants.friction, out[2])


@compiled_part
def _elastic_torque(measured, reference, constants, work):
    """Write u_ed and its first two derivatives into work.torque, Eq. (11)."""
    n, ref = constants.kd_link.shape[0], work.ref
    for j in range(n):
        ref[0, j], ref[1, j] = work.dq_ref[j], work.ddq_ref[j]
        ref[2, j] = reference[3, j] - constants.lambda_link[j] * (
            work.acceleration[j] - reference[2, j])
        ref[3, j] = reference[4, j] - constants.lambda_link[j] * (work.jerk[j] - reference[3, j])
    chain.reference_torque(measured.dq_link, work.acceleration, work.jerk, ref[:3], ref[1:],
                           constants.chain, work.chain, work.rigid)
    for j in range(n):  # rates of the sliding variable
        work.torque[0, j] = -constants.kd_link[j] * work.sliding[j]
        work.torque[1, j] = -constants.kd_link[j] * (work.acceleration[j] - work.ddq_ref[j])
        work.torque[2, j] = -constants.kd_link[j] * (work.jerk[j] - ref[2, j])
    for k in range(3):
        for j in range(n):
            work.torque[k, j] += work.rigid[k, j] + work.estimate[k, j]


@compiled_part
def _motor_law(state, measured, constants, work):
    """Write the limited motor torque into state.command, Eqs. (9), (27) to (29)."""
    links, torque = constants.chain, work.torque
    for j in range(constants.kd_link.shape[0]):
        command = torque[0, j]
        if links.flexible[j]:
            stiffness = links.stiffness[j]
            q_des = measured.q_link[j] + torque[0, j] / stiffness  # Eq. (9)
            dq_des = measured.dq_link[j] + torque[1, j] / stiffness
            ddq_des = work.acceleration[j] + torque[2, j] / stiffness
            error_rate = measured.dq_motor[j] - dq_des
            sliding = error_rate + constants.lambda_motor[j] * (
                measured.q_motor[j] - q_des)  # Eq. (28)
            demand = ddq_des - constants.lambda_motor[j] * error_rate  # Eq. (29)
            command = (links.motor_inertia[j] * demand + work.spring[j]
                       - constants.kd_motor[j] * sliding)  # Eq. (27)
        limit = constants.torque_limit[j]
        state.saturated[j] = 1.0 if abs(command) > limit else 0.0
        state.command[j] = min(max(command, -limit), limit)


@compiled
def tick(state, measured, reference, dt, constants, work) -> None:
    """
    Answer one measurement with a torque, ``state.command``, ``dt`` [s] after the one before.

    ``state`` is of `state_layout`, changed in place; ``measured``, of `measured_layout`;
    ``reference`` (5, n_joints) is the desired link angle and its derivatives 1 to 4; ``constants``
    and ``work`` are from `constants_of` and `workspace`.
    """
    link_errors(state, measured, reference, constants, work)
    _spring_torques(state, measured, constants, work)
    compensation.estimate(state, measured, reference, dt, constants, work)
    for j in range(constants.kd_link.shape[0]):
        state.friction_hat[j] = work.estimate[0, j]
    _model_motion(state, measured, constants, work)
    _friction_derivatives(state, measured, constants, work)
    _elastic_torque(measured, reference, constants, work)
    _motor_law(state, measured, constants, work)


@compiled
def tick_boxed(state, measured, reference, dt, constants, work, feeding, fed) -> None:
    """Tick the controller and feed effects forward; records come boxed."""
    tick(state[0], measured[0], reference, dt, constants[0], work[0])
    feedforward.feed(state[0], measured[0], reference, dt, feeding[0], fed[0])


class SteppedController:
    """The cascade controller tick by tick, whose gains may change; ``model`` is as believed."""

    def __init__(self, gains, model):
        self._model = feedforward.as_parameters(model)
        self._work = boxed(workspace(model.n_joints))
        self._measured = boxed(measurement(model.n_joints))
        self.measured = views(self._measured[0])
        self.use(gains)
        self.reset()

    def use(self, gains) -> None:
        """Use other ControllerParams from the next tick on."""
        self._limit = gains.torque_limit
        self._constants = boxed(constants_of(gains, self._model))
        self._feeding = boxed(feedforward.constants_of(gains, self._model))

    def reset(self) -> None:
        """Forget the motion so far: observer and filters begin anew."""
        self._state = boxed(init(self._model))
        self._fed = boxed(feedforward.init(self._model.n_joints))
        self.state = views(self._state[0])
        self._command = self.state.command

    @property
    def boxes(self) -> tuple:
        """Return state, measurement, constants and work space, as `tick_boxed` takes them."""
        return (self._state, self._measured, self._constants, self._work, self._feeding, self._fed)

    def pass_on(self, torque) -> np.ndarray:
        """Begin anew, and answer with a torque that is asked for, within limits (n_joints,)."""
        self.reset()
        self._command[:] = np.clip(torque, -self._limit, self._limit)
        return self._command

    def tick(self, reference, dt) -> np.ndarray:
        """Answer ``measured`` with a torque (n_joints,) [N m]; see `tick`."""
        tick_boxed(self._state, self._measured, reference, dt, self._constants, self._work,
                   self._feeding, self._fed)
        return self._command
