# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""An effect hidden in the default robot, what its user believes, and a motion that shows much."""

from dataclasses import dataclass, replace

from gms_flex_control.effect_compensation.known import compensated
from gms_flex_control.errors import ConfigError, SimulationError
from gms_flex_control.hidden import plants, sizes
from gms_flex_control.hidden.cases import available_effects, require_known
from gms_flex_control.params.robot import EffectSpec, RobotParams
from gms_flex_control.simulation import closed_loop
from gms_flex_control.trajectory import builders
import numpy as np

PERIOD = 2e-3          # of the joint states [s]
SHORTEST = 20.0        # motion that shows something [s]
COUNTS, NOISE = 131072.0, 0.3  # of the encoders per revolution; noise in counts
APPROACH, MOVE, HOLD = 0.5, 2.0, 0.25  # [s]
_STEPS, _FARTHEST = (0.03, 1.2), 1.1   # of one move, and from zero [rad]
_TRIES, _STRAY = 20, 0.2               # draws, and the tracking error of one that is refused [rad]
_STREAM = 77                           # of random numbers, of no other draw


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenEffect:
    """
    What the demonstration hides.

    Parameters
    ----------
    effect : EffectSpec
        In the robot.
    robot, believed : RobotParams
        As it is; without the effect and with every parameter 1 to 3 % off.
    points : ndarray, shape (m, 2)
        Angles the motion rests at [rad].
    duration : float
        Of the motion with the way to its beginning [s].

    """

    effect: EffectSpec
    robot: RobotParams
    believed: RobotParams
    points: np.ndarray
    duration: float

    def trajectory_values(self):
        """Return the motion as parameters of the trajectory node."""
        return {'trajectory.type': 'via_points', 'trajectory.approach_time': APPROACH,
                'trajectory.move_time': MOVE, 'trajectory.hold_time': HOLD} | {
            f'trajectory.{joint}.points': [float(angle) for angle in self.points[:, j]]
            for j, joint in enumerate(self.robot.joints)}


def drawable():
    """Return the effects that may be drawn, tuple of str: a controller can compensate them."""
    return tuple(name for name in available_effects() if compensated(name))


def hide_effect(robot, gains, seed, *, effect=None, duration=60.0):
    """
    Draw an effect, its joint and size, what is believed, and a motion.

    Parameters
    ----------
    robot : RobotParams
        Two joints in a plane, without effects.
    gains : ControllerParams
        It will be driven with.
    seed : int
        Every number comes from it.
    effect : str, optional
        This one instead of one of `drawable`.
    duration : float
        Of the motion, about [s].

    Returns
    -------
    HiddenEffect

    Raises
    ------
    ConfigError
        If the effect is unknown or needs what the nodes lack, or the motion would be too short.
    SimulationError
        If no draw gave a robot that can be driven.

    """
    if effect is not None:
        require_known('effect', effect, available_effects())
    if effect == 'supply_sag':
        raise ConfigError('effect supply_sag needs the voltage of the supply, which the simulated '
                          'robot does not publish; take another one')
    if not SHORTEST <= duration <= 3600.0:
        raise ConfigError(f'--duration {duration:g}: give {SHORTEST:g} to 3600 s')
    rng = np.random.default_rng([_STREAM, seed])
    robot = replace(robot, encoder=replace(
        robot.encoder, counts=COUNTS, noise=NOISE * 2.0 * np.pi / COUNTS))
    believed = plants.draw_belief(rng, robot)
    name = effect or str(rng.choice(drawable()))
    points = draw_points(rng, int((duration - APPROACH - HOLD) / (MOVE + HOLD)))
    motion = builders.via_points(points, MOVE, HOLD)
    figures = sizes.figures_of(robot, _driven(robot, believed, gains, motion), PERIOD)
    for _ in range(_TRIES):
        joint = sizes.place(rng, name, robot.joints)
        spec = sizes.spec(name, joint, robot.joints, sizes.MAIN[name](rng, figures[joint]))
        hidden = replace(robot, effects=(spec,))
        if _stray(_driven(hidden, believed, gains, motion)) < _STRAY:
            return HiddenEffect(effect=spec, robot=hidden, believed=believed, points=points,
                                duration=APPROACH + motion.end)
    raise SimulationError(f'effect {name}, seed {seed}: the arm could not be driven with any of '
                          f'{_TRIES} sizes of it; take another seed')


def draw_points(rng, count):
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
    return closed_loop.run(robot, believed, gains, motion, duration=motion.end,
                           period_ns=round(1e9 * PERIOD))


def _stray(run):
    """Return the larger rms tracking error of the links, inf of a run that diverged [rad]."""
    error = run.true[:, 0] - run.reference[:, 0]
    return float(sizes.rms(error).max()) if np.isfinite(error).all() else np.inf
