# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A recording as the predictor needs it: even segments of link angles and drive torques."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
import warnings

from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.data.recording import even_grid, means_held, Recording
from gms_flex_control.dynamics.chain import inverse_dynamics, mass_matrices
from gms_flex_control.effects.base import Stage
from gms_flex_control.effects.table import of_stages
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.assumed_robot import effects_along
from gms_flex_control.params.arm import ArmParams, carrying
from gms_flex_control.params.robot import RobotParams
import numpy as np

SHORTEST = 2.0         # a segment below this is left out [s]
SETTLE_TIME = 0.5      # at the beginning of one, when the blocks' load is not known [s]
_BRIDGED = 0.02        # torque is interpolated across gaps up to this, or two periods [s]
_SPRING_OFF = 0.5    # of the torque's rms: a spring torque further off is not believed
_OF_SPRING = (Stage.TORSION, Stage.SPRING, Stage.MOTOR)  # effects in the motor equation
_THIN = 20             # samples from one pose to the next whose inertia is looked at
_EVEN = 0.02           # stamps within this part of a period of an even grid count as even
_TURNING = 0.02        # of the usual rate: so slow is a reversal
_HELD, _MOVED = 0.02, 0.1  # of its widest travel: less is a joint held, more is one moved
_STANDING = 3.0        # encoder steps per 50 ms: slower is no motion for a fit of the torque
_REPEATS = 0.02        # of readings that are those before: an encoder that counts
_QUICK = 100.0         # counts in a sample, as a rule: quicker motion hardly shows them


