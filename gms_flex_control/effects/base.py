# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What an effect is: a named term with parameters that joins the model at one stage.

First guesses of an effect are small sizes whose torques are looked for in what a model leaves.
One that is linear in its parameters needs one guess; one that is not gives several, of which the
data choose, and a fit goes on from there.

An effect's ``apply(s, p, memory, dt)`` gets the row ``s`` of signals of its joint as a pointer, so
that ``s[TORSION]`` is the torsion of that joint and ``s[WIDTH + TORSION]`` that of the next one.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
import math
from typing import NamedTuple

from gms_flex_control.compiled import compiled_effect
from gms_flex_control.errors import ParameterError
from gms_flex_control.params.robot import RobotParams, StribeckParams
import numpy as np

# signals an effect reads and changes, one row of numbers per joint
TIME = 0           # since the start of the run [s]
JOINT = 1          # index of this joint
JOINTS = 2         # number of joints
Q_LINK = 3         # [rad]
DQ_LINK = 4        # [rad/s]
Q_MOTOR = 5        # [rad]
DQ_MOTOR = 6       # [rad/s]
DDQ_LINK = 7       # of the substep before [rad/s^2]
DDQ_MOTOR = 8      # of the substep before [rad/s^2]
TORQUE = 9         # torque of the actuator [N m]; stage ACTUATOR changes it
TORSION = 10         # q_motor - q_link as the spring sees it [rad]; stage TORSION changes it
TORSION_RATE = 11    # dq_motor - dq_link [rad/s]; stage TORSION changes it
SPRING = 12        # from motor to link, TORQUE - J DDQ_LINK of a rigid joint [N m]; stage SPRING
FRICTION = 13      # friction torque of the link, against the motion [N m]; stage FRICTION
LINK_TORQUE = 14   # extra torque on the link [N m]; stage LINK adds to it
MOTOR_TORQUE = 15  # extra torque on the motor [N m]; stage MOTOR adds to it
SENSED_LINK = 16   # what the link encoder will be given [rad]; stage SENSOR changes it
SENSED_MOTOR = 17  # what the motor encoder will be given [rad]; stage SENSOR changes it
SENSED_LINK_RATE = 18   # rate of what the link encoder is given [rad/s]; SENSOR changes it
SENSED_MOTOR_RATE = 19  # rate of what the motor encoder is given [rad/s]; SENSOR changes it
SUPPLY = 20        # voltage of the supply [V]; 0 where it is not known
BASE = 21          # angle of what the joint stands on [rad]; stage SENSOR changes it
BASE_RATE = 22     # its rate, against which the joint slips [rad/s]; stage SENSOR changes it
WIDTH = 23

LEAST_RELATIVE = -0.8   # least relative error searched for: ratios near -1 are implausible


class Stage(IntEnum):
    """Where in the model an effect acts; the stages run in this order in every substep."""

    ACTUATOR = 0  # torque command -> torque of the motor
    TORSION = 1   # q_motor - q_link -> torsion the spring sees
    SPRING = 2    # torsion -> spring torque
    FRICTION = 3  # friction torque of the link
    LINK = 4      # extra torque on the link
    MOTOR = 5     # extra torque on the motor
    SENSOR = 6    # what the encoders see; runs once per sample


@dataclass(frozen=True)
class Parameter:
    """
    One parameter of an effect, ``effects.<joint>.<effect>.<name>`` in a robot file.

    ``typical`` is the standard deviation of a zero-mean prior, or computes it from Scales; it is
    None for phases, orders, places and limits, of which zero is not the likeliest.
    """

    name: str
    unit: str
    description: str
    lower: float = -math.inf   # closed bounds of the values that the model allows
    upper: float = math.inf
    relative: bool = False     # a relative error, searched for from LEAST_RELATIVE on
    fixed: bool = False        # only sets the unit of another and is not fitted
    searched: tuple = (-math.inf, math.inf)  # bounds of the search, where narrower
    typical: float | Callable | None = None


