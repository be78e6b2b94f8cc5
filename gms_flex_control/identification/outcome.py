# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What an identification found, how far each number can be trusted, and the words for it."""

from dataclasses import dataclass, field
from itertools import groupby
import re
from typing import NamedTuple

from gms_flex_control.params.arm import in_currents, in_units
from gms_flex_control.params.robot import RobotParams
import numpy as np
from scipy.special import ndtr
from scipy.stats import t as student

CONFIDENT = 1.959964  # standard deviations of a normal distribution: 95 %, two-sided
NOT_IDENTIFIABLE = 'not identifiable'
DEPENDS = 'depends on the model'
DOUBTFUL = 'doubtful'
SET = 'set, not fitted'
STANDINGS = ('well known', 'roughly known', DOUBTFUL, NOT_IDENTIFIABLE, SET)
WELL_KNOWN = 0.1      # half of the 95 % interval over the value, at most
WIDE = 0.5            # half an interval this large a part of the value says nothing
_UNEXPLAINED = 0.5    # of the drive torque: beyond, nothing is to be trusted
_ENDLESS = 1e6       # upper end over lower end of an interval that says nothing
AT_FLOOR = 1.3       # error over floor that counts as the floor itself
_INDEXED = re.compile(r'(.*)\[(\d+)\]')


class Interval(NamedTuple):
    """Where a parameter lies with 95 % confidence."""

    low: float
    high: float


NO_INTERVAL = Interval(np.nan, np.nan)


class Estimate(NamedTuple):
    """One parameter as the data have it."""

    name: str              # as in parameter files, 'friction.joint1.forward.static'; blocks by
    #                        their place in the array, 'friction.joint1.stiffness[0]'
    unit: str
    value: float
    interval: Interval     # NaN where a flag says that the data give none
    flags: tuple           # of 'at bound', 'not identifiable', 'depends on the model'; empty: good
    note: str              # a sentence on the flags and what motion would identify it; '' without


def estimated(name: str, unit: str, value: float, error: float | None = None, note: str = '',
              known: bool = True) -> Estimate:
    """Return the Estimate of a value, ``error`` its deviation or None; open unless ``known``."""
    value, half = float(value), np.nan if error is None or not known else CONFIDENT * float(error)
    return Estimate(name, unit, value, Interval(value - half, value + half),
                    () if known else (NOT_IDENTIFIABLE,), note)


def widening(freedom: int) -> float:
    """Return how much wider a 95 % interval is where so few degrees of freedom give its size."""
    return float(student.ppf(ndtr(CONFIDENT), freedom)) / CONFIDENT


class FrictionMap(NamedTuple):
    """Mean friction torque in windows of motion."""

    velocity: np.ndarray  # (W,) [rad/s]
    torque: np.ndarray    # (W,) [N m]
    steady: np.ndarray    # (W,) bool, the velocity hardly changes


class PreslidingLoop(NamedTuple):
    """One piece of presliding motion: torque over displacement, measured and of the model."""

    displacement: np.ndarray  # (L,) [rad], measured
    torque: np.ndarray        # (L,) friction torque by the link equation [N m]
    model_displacement: np.ndarray  # (L,) [rad], of the model under the same torque
    label: str


class Trace(NamedTuple):
    """Friction torque over time, measured and of the model driven by the measured motion."""

    time: np.ndarray      # (T,) [s]
    velocity: np.ndarray  # (T,) [rad/s]
    measured: np.ndarray  # (T,) [N m]
    model: np.ndarray     # (T,) [N m]
    held_out: np.ndarray  # (T,) bool
    label: str


class HeldOutErrors(NamedTuple):
    """Errors on data that had no part in the fit."""

    torque_rms: float              # of the drive torque, while moving if encoders count [N m]
    relative: float                # of the rms of the drive torque
    coulomb_viscous: float         # the same, inertia and gravity with Coulomb + viscous alone
    free_run_rms: float            # link angle after free simulation of `horizon` [rad]
    free_run_coulomb_viscous: float  # the same of Coulomb + viscous alone [rad]
    horizon: float                 # [s]
    innovation_rms: float          # of the one-step prediction [rad]
    noise_floor: float             # of the torque, measurement noise alone [N m]
    repeatability: float           # of the torque, equal motion repeated [N m]; NaN without
    bandwidth: float = float('nan')  # below which torques are compared [Hz]


