# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""An effect hidden in the default robot, what its user believes, and a motion that shows much."""

from dataclasses import dataclass, replace

from gms_flex_control.control.feedforward import compensated
from gms_flex_control.discrepancy.motion import motion_of, scales_of
from gms_flex_control.effects import registry
from gms_flex_control.errors import ConfigError, did_you_mean, ParameterError, SimulationError
from gms_flex_control.experiment.simulated import Plan, simulate
from gms_flex_control.params.robot import EffectSpec, RobotParams, WHOLE_ARM
from gms_flex_control.trajectory import builders
from gms_flex_control.tuning.tracking import link_error
import numpy as np

PERIOD = 2e-3          # of the joint states [s]
SHORTEST, LONGEST = 20.0, 3600.0       # motion [s]
COUNTS, NOISE = 131072.0, 0.3          # of the encoders per revolution; noise in counts
APPROACH, MOVE, HOLD = 0.5, 2.0, 0.25  # [s]
_SIZES = (0.5, 1.5)                    # over the usual size of the effect, see Effect.typical
_STEPS, _FARTHEST = (0.03, 1.2), 1.1   # of one move, and from zero [rad]
_TRIES, _LARGEST_ERROR = 20, 0.2       # draws, and the tracking error of one refused [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenEffect:
    """What the demonstration hides."""

    effect: EffectSpec     # in the robot
    robot: RobotParams     # as it is
    believed: RobotParams  # without the effect, every parameter 1 to 3 % off
    points: np.ndarray     # (m, 2), angles the motion rests at [rad]
    duration: float        # of the motion with the way to its beginning [s]

    def trajectory_values(self) -> dict:
        """Return the motion as parameters of the trajectory node."""
        return {'trajectory.type': 'via_points', 'trajectory.approach_time': APPROACH,
                'trajectory.move_time': MOVE, 'trajectory.hold_time': HOLD} | {
            f'trajectory.{joint}.points': [float(angle) for angle in self.points[:, j]]
            for j, joint in enumerate(self.robot.joints)}


def drawable() -> tuple[str, ...]:
    """Return the effects that may be drawn: a controller can compensate them, once per joint."""
    again = {name for one in registry.names() for name in registry.find(one).again}
    return tuple(name for name in registry.names() if name not in again
                 and compensated(name) and not registry.find(name).of_recording)


def hide_effect(robot, gains, seed, *, effect=None, duration=60.0) -> HiddenEffect:
    """
    Draw an effect, its joint and size, what is believed of a robot, and a motion.

    ``robot`` has two joints in a plane and no effects, ``gains`` will drive it; every number comes
    from ``seed``. ``effect`` names one instead of one of `drawable`; the motion lasts about
    ``duration`` [s]. ConfigError if the effect is unknown or cannot act on this robot, or the
    motion would be too short; SimulationError if no draw gave a robot that can be driven.
    """
    if effect is not None and effect not in registry.names():
        raise ConfigError(
            f'effect {effect!r} is unknown{did_you_mean(effect, registry.names())}')
    if not SHORTEST <= duration <= LONGEST:
        raise ConfigError(f'--duration {duration:g}: give {SHORTEST:g} to {LONGEST:g} s')
    rng = np.random.default_rng([77, seed])  # a stream of no other draw
    robot = replace(robot, encoder=replace(
        robot.encoder, counts=COUNTS, noise=NOISE * 2.0 * np.pi / COUNTS))
    believed = random_error(rng, robot)
    name = effect or str(rng.choice(drawable()))
    points = draw_points(rng, int((duration - APPROACH - HOLD) / (MOVE + HOLD)))
    motion = builders.via_points(points, MOVE, HOLD)
    scales = scales_of([motion_of(_driven(robot, believed, gains, motion), robot)], robot)
    for _ in range(_TRIES):
        spec = draw_effect(rng, name, robot, scales)
        hidden = replace(robot, effects=(spec,))
        try:
            recording = _driven(hidden, believed, gains, motion)
        except (ParameterError, SimulationError):  # not on that joint, or not so large
            continue
        if link_rms(recording).max() < _LARGEST_ERROR:
            return HiddenEffect(effect=spec, robot=hidden, believed=believed, points=points,
                                duration=APPROACH + motion.end)
    raise SimulationError(f'effect {name}, seed {seed}: the arm could not be driven with any of '
                          f'{_TRIES} sizes of it; take another seed')


