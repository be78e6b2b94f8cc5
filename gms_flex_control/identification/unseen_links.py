# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Flexible joints of which only the motor was recorded.

The motor equation gives the spring's torque and so the link: ``q_link = q_motor - (u - J
ddq_motor) / K``. One equation per joint remains, that of link and motor together.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.data.recording import COVERED, even_time, held_torque, Recording, resampled
from gms_flex_control.dynamics.chain import own_inertia
from gms_flex_control.identification.check_basis import absent_joints
from gms_flex_control.identification.sampling_checks import clock
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.simulation import plant
import numpy as np

_INERTIA_NOISE = 0.05  # of the usual torque: noise of an unseen link's inertia torque


class UnseenLink(NamedTuple):
    """A link without encoder."""

    joint: int
    stiffness: float  # as believed [N m/rad]
    inertia: float    # of the motor, as believed [kg m^2]
    window: int       # of the low-pass its angle is seen through, samples
    fine: bool        # whether noise of the encoder sets that no limit

    def angle(self, motor: np.ndarray, torque: np.ndarray, period: float) -> np.ndarray:
        """Return where the link is (T,) [rad], of motor angles and held torques (T,) [N m]."""
        return analysis.low_pass(motor - self._torsion(motor, torque, period), self.window)

    def angle_to_fit(self, motor: np.ndarray, torque: np.ndarray, period: float) -> np.ndarray:
        """
        Return the same for a fit; of a fine encoder torsion alone is filtered.

        A fit chooses the smoothing of accelerations by the white noise of an angle. Filtered ones
        have none, and noise up to the filter's band remains, which inertia makes a large torque.
        """
        if not self.fine:
            return self.angle(motor, torque, period)
        return motor - analysis.low_pass(self._torsion(motor, torque, period), self.window)

    def _torsion(self, motor, torque, period):
        spring = analysis.held_triangle(torque) - self.inertia * (
            analysis.second_difference(motor, period))
        return spring / self.stiffness


def unseen_links(recording: Recording, robot: RobotParams) -> tuple[UnseenLink, ...]:
    """Return the flexible joints of which only the motor was recorded, joints as the robot's."""
    arm, found, inertias = robot.arm, [], own_inertia(plant.constants_of(robot).chain)[0]
    alone = recording.motors_alone
    for j in range(robot.n_joints):
        if arm.rigid[j] or not alone[j]:
            continue
        stiffness, inertia = float(arm.stiffness[j]), float(arm.motor_inertia[j])
        # the fourth derivative of white noise of density 2 noise^2 period reaches the equation
        carried = inertias[j] * inertia / stiffness * (2.0 * np.pi) ** 4
        noise = analysis.noise_of(recording.q_motor[:, j])
        density = 2.0 * noise ** 2 * recording.period * carried ** 2
        band = (9.0 * (_INERTIA_NOISE * _usual_torque(recording, j)) ** 2 / density) ** (1.0 / 9.0)
        lowest, highest = analysis.UNSEEN_BAND
        found.append(UnseenLink(j, stiffness, inertia, analysis.low_pass_window(
            np.clip(band, lowest, highest), recording.period), bool(band >= highest)))
    return tuple(found)


def _usual_torque(recording, j):
    """Return the usual torque of a joint [N m]; its command, if that was recorded."""
    known = next((torque[np.isfinite(torque)] for torque in (
        recording.command[:, j], recording.tau_motor[:, j]) if np.isfinite(torque).any()), None)
    return 1.0 if known is None else max(float(np.std(known)), 1e-12)


def with_links(recording: Recording, robot: RobotParams) -> Recording:
    """Return a Recording, joints as the robot's, with computed angles of links not seen."""
    unseen = unseen_links(recording, robot)
    if not unseen:
        return recording
    time, period = even_time(recording)
    torque, q_link = held_torque(recording, time, period), recording.q_link.copy()
    for link in unseen:
        motor = resampled(recording, recording.q_motor[:, link.joint], time,
                          f'motor angle of {robot.joints[link.joint]!r}')
        q_link[:, link.joint] = np.interp(
            recording.time, time, link.angle_to_fit(motor, torque[:, link.joint], period))
    return replace(recording, q_link=q_link)


def with_links_if_known(recording: Recording, robot: RobotParams) -> Recording:
    """
    Return a Recording, joints in any order, with computed angles of a robot's links not seen.

    The same one where nothing is to be computed, or cannot be, for want of joints, torques or even
    stamps: checks refuse that.
    """
    if absent_joints(recording, robot):
        return recording
    own = recording.of_joints(robot.joints)
    flexible = own.motors_alone & ~robot.arm.rigid
    torques = np.isfinite(own.tau_motor[2:]).mean(axis=0) > COVERED
    if not flexible.any() or not torques[flexible].all() or any(
            fault.severity == 'refuse' for fault in clock(recording)):
        return recording
    q_link = recording.q_link.copy()
    q_link[:, [recording.joints.index(joint) for joint in robot.joints]] = with_links(
        own, robot).q_link
    return replace(recording, q_link=q_link)


def driven_by_motors(recording: Recording, joints: np.ndarray) -> Recording:
    """Return a Recording in which torques of motors move the links of ``joints`` (n,), bool."""
    return replace(recording, **{name: np.where(joints, np.nan, getattr(recording, name))
                                 for name in ('q_motor', 'dq_motor')})


def words_of_computed(recording: Recording, joints: np.ndarray) -> str:
    """Return a sentence that says of which ``joints`` (n,), bool, the link is computed."""
    names = ', '.join(joint for joint, own in zip(recording.joints, joints, strict=True) if own)
    return (f'{recording.source}: the link angles of {names} were not recorded, but computed from '
            'angle, torque and inertia of the motor and the stiffness of the spring: friction is '
            'that of motor and link together, and errors of all these are in it')
