# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Torques and angles of the recording that were not stamped at the same time."""

from gms_flex_control.effects import signals as sig
from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
import numpy as np

_BEYOND = 1.0  # for how long the first and the last torque are held outside the recording [s]


def torque_at_angles(torque, period, delay) -> np.ndarray:
    """
    Return torques as they acted where the recorded angles belong.

    The same delay seen from the torques: exact, where clearing angles of it amplifies their
    noise from some frequency below 1 / (6 delay) on.

    Parameters
    ----------
    torque : ndarray, shape (T, n_joints)
        As recorded, held over samples [N m].
    period : float
        Sample [s].
    delay : float
        By which all angles are older than the torques [s].

    Returns
    -------
    ndarray, shape (T, n_joints)
        Mean over each sample [N m].

    """
    edges = np.arange(len(torque) + 1) * period
    times = np.concatenate([[-_BEYOND], edges, [edges[-1] + _BEYOND]])
    lengths = np.concatenate([[_BEYOND], np.full(len(torque), period), [_BEYOND]])
    held = np.concatenate([torque[:1], torque, torque[-1:]]) * lengths[:, None]
    total = np.concatenate([np.zeros_like(torque[:1]), np.cumsum(held, axis=0)])
    return np.stack([np.diff(np.interp(edges - delay, times, column)) / period
                     for column in total.T], axis=1)


class RecordingDelay(Term):
    """
    Measured q(t) -> q(t - delay) of all links and motors, to second order in the delay.

    A fault of the recording: the drives act in time, torques are merely stamped early against
    the angles (delay above zero) or late (below).
    """

    name = 'recording_delay'
    stage = Stage.SENSOR
    whole_arm = True
    evidence = 'time since reversal'
    confusable = ('actuator_lag', 'input_delay')
    discriminated_by = ('fast motion of each joint in turn: drives are late one by one, a '
                        'recording at once')
    needs_link_encoder = True
    of_feedback = True
    of_recording = True
    parameters = (Parameter('delay', 's', 'by which all angles are older than the torques',
                            lower=-0.02, upper=0.02, typical=3e-3),)
    guesses = staticmethod(lambda s: linear(0.0005))

    @staticmethod
    def torque_acted(torque, period, values) -> np.ndarray:
        return torque_at_angles(torque, period, values[0])

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        for j in range(int(s[sig.JOINTS])):
            k = sig.WIDTH * j
            s[k + sig.SENSED_LINK] -= p[0] * (s[k + sig.DQ_LINK] - 0.5 * p[0] * s[
                k + sig.DDQ_LINK])
            s[k + sig.SENSED_MOTOR] -= p[0] * (s[k + sig.DQ_MOTOR] - 0.5 * p[0] * s[
                k + sig.DDQ_MOTOR])