class BlockCandidate(NamedTuple):
    """One number of blocks that was tried."""

    n_blocks: int
    cost: float        # per held-out sample, lower is better
    error: float       # standard error of the difference to the best
    chosen: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class JointResult:
    """The identification of one joint."""

    joint: str                   # link name
    side: str                    # 'spring' or 'motor': what the friction torque was computed from
    estimates: tuple             # of Estimate: steady, attraction, blocks; further ones of the arm
    curve: tuple                 # presliding: displacement [rad], torque [N m], low and high end
    #                              of 95 %, as far as blocks are identifiable; empty where none is
    friction_map: FrictionMap    # measured
    steady_velocity: np.ndarray  # (V,), both signs [rad/s]
    steady_torque: np.ndarray    # (V,), fitted curve of Eq. (6) [N m]
    loops: tuple                 # of PreslidingLoop, presliding, for Fig. 4
    traces: tuple                # of Trace, sliding and other motion
    candidates: tuple            # of BlockCandidate, numbers of blocks that were tried
    held_out: HeldOutErrors
    warnings: tuple              # sentences


class OtherJoints(NamedTuple):
    """What is known of joints whose friction was not fitted, as where they did not move."""

    estimates: tuple = ()  # of Estimate
    joint: str = 'other joints'


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """Outcome of `gms_flex identify`."""

    robot: RobotParams    # with what was identified
    believed: RobotParams  # as it was described
    joints: tuple         # of JointResult, in the robot's order
    others: OtherJoints = OtherJoints()
    sources: tuple        # recordings used
    holdouts: tuple       # recordings set aside whole; empty where blocks of time were held out
    duration: float       # of all data [s]
    period: float         # sample [s]
    warnings: tuple       # of the data as a whole
    seconds: float        # how long the fit took
    described: bool = True  # whether ``believed`` is what a file says, not a placeholder
    currents: bool = False  # efforts are currents, torques and inertias are per torque constant
    constants: dict = field(default_factory=dict)  # by joint the true torque constant over the
    #                       stated one and its relative standard deviation, where that was open
    loads: dict = field(default_factory=dict)  # number of a source to the Body found in it
    spread: np.ndarray | None = None  # (3, n), of `nearest_arm`: how well links are known that
    #                       carry each other, whose numbers the data determine together only

    @property
    def joints_and_others(self) -> tuple:
        """Return what has estimates: each JointResult, and OtherJoints if there are any."""
        return (*self.joints, *([self.others] if self.others.estimates else []))

    def in_units(self, text: str) -> str:
        """Return a text that is written for torques of rotary axes, in the units of this robot."""
        text = in_units(self.robot.arm, text)
        return in_currents(text) if self.currents else text


def short_name(name: str, joint: str) -> str:
    """Return 'forward.static' for 'friction.joint1.forward.static'."""
    head, _, rest = name.partition(f'.{joint}.')
    if not rest:
        return name
    return rest if head == 'friction' else f'{head}.{rest}'


def short_label(label: str) -> str:
    """Return the label of a piece of data without the folders before its recording."""
    return label.rstrip('/').rsplit('/', 1)[-1]


def spread(estimate: Estimate) -> float:
    """Return half of the interval over the value; NaN if not known."""
    low, high = estimate.interval
    return 0.5 * (high - low) / abs(estimate.value) if estimate.value else np.nan


def standing(estimate: Estimate) -> str:
    """Return which of STANDINGS an Estimate has; an interval without width was set."""
    if NOT_IDENTIFIABLE in estimate.flags or not np.isfinite(estimate.value):
        return NOT_IDENTIFIABLE
    if estimate.flags:
        return DOUBTFUL
    low, high = estimate.interval
    if low == high:
        return SET
    return 'well known' if spread(estimate) <= WELL_KNOWN else 'roughly known'


def number(value: float, digits=4) -> str:
    """Return a number as text, '-' for none."""
    return f'{value:.{digits}g}' if np.isfinite(value) else '-'


def percent(share: float) -> str:
    """Return a share as text, such as '4.1 %'; 'unknown' for none."""
    return f'{100 * share:.3g} %' if np.isfinite(share) else 'unknown'