class Effect(ABC):
    """A named effect: final subclasses are a `Term` of the motion, or a `Change` of parameters."""

    name: str                 # in robot files and reports
    words = ''                # what it is, such as 'Play in the transmission'
    parameters: tuple         # of Parameter
    whole_arm = False         # stands under effects.arm instead of under a joint
    evidence: str             # what it shows against, of discrepancy.remainder.VARIABLES
    similar = ()           # names of effects that data hardly distinguish from it
    again = ()             # names under which a joint may have it once and twice more
    declared_from = 0.8       # share of what it explains from which these are reported as well
    discriminated_by: str     # the experiment that separates it from others, without a verb
    of_feedback = False       # encoder noise in the torque of a feedback resembles a little of it
    replaces = None           # kind of known parameter of which this is a larger error
    needs_link_encoder = False  # cannot be judged on a flexible joint without one
    needs_commands = False    # what is measured as torque has passed it already
    needs_chain = False       # requires links that carry each other
    of_recording = False      # an error of the recording, not of the robot
    of_one_size = False       # takes all of something: what takes more or less is no such effect
    needs_supply = False      # requires a recorded voltage of the supply
    least_is_value = False    # the least value searched for is where physics ends
    fed_forward = False       # a torque that follows smoothly from what a controller measures
    acts_along_motion = True  # what was measured is enough to compute it
    estimated_with_arm = False  # identification finds it anew with the arm
    torque_delay = None       # values -> by which recorded torques act later than stamped [s]

    @staticmethod
    def is_custom(values, period: float, commanded: bool) -> bool:
        """
        Return whether ``values`` are within what drives report differently, with nothing wrong.

        Samples are a ``period`` [s] apart, their torques ``commanded`` or as drives report them.
        """
        return False

    @staticmethod
    @abstractmethod
    def guesses(scales) -> list:
        """Return how the effect might act on a joint of Scales, list of Guess."""

    @classmethod
    def typical(cls, scales) -> tuple:
        """Return ``typical`` of each parameter on a joint of Scales, floats or None."""
        return tuple(one.typical(scales) if callable(one.typical) else one.typical
                     for one in cls.parameters)

    @staticmethod
    def excludes(rigid) -> tuple:
        """Return the names of effects that may not stand beside it on a joint, rigid or not."""
        return ()

    @staticmethod
    def torque_scale(values, supply) -> float:
        """
        Return the factor by which it scales the whole torque of an actuator.

        A model that shrinks all torques has smaller residuals and explains nothing: they count
        per unit of the torque that was commanded. ``supply`` is its mean voltage [V].
        """
        return 1.0

    @staticmethod
    def in_friction(steady, direction, values) -> StribeckParams:
        """
        Return the StribeckParams of one direction (1, -1) with the effect in them.

        ``values`` of each parameter are (n_joints,), zero at joints without the effect. None
        where these parameters cannot express it.
        """
        return None

    @staticmethod
    def hardly_acts(values, scales) -> bool:
        """Return whether motion of Scales hardly depends on it at such values."""
        return False

    @staticmethod
    def holding_torque(values) -> float:
        """Return the friction torque [N m] that it adds where a motor stands still."""
        return 0.0

    @classmethod
    def search_bounds(cls, joint_index, robot) -> tuple[list, list]:
        """Return the least and the largest values of the search, within those of the model."""
        lower = [max(one.lower, one.searched[0], LEAST_RELATIVE if one.relative else -math.inf)
                 for one in cls.parameters]
        return lower, [min(one.upper, one.searched[1]) for one in cls.parameters]

    @classmethod
    def values(cls, given, where) -> tuple:
        """Return the parameter values in declared order, or raise ParameterError."""
        values = []
        for parameter in cls.parameters:
            key = f'{where}.{parameter.name}'
            if parameter.name not in given:
                raise ParameterError(f'{key} [{parameter.unit}] is missing: '
                                     f'{parameter.description}')
            value = float(given[parameter.name])
            if not parameter.lower <= value <= parameter.upper or not math.isfinite(value):
                raise ParameterError(f'{key} must be a number from {parameter.lower:g} to '
                                     f'{parameter.upper:g} {parameter.unit}, got {value:g}')
            values.append(value)
        return tuple(values)


class Term(Effect):
    """An effect that reads the signals of a joint and changes those of its stage."""

    stage: Stage
    memory_size = 0           # floats it keeps from substep to substep, zero at the start

    @staticmethod
    def on_arm(values, arm, joint) -> tuple:
        """Return the values that `apply` gets at index ``joint`` of ArmParams."""
        return values

    @staticmethod
    @abstractmethod
    def apply(s, p, memory, dt) -> None:
        """
        Change the signals of one joint; compiled, so plain scalar code only.

        ``s``, ``p`` and ``memory`` point to the signals of the joint as named above, the values of
        ``parameters`` and ``memory_size`` numbers of its own; ``dt`` is the substep, the sample
        period in stage SENSOR [s].
        """

    @classmethod
    def compiled(cls) -> object:
        """Return the numba C function of ``apply``; compiled once, when first used."""
        return compiled_effect(cls.apply)


