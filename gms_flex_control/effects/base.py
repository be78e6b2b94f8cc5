# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What an effect is: a named term with parameters that joins the model at one stage."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
import math

from gms_flex_control.compiled import compiled_effect
from gms_flex_control.errors import ParameterError

LEAST_RELATIVE = -0.8   # least relative error looked for: ratios near -1 are implausible


class Stage(IntEnum):
    """Where in the model an effect acts; the stages run in this order in every substep."""

    ACTUATOR = 0  # torque command -> torque of the motor
    TWIST = 1     # q_motor - q_link -> twist the spring sees
    SPRING = 2    # twist -> spring torque
    FRICTION = 3  # friction torque of the link
    LINK = 4      # extra torque on the link
    MOTOR = 5     # extra torque on the motor
    SENSOR = 6    # what the encoders see; runs once per sample


@dataclass(frozen=True)
class Parameter:
    """
    One parameter of an effect.

    Parameters
    ----------
    name, unit, description : str
        As shown in reports and YAML (``effects.<joint>.<effect>.<name>``).
    lower, upper : float
        Closed bounds of the values the model allows.
    relative : bool
        Whether it is a relative error, looked for from `LEAST_RELATIVE` on.
    fixed : bool
        Whether it only sets the unit of another and is not fitted.

    """

    name: str
    unit: str
    description: str
    lower: float = -math.inf
    upper: float = math.inf
    relative: bool = False
    fixed: bool = False


class Effect(ABC):
    """
    A named effect a model can have or lack.

    Subclasses are final: either a `Term`, which computes while the robot moves, or a
    `Change`, which alters the parameters once, before the run.
    """

    name: str                 # catalogue name, equal to the name of its module
    parameters: tuple         # of Parameter
    whole_arm = False         # stands under effects.arm instead of under a joint
    evidence: str             # what it shows against, of discrepancy.signature.VARIABLES
    confusable: tuple         # names of effects that data hardly tell from it
    slowest = 0.0             # order from which on a wave is looked for, of a parameter 'order'
    declared_from = 0.8       # share of what it explains from which these are said to do as well
    tells: str                # motion that tells it from others, as '... would tell'
    of_feedback = False       # encoder noise in the torque of a feedback resembles a little of it
    replaces = None           # kind of known parameter of which this is a larger error
    needs_link_encoder = False  # cannot be judged on a flexible joint without one
    needs_commands = False    # what is measured as torque has passed it already
    needs_planar = False      # requires links that carry each other
    of_recording = False      # an error of the recording, not of the robot
    needs_supply = False      # requires a recorded voltage of the supply
    fed_forward = False       # a torque that follows smoothly from what a controller measures
    acts_along_motion = True  # what was measured is enough to compute it
    estimated_with_arm = False  # identification finds it anew with the arm

    @classmethod
    @abstractmethod
    def guesses(cls, scales):
        """
        Return how the effect might be there on a joint.

        Parameters
        ----------
        scales : Scales
            Usual sizes there, see guess.py; those of the first joint for the whole arm.

        Returns
        -------
        list of Guess
            Empty where it cannot act.

        """

    @classmethod
    @abstractmethod
    def typical(cls, scales):
        """
        Return the standard deviation of a zero-mean prior on each parameter.

        Parameters
        ----------
        scales : Scales
            Of a joint on which the effect can act, see `guesses`.

        Returns
        -------
        tuple of float or None
            As ``parameters``; None for phases, orders, places and limits, of which zero is not
            the likeliest, and for those that are fixed.

        """

    @classmethod
    def excludes(cls, rigid):
        """Return the names of effects that may not stand beside it on a joint, rigid or not."""
        return ()

    @classmethod
    def torque_acted(cls, torque, period, values):
        """
        Return recorded torques as they acted, of an effect that is an error of the recording.

        Parameters
        ----------
        torque : ndarray, shape (T, n_joints)
            As recorded, held over samples [N m].
        period : float
            Sample [s].
        values : tuple of float
            Values of ``parameters``.

        Returns
        -------
        ndarray, shape (T, n_joints), or None
            None where it is no error of recorded torques.

        """
        return None

    @classmethod
    def torque_scale(cls, values, supply):
        """
        Return the factor by which it scales the whole torque of an actuator.

        A model that shrinks all torques has smaller residuals and explains nothing: they count
        per unit of the torque that was commanded.

        Parameters
        ----------
        values : tuple of float
            Values of ``parameters``.
        supply : float
            Mean voltage of the supply [V].

        Returns
        -------
        float

        """
        return 1.0

    @classmethod
    def in_friction(cls, steady, direction, values):
        """
        Return the friction parameters of one direction with the effect in them.

        Parameters
        ----------
        steady : StribeckParams
            Of one direction of motion.
        direction : float
            1 forward, -1 backward.
        values : list of ndarray, shape (n_joints,)
            Of each of ``parameters``, zero at joints without the effect.

        Returns
        -------
        StribeckParams, or None
            None where these parameters cannot express it.

        """
        return None

    @classmethod
    def holding_torque(cls, values):
        """Return the friction torque [N m] that it adds where a motor stands still."""
        return 0.0

    @classmethod
    def search_bounds(cls, joint_index, robot):
        """
        Return the least and the largest values that are looked for.

        Parameters
        ----------
        joint_index : int
            Of the joint; 0 for the whole arm.
        robot : RobotParams
            As believed.

        Returns
        -------
        lower, upper : list of float
            Of each parameter, within the bounds that the model allows.

        """
        lower = [max(one.lower, LEAST_RELATIVE) if one.relative else
                 max(one.lower, cls.slowest) if one.name == 'order' else one.lower
                 for one in cls.parameters]
        return lower, [one.upper for one in cls.parameters]

    @classmethod
    def values(cls, given, where):
        """
        Return the parameter values in declared order.

        Parameters
        ----------
        given : dict of str to float
            One entry per parameter.
        where : str
            Key of the effect in its file, for the message.

        Returns
        -------
        tuple of float
            Finite values within their bounds.

        Raises
        ------
        ParameterError
            If a parameter is missing, not finite or out of bounds.

        """
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
    @abstractmethod
    def apply(s, p, memory, dt):
        """
        Change the signals of one joint; compiled, so plain scalar code only.

        Parameters
        ----------
        s : pointer to float64
            Signals of the joint, see signals.py.
        p : pointer to float64
            Values of ``parameters``, in that order.
        memory : pointer to float64
            ``memory_size`` numbers of its own.
        dt : float
            Substep; the sample period in stage SENSOR [s].

        """

    @classmethod
    @cache
    def compiled(cls):
        """Return the numba C function of ``apply``; compiled once, when first used."""
        return compiled_effect(cls.apply)


class Change(Effect):
    """An effect that is another value of parameters the model already has."""

    @staticmethod
    @abstractmethod
    def change(robot, joint, values):
        """
        Return the robot with the effect in it.

        Parameters
        ----------
        robot : RobotParams
            As believed.
        joint : int
            Index of the joint; 0 for the whole arm.
        values : tuple of float
            Values of ``parameters``.

        Returns
        -------
        RobotParams

        """
