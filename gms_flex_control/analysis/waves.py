# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Waves over an angle, such as the ripple of a motor, a gear or a screw.

Behind a gear, or on a slide in metres, the teeth of a wave generator or the lead of a screw make
hundreds of waves per radian or metre. The spectrum over the angle, not over time, shows them:
passes at any speed add up there.
"""

import numpy as np

MOST = 3              # waves per joint
_FASTEST = 20.0       # a wave that passes more often at the usual speed is not looked for [Hz]
_PER_WAVE = 8.0       # bins of the angle per wave, at least
_MOST_BINS = 2 ** 22
_FINER = 8            # orders looked at per order that the span resolves
_SLOW = 0.1           # of the usual speed: below this a joint does not move
_STANDS_OUT = 20.0    # power over the median about it; noise alone reaches 10
_ABOUT = 1.5          # the median is taken from an order over this to one times this


def standing_out(angles, torques, rates, coarsest):
    """
    Return the orders at which the spectrum of torque over angle stands out.

    Parameters
    ----------
    angles, torques, rates : sequence of ndarray, shape (S,)
        Motor angle [rad], what is left of the torque [N m], and rate [rad/s] of each recording.
    coarsest : float
        Least order [1/rad].

    Returns
    -------
    tuple of float

    """
    span = max(float(np.ptp(angle)) for angle in angles)
    speed = float(np.sqrt(np.mean(np.concatenate(rates) ** 2)))
    if span <= 0.0 or speed <= 0.0:
        return ()
    finest = 2.0 * np.pi * _FASTEST / speed
    bins = int(np.ceil(_PER_WAVE * finest * span / (2.0 * np.pi)))
    if finest <= coarsest or bins > _MOST_BINS:
        return ()
    width, length = span / bins, 2 ** int(np.ceil(np.log2(_FINER * bins)))
    power = 0.0
    for angle, torque, rate in zip(angles, torques, rates, strict=True):
        moving = np.abs(rate) > _SLOW * speed
        place = np.minimum(((angle - angle.min()) / width).astype(int), bins - 1)[moving]
        forward = rate[moving] > 0.0
        for way in (forward, ~forward):  # friction jumps from one to the other
            count = np.bincount(place[way], minlength=bins)
            if not count.any():
                continue
            mean = np.bincount(place[way], torque[moving][way], bins) / np.maximum(count, 1)
            mean[count > 0] -= mean[count > 0].mean()
            power = power + np.abs(np.fft.rfft(mean, length)) ** 2
    orders = 2.0 * np.pi * np.arange(length // 2 + 1) / (length * width)
    return _peaks(orders, np.broadcast_to(power, orders.shape), coarsest, finest,
                  2.0 * np.pi / span)


def _peaks(orders, power, lowest, highest, apart):
    """Return where power stands out of what is about it, peaks ``apart`` at least."""
    inside, found = (orders >= lowest) & (orders <= highest), []
    power = np.where(inside, power, 0.0)
    while len(found) < MOST and power.any():
        best = int(np.argmax(power))
        about = (orders > orders[best] / _ABOUT) & (orders < orders[best] * _ABOUT) & inside
        if power[best] < _STANDS_OUT * np.median(power[about]):
            break
        found.append(float(orders[best]))
        power[np.abs(orders - orders[best]) < 2.0 * apart] = 0.0
    return tuple(found)