class TorqueWarning(UserWarning):
    """The torque on the links was not taken from where one would expect."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment:
    """One evenly sampled part of a recording without gaps in torque."""

    begin: float              # time of the first sample in the recording [s]
    angle: np.ndarray         # (T, n), link angles [rad]; NaN where a sample was lost
    rate: np.ndarray          # (T, n), smoothed without lag [rad/s]
    acceleration: np.ndarray  # (T, n), likewise [rad/s^2]
    torque: np.ndarray        # (T, n), mean drive torque on each link to the next sample [N m]
    tested: np.ndarray        # (T, n) bool, the experiment is on that joint; all true if unknown
    phase: np.ndarray         # (T,) str, name of the phase; '' if not known
    source: str               # recording it comes from
    factor: np.ndarray        # (T, n), by which effects multiply the friction
    window: int = 5           # samples of the longest smoothing window
    taken: np.ndarray | float = 0.0  # (T, n), what was subtracted from the drive's torque [N m]
    first_block: int = 0      # number of its first block of time among those of all segments

    def of_joints(self, columns: list) -> 'Segment':
        """Return the Segment of some joints (list of int), which do not act on each other."""
        taken = np.broadcast_to(self.taken, self.torque.shape)[:, columns]
        return replace(self, taken=taken, **{name: getattr(self, name)[:, columns] for name in (
            'angle', 'rate', 'acceleration', 'torque', 'tested', 'factor')})


def drive_sides(recording: Recording, robot: RobotParams) -> tuple:
    """
    Return for each joint what moves its link: 'spring', or the torque of the 'motor' directly.

    'spring' where the joint is flexible, both sides were measured, and the spring's torque agrees
    with the motor equation as far as a torque was recorded, of a plain spring and motor; else a
    TorqueWarning says so. Raises IdentificationError if a joint has neither. Joints of the
    recording in the robot's order.
    """
    sides, described = [], {spec.joint for spec in of_stages(robot, *_OF_SPRING)}
    changes = _torque_changes(recording)
    for j, joint in enumerate(robot.joints):
        two_sided = not robot.arm.rigid[j] and np.isfinite(recording.q_motor[:, j]).any()
        has_torque = np.isfinite(recording.tau_motor[:, j]).any()
        if not two_sided and not has_torque:
            raise IdentificationError(
                f'{recording.source}: {joint} has neither a motor torque (effort) nor angles of '
                'both sides of a spring; record the effort, or the motor side as well')
        if two_sided and changes[j] and joint not in described:
            off = _spring_mismatch(recording, robot, j)
            if off > _SPRING_OFF:
                warnings.warn(
                    f'{recording.source}: the spring torque K (q_motor - q_link) of {joint} '
                    f'differs from the motor equation by {100 * off:.0f} % of the torque; K, J, '
                    'or the timing of the two encoders is wrong. The joint is taken as rigid and '
                    'driven by the motor torque', TorqueWarning, stacklevel=3)
                two_sided = False
        sides.append('spring' if two_sided else 'motor')
    return tuple(sides)


def driven(recording: Recording, sides: Sequence[str]) -> np.ndarray:
    """Return the joints whose links move by a known torque, bool (n,): one that ever changes."""
    return _torque_changes(recording) | (np.array(sides) == 'spring')


def _torque_changes(recording):
    return np.ptp(np.nan_to_num(recording.tau_motor[2:]), axis=0) > 0.0


def _spring_mismatch(recording, robot, j):
    """Return rms of spring torque less motor equation, over that of the motor torque."""
    known = np.isfinite(recording.q_motor[:, j]) & np.isfinite(recording.q_link[:, j]) \
        & np.isfinite(recording.tau_motor[:, j])
    if known.sum() < 100:
        return 0.0
    time, period = recording.time[known], recording.period
    grid = even_grid(time, float(np.median(np.diff(time))))
    q_link, q_motor = (np.interp(grid, time, side[known, j])
                       for side in (recording.q_link, recording.q_motor))
    # a state has the mean torque of the sample before it
    tau = np.interp(grid, time - 0.5 * period, recording.tau_motor[known, j])
    inertia = max(robot.arm.motor_inertia[j], robot.arm.stiffness[j] * period ** 2)
    window = max(analysis.odd_window(analysis.AGREE_WINDOW / period), analysis.smoothing_window(
        period, analysis.noise_of(q_motor), inertia, np.std(tau)))
    smooth = [analysis.derivatives(x, period, window) for x in (q_link, q_motor, tau)]
    spring = robot.arm.stiffness[j] * (smooth[1][0] - smooth[0][0]) + robot.arm.damping[j] * (
        smooth[1][1] - smooth[0][1])
    motor = smooth[2][0] - robot.arm.motor_inertia[j] * smooth[1][2]
    edge = slice(window, -window)
    rest = spring[edge] - motor[edge]
    return float(np.std(rest) / max(np.std(motor[edge]), 1e-300))


def rigid_where(robot: RobotParams, sides: Sequence[str]) -> RobotParams:
    """Return the robot with joints rigid that their motor torque drives, whose inertia M holds."""
    motor = np.array([side == 'motor' for side in sides])
    arm = replace(robot.arm, stiffness=np.where(motor, np.inf, robot.arm.stiffness))
    names = tuple('' if rigid else name for rigid, name in zip(motor, robot.motors, strict=True))
    return replace(robot, arm=arm, motors=names)


def segments_of(recording: Recording, robot: RobotParams, sides: Sequence[str], phases=(),
                period: float | None = None) -> list[Segment]:
    """
    Cut a recording, joints in the robot's order, into even segments.

    ``sides`` are those of `drive_sides`, ``phases`` what the experiment was doing if that is
    known, ``period`` the sample [s], that of the recording or longer. Raises IdentificationError
    if no segment is long enough.
    """
    period = period or recording.period
    stamps = np.round((recording.time - recording.time[0]) / period).astype(int)
    jitter = np.abs((recording.time - recording.time[0]) / period - stamps)
    even = np.quantile(jitter, 0.99) < _EVEN + 1e-9 * stamps[-1]
    bridged = max(round(_BRIDGED / period), 2)
    gap = np.diff(recording.time) > (bridged + 0.5) * period
    cuts = np.flatnonzero(gap | _handed_over(phases, recording)) + 1
    beside, pieces = np.pad(gap, 1), []
    for rows in np.split(np.arange(len(stamps)), cuts):
        if np.ptp(recording.time[rows]) + period >= SHORTEST:
            pieces.append(_segment(recording, robot, sides, phases, rows, period, even,
                                   (beside[rows[0]], beside[rows[-1] + 1])))
    if not pieces:
        raise IdentificationError(
            f'{recording.source}: no piece of {SHORTEST:g} s without a gap; record longer')
    return pieces


def _handed_over(phases, recording):
    """Return where the experiment goes on with another joint, bool (T - 1,)."""
    turns = [(phase.time_ns * 1e-9, phase.joint) for phase in phases if phase.joint]
    begins = [time for (time, joint), (_, before) in zip(turns[1:], turns[:-1], strict=True)
              if joint != before]
    since = recording.time - recording.time[0]
    return np.histogram(np.searchsorted(since, np.array(begins) - 1e-9) - 1,
                        np.arange(len(since)) - 0.5)[0] > 0


def _segment(recording, robot, sides, phases, rows, period, even, cut):
    """Return the Segment of some rows, whose begin and end a gap has ``cut``, bool (2,)."""
    time = recording.time[rows]
    slots = np.round((time - time[0]) / period).astype(int)
    grid = time[0] + period * np.arange(slots[-1] + 1)
    n = robot.n_joints
    angle = np.full((len(grid), n), np.nan)
    if even:
        angle[slots] = recording.q_link[rows]
    whole = np.stack([_interpolated(grid, time, recording.q_link[rows, j]) for j in range(n)], 1)
    if not even:
        angle[:] = whole
    torque = np.stack([
        _spring(recording, robot, j, grid, time, rows, whole[:, j]) if side == 'spring'
        else _motor(recording, j, grid, time, rows) for j, side in enumerate(sides)], axis=1)
    computed = ~robot.arm.rigid & ~np.isfinite(recording.q_motor).any(axis=0)
    robot = rigid_where(robot, sides)
    further, factor = effects_along(robot, grid - recording.time[0], whole,
                                    _motors(recording, grid, time, rows), torque, period)
    torque += further
    known = driven(recording, sides)
    windows = [analysis.smoothing_window(
        period, analysis.noise_of(recording.q_link[:, j]), inertia,
        np.std(torque[:, j]) if known[j] else np.inf)
        for j, inertia in enumerate(own_inertias(robot.arm))]
    smooth = [analysis.derivatives(whole[:, j], period, window)
              for j, window in enumerate(windows)]
    tested, phase = _tested(phases, recording, grid, robot.joints)
    # a gap cuts a quick motion short, and a computed link sets off on its spring: filters, which
    # see but one side of what is at an end, hide both
    begin, end = slice(max(windows)), slice(-max(windows), None)
    tested[begin] &= not cut[0]
    tested[end] &= not cut[1]
    for part in (slice(round(SETTLE_TIME / period)), end):
        tested[part, computed] = False
    return Segment(begin=float(time[0]), angle=angle, rate=np.stack([s[1] for s in smooth], 1),
                   acceleration=np.stack([s[2] for s in smooth], 1), torque=torque,
                   factor=factor, tested=tested & known, phase=phase, source=recording.source,
                   window=max(windows))


def one_by_one(pieces: list, robot: RobotParams, loads: Sequence = (),
               per_load: np.ndarray | None = None) -> tuple[list, RobotParams]:
    """
    Return what was measured of a chain as that of axes which do not act on each other.

    The links are known: the torque that the measured motion of all joints requires, but for an
    inertia of each joint's own, is subtracted from its drive. What is left moves that inertia
    against friction. ``pieces`` are the Segments of each recording, ``loads`` what it carried;
    ``per_load`` (n,) is friction per torque that moves the link, subtracted as well.
    """
    arm, n = robot.arm, robot.n_joints
    poses = np.concatenate([filled(one.angle)[::_THIN] for part in pieces for one in part])
    inertia = np.median(np.diagonal(mass_matrices(poses, arm), axis1=1, axis2=2), axis=0)

    def alone(piece, load):
        torque = inverse_dynamics(filled(piece.angle), piece.rate, piece.acceleration,
                                  carrying(arm, load))
        taken = torque - inertia * piece.acceleration
        if per_load is not None:
            taken += friction_by_load(piece, torque, per_load)
        taken = analysis.means_to_next(taken)  # as the drive is
        return replace(piece, torque=piece.torque - taken, taken=piece.taken + taken)

    nothing = np.zeros(n)
    axes = ArmParams(kind='decoupled', mass=nothing, length=nothing, com=nothing,
                     inertia=inertia - np.where(arm.rigid, arm.motor_inertia, 0.0),
                     motor_inertia=arm.motor_inertia, stiffness=arm.stiffness,
                     damping=arm.damping)
    return [[alone(piece, load) for piece in part] for part, load in zip_longest(
        pieces, loads[:len(pieces)])], replace(robot, arm=axes)


def friction_by_load(segment: Segment, carried: np.ndarray, per_load: np.ndarray) -> np.ndarray:
    """Return friction (T, n) [N m] that is ``per_load`` (n,) of the torque ``carried`` (T, n)."""
    slow = _TURNING * np.sqrt(np.mean(segment.rate ** 2, axis=0)) + 1e-300
    return per_load * np.abs(carried) * np.tanh(segment.rate / slow)


def torque_at_samples(segment: Segment) -> np.ndarray:
    """Return the drive torque at the samples (T, n), not between them [N m]."""
    torque = 0.5 * (segment.torque + np.roll(segment.torque, 1, axis=0))
    torque[0] = segment.torque[0]
    return torque


def own_inertias(arm: ArmParams) -> np.ndarray:
    """Return the diagonal of M with all links in line (n,) [kg m^2]."""
    return np.diag(mass_matrices(np.zeros((1, arm.n_joints)), arm)[0])


def filled(angle: np.ndarray) -> np.ndarray:
    """Return angles (T, n) with gaps interpolated."""
    rows = np.arange(len(angle))
    return np.stack([_interpolated(rows, rows, column) for column in angle.T], axis=1)


def _interpolated(grid, time, values):
    known = np.isfinite(values)
    if not known.any():
        raise IdentificationError('a link angle has no number at all in a piece of the recording')
    return np.interp(grid, time[known], values[known])


def _motors(recording, grid, time, rows):
    """Return the motor angles (T, n), NaN of absent ones."""
    return np.stack([np.interp(grid, time[known], angle[known]) if (
        known := np.isfinite(angle)).any() else np.full(len(grid), np.nan)
        for angle in recording.q_motor[rows].T], axis=1)


def _spring(recording, robot, j, grid, time, rows, q_link):
    """Return the mean spring torque of each period, from the angles at its ends."""
    q_motor = _interpolated(grid, time, recording.q_motor[rows, j])
    torque = robot.arm.stiffness[j] * (q_motor - q_link)
    if robot.arm.damping[j] > 0.0:
        period = grid[1] - grid[0]
        torsion = q_motor - q_link
        torque = torque + robot.arm.damping[j] * analysis.derivatives(
            torsion, period, analysis.odd_window(analysis.TORSION_WINDOW / period))[1]
    return analysis.means_to_next(torque)


def _motor(recording, j, grid, time, rows):
    """Return the torque held over each period; a state reports that of the period before it."""
    torque = recording.tau_motor[rows, j]
    known = np.isfinite(torque) | (np.arange(len(torque)) == 0)
    mean = means_held(torque[known][1:], time[known], grid)
    return np.append(mean, mean[-1])


def _tested(phases, recording, grid, joints):
    if not phases:
        return np.ones((len(grid), len(joints)), dtype=bool), np.full(len(grid), '', dtype='U20')
    begins = np.array([phase.time_ns * 1e-9 for phase in phases])
    index = np.searchsorted(begins, grid - recording.time[0] + 1e-9, side='right') - 1
    names = np.array([*(phase.phase for phase in phases), ''], dtype='U20')
    owners = np.array([*(phase.joint for phase in phases), ''])
    phase, owner = names[index], owners[index]
    return np.stack([owner == joint for joint in joints], axis=1), phase


def half_count(recording: Recording, robot: RobotParams) -> np.ndarray:
    """Return half the step of each link encoder (n,) [rad]; 0 where noise hides it."""
    half = np.zeros(robot.n_joints)
    for j in range(robot.n_joints):
        values = recording.q_link[np.isfinite(recording.q_link[:, j]), j]
        step = analysis.quantum(values)
        if step > 0.0:
            counts = np.diff(values) / step
            whole = np.abs(counts - np.round(counts)) < 0.02
            repeats = np.mean(counts == 0.0) > _REPEATS
            # a quick joint repeats none; where it is far quicker, counts do not matter
            quick = np.median(np.abs(counts)) < _QUICK and analysis.white_noise_of(values) < step
            if whole.mean() > 0.99 and (repeats or quick):
                half[j] = 0.5 * step
    return half


def resolution(segments: Sequence[Segment], joint: int, count: float) -> float:
    """Return the encoder step, or three times the noise where there is no step [rad]."""
    if count > 0.0:
        return count
    noise = [analysis.white_noise_of(segment.angle[:, joint]) for segment in segments]
    return max(3.0 * float(np.nanmedian(noise)), 1e-9)


def travel(segments: Sequence[Segment], joint: int) -> float:
    """Return the range of a joint's angle [rad]."""
    return float(max(np.nanmax(segment.angle[:, joint]) for segment in segments)
                 - min(np.nanmin(segment.angle[:, joint]) for segment in segments))