def span(interval: Interval) -> str:
    """Return an Interval as text, such as '0.1 .. 0.2'; '-' if unknown or without width or end."""
    low, high = interval
    if not np.isfinite(interval).any() or low == high or 0.0 < _ENDLESS * low < high:
        return '-'
    return f'{number(low)} .. {number(high)}'


def floor_shares(held_out: HeldOutErrors) -> tuple[float, float]:
    """Return noise floor and repeatability relative to the drive torque, NaN where unknown."""
    known = held_out.relative > 0.0 and held_out.torque_rms > 0.0
    share = held_out.relative / held_out.torque_rms if known else np.nan
    return share * held_out.noise_floor, share * held_out.repeatability


def joint_sentences(result: JointResult) -> list:
    """Return (sentence, whether a warning): how far a joint is predicted, and its warnings."""
    return [*_prediction(result.held_out), *((text, True) for text in result.warnings)]


def _prediction(errors):
    own, simple = errors.relative, errors.coulomb_viscous
    if not np.isfinite(own):
        return [('There is no held-out error: nothing checks these numbers.', True)]
    lines = [(f'On motion that took no part in the fit, the drive torque is predicted with an '
              f'error of {percent(own)} of its rms; Coulomb + viscous friction alone leaves '
              f'{percent(simple)}.', False)]
    if own >= simple:
        lines.append(('For this motion the model is no better than Coulomb + viscous friction '
                      'alone.', True))
    if words := distrust(errors):
        lines.append((words, True))
    lines.append((_floor(errors), False))
    if np.isfinite(errors.free_run_rms):
        lines.append((
            f'Running free for {number(errors.horizon, 3)} s from a measured state, the model '
            f'ends up {number(1e3 * errors.free_run_rms, 3)} mrad (rms) off; with Coulomb + '
            f'viscous alone {number(1e3 * errors.free_run_coulomb_viscous, 3)} mrad.', False))
    return lines


def distrust(errors: HeldOutErrors) -> str:
    """Return a sentence where so little of the torque is explained that numbers mean nothing."""
    return ('More than half of the drive torque stays unexplained: trust none of these numbers '
            'until the cause is found (scale or sign of the torque, inertia, gravity).'
            ) if errors.relative > _UNEXPLAINED else ''


def _floor(errors):
    noise, repeat = floor_shares(errors)
    floors = [f'noise alone makes {percent(noise)}'] if np.isfinite(noise) else []
    floors += [f'the same motion repeated differs by {percent(repeat)}'] if np.isfinite(
        repeat) else ['no motion was repeated, so that repeatability is not known']
    text = ', '.join(floors)
    best = np.fmax(noise, repeat)
    if np.isfinite(best):
        text += (': the model is as good as these data allow'
                 if errors.relative <= AT_FLOOR * best else
                 ': the rest is due to the model, or to motion too quick for these samples')
    return f'{text[0].upper()}{text[1:]}.'


def notes(result: JointResult | OtherJoints) -> list:
    """Return the notes on estimates as sentences, those alike as one."""
    about = {}
    for estimate in result.estimates:
        if estimate.note:
            about.setdefault(estimate.note.rstrip('.'), []).append(
                short_name(estimate.name, result.joint))
    return [f"{', '.join(_joined(names))}: {note}." for note, names in about.items()]


def _joined(mentions):
    """Return 'weight[0..2]' for 'weight[0]', 'weight[1]', 'weight[2]'; the rest as it is."""
    def run_of(place):
        found = _INDEXED.fullmatch(mentions[place])
        return (found[1], int(found[2]) - place) if found else mentions[place]
    runs = [[mentions[k] for k in run] for _, run in groupby(range(len(mentions)), run_of)]
    return [run[0] if len(run) == 1 else f'{run[0][:-1]}..{run[-1].partition("[")[2]}'
            for run in runs]


def data_sentence(identification: Identification) -> str:
    """Return what data an Identification rests on, how fitted and what was held out."""
    names = ', '.join(identification.sources)
    held = (f"held out: {', '.join(identification.holdouts)}" if identification.holdouts
            else 'blocks of time held out')
    return (f'{identification.duration:.4g} s at {1.0 / identification.period:.4g} Hz from '
            f'{names}; {held}')