class Change(Effect):
    """An effect that is another value of parameters the model already has."""

    @staticmethod
    @abstractmethod
    def change(robot, joint, values) -> RobotParams:
        """Return the RobotParams with the effect at index ``joint``, 0 for the whole arm."""


HIGHEST_ORDER = 48.0  # of waves over the motor angle that are guessed; data show finer ones


class Travel(NamedTuple):
    """Between which angles a link moved, and how far its motor turned."""

    lowest: float   # [rad]
    highest: float  # [rad]
    turned: float   # between the motor's lowest and highest angle [rad]

    @property
    def span(self) -> float:
        """Return how far the link moved [rad]."""
        return self.highest - self.lowest


class Scales(NamedTuple):
    """What a recording and its model set as usual sizes on one joint."""

    friction: float   # F_s and viscous friction at that speed, mean of both directions [N m]
    torque: float     # largest command [N m]
    spring: float     # standard deviation of the spring torque [N m]
    torsion: float    # standard deviation of the torsion [rad]; 0 where rigid
    speed: float      # rms of the link's rate [rad/s]
    inertia: float    # J [kg m^2]
    link_inertia: float  # about the joint [kg m^2]
    travel: Travel
    duration: float   # [s]
    supply: float = 0.0  # mean voltage of the supply [V]; 0 where it is not known
    fine_orders: tuple = ()  # of waves over the motor angle that stand out [1/rad]
    mass: float = 1.0  # of all links [kg]
    count: float = 0.0  # of the coarsest encoder of the link [rad]; 0 where readings have no steps
    presliding: float = np.inf  # displacement at which the softest block slips [rad]
    in_space: bool = False  # other joints feel the inertia of its link, and none its motor's

    @property
    def rigid(self) -> bool:
        """Return whether the joint has no spring."""
        return self.torsion <= 0.0


class Guess(NamedTuple):
    """One way an effect might act: columns of a linear problem, and what its numbers mean."""

    probes: tuple              # values of all parameters of the effect, one set per column
    values: Callable           # coefficients -> values of all parameters
    lowest: float = -np.inf    # of every coefficient
    highest: float = np.inf
    within: Callable = lambda c: 1.0  # coefficients -> share that the bounds allow, 0 to 1

    @property
    def is_linear(self) -> bool:
        """Return whether the effect is proportional to its first parameter."""
        size = self.probes[0][0]
        return len(self.probes) == 1 and size != 0.0 and self.values([0.5])[0] == 0.5 * size


def linear(size, *fixed, positive=False) -> list[Guess]:
    """Return the guess of an effect proportional to its first parameter, list of one."""
    return [Guess(((size, *fixed),), lambda c: (c[0] * size, *fixed),
                  0.0 if positive else -np.inf)]


def wave(size, *fixed) -> list[Guess]:
    """Return the guess of ``size sin(... + phase)``, list of one: two columns a quarter apart."""
    return [Guess(((size, *fixed, 0.0), (size, *fixed, 0.5 * np.pi)),
                  lambda c: (size * np.hypot(c[0], c[1]), *fixed,
                             float(np.arctan2(c[1], c[0]))))]


def waves(size, orders) -> list[Guess]:
    """Return the guesses of `wave` for each order, the parameter after the size."""
    return [guess for order in orders for guess in wave(size, order)]


def orders(span, highest, lowest=1.0) -> np.ndarray:
    """Return orders within bounds that motion over a span [rad] can distinguish."""
    step = np.clip(np.pi / max(span, 1e-6), 0.25, 1.0)
    return np.arange(lowest, highest + 0.5 * step, step)


def sizes(values, *fixed) -> list[Guess]:
    """Return guesses of an effect that is not linear in its first parameter, one per value."""
    return [Guess(((value, *fixed),), lambda c, value=value: (value, *fixed), 0.0, 3.0)
            for value in values]


def shapes(size, values, *fixed, positive=True) -> list[Guess]:
    """Return guesses linear in the first parameter for each value of the second, then fixed."""
    return [Guess(((size, value, *fixed),), lambda c, value=value: (c[0] * size, value, *fixed),
                  0.0 if positive else -np.inf)
            for value in values]