def while_moved(segments: Sequence[Segment], recordings: Sequence[Recording],
                presliding=True) -> list[Segment]:
    """
    Return segments in which a joint is tested only if it is not held while others are moved.

    What it gives way then says nothing of its friction. Where all are held, its ``presliding`` is
    tested. Widths are compared with those of whole ``recordings``: gaps cut a motion.
    """
    if not segments:
        return []
    width = np.array([[travel([one], j) for j in range(one.torque.shape[1])] for one in segments])
    widest = np.max([np.nanmax(one.q_link, axis=0) - np.nanmin(one.q_link, axis=0)
                     for one in recordings], axis=0)
    share = width / np.maximum(widest, _MOVED * widest.max() + 1e-300)
    held = share < _HELD
    if presliding:
        held &= (share > _MOVED).any(axis=1)[:, None]
    return [replace(one, tested=one.tested & ~own) for one, own in zip(
        segments, held, strict=True)]


def smooth_angle(rate: np.ndarray, period: float) -> np.ndarray:
    """Return the angles (T, n) whose derivative is a smoothed rate (T, n)."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * period
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])


def standing(step: float) -> float:
    """Return the velocity below which a joint does not count as moving [rad/s]."""
    return _STANDING * step / 0.05


def moving(segment: Segment, joint: int, step: float, half: float) -> np.ndarray:
    """
    Return where the motion of a joint determines its torque, bool (T,).

    Within one count of an encoder stiff blocks reach most of F_s: a motion seen through counts
    says nothing of the torque of a joint at rest. There the innovations judge.
    """
    if half == 0.0:
        return np.ones(len(segment.rate), dtype=bool)
    return np.abs(segment.rate[:, joint]) > standing(step)