def draw_effect(rng, name, robot, scales) -> EffectSpec:
    """
    Draw joint and values of an effect, about as large as it usually is.

    ``name`` is one of the catalogue, ``robot`` does not have it, ``scales`` are the Scales of its
    joints. ConfigError if the effect cannot act on this robot.
    """
    kind = registry.find(name)
    guesses = [kind.guesses(one) for one in (scales[:1] if kind.whole_arm else scales)]
    able = [j for j, found in enumerate(guesses) if found]
    if kind.needs_supply or kind.of_recording or not able:
        raise ConfigError(f'effect {name} cannot act on the simulated robot, whose recording has '
                          'no fault and no voltage of the supply; take another one')
    j = int(rng.choice(able))
    guess = guesses[j][rng.integers(len(guesses[j]))]
    way = rng.standard_normal(len(guess.probes))
    way = (np.abs(way) if guess.lowest >= 0.0 else way) / np.linalg.norm(way)
    values, usual = np.array(guess.values(way)), kind.typical(scales[j])[0]
    if usual is not None:  # what a guess says of size is where a search begins
        values[0] = np.copysign(usual * rng.uniform(*_SIZES), values[0])
    lower, upper = kind.search_bounds(j, robot)
    if not lower[0] <= values[0] <= upper[0]:  # less friction than none: rather more of it
        values[0] = -values[0]
    values = np.clip(values, lower, upper)
    return EffectSpec(name=name, joint=WHOLE_ARM if kind.whole_arm else robot.joints[j],
                      values=tuple(values.tolist()))


def draw_points(rng, count) -> np.ndarray:
    """
    Return ``count`` + 1 angles to rest at, (count + 1, 2) [rad], from zero to zero.

    Small and large steps alike: every move takes as long, so they are slow and fast ones.
    """
    points = [np.zeros(2)]
    while len(points) < count:
        step = np.exp(rng.uniform(*np.log(_STEPS), 2)) * rng.choice([-1.0, 1.0], 2)
        there = points[-1] + step
        points.append(np.where(np.abs(there) > _FARTHEST, points[-1] - step, there))
    return np.array([*points, np.zeros(2)])


def _driven(robot, believed, gains, motion):
    return simulate(Plan(
        robot=robot, model=believed, gains=gains, trajectory=motion, motion='via_points',
        duration=motion.end, period_ns=round(1e9 * PERIOD), substeps=20, seed=0,
        q_link=np.zeros(2)))


def random_error(rng, robot, least=0.01, most=0.03) -> RobotParams:
    """
    Return a robot as its user may believe it to be: every parameter a little off, no effects.

    Every relative error has a size of ``least`` to ``most`` and either sign; those of mass and
    inertia of a link are one.
    """
    def off(values):
        shape = np.shape(values)
        return 1.0 + rng.uniform(least, most, shape) * rng.choice([-1.0, 1.0], shape)

    def off_way(steady):
        level = off(steady.static)
        return steady.scaled(static=level, coulomb=level, velocity=off(steady.velocity),
                             viscous=off(steady.viscous))

    arm, friction = robot.arm, robot.friction
    links, friction = off(arm.mass), friction.each_way(off_way)  # the order is that of the draws
    return replace(
        robot, effects=(),
        arm=replace(arm.scaled(links), motor_inertia=arm.motor_inertia * off(arm.motor_inertia),
                    stiffness=arm.stiffness * off(arm.stiffness)),
        friction=replace(friction, stiffness=friction.stiffness * off(friction.stiffness[:, :1]),
                         attraction=friction.attraction * off(friction.attraction)))


def link_rms(recording) -> np.ndarray:
    """Return the rms tracking error of each link (n,) [rad]."""
    return np.sqrt(np.nanmean(link_error(recording) ** 2, axis=0))
