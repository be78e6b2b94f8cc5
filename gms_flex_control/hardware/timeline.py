# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Stamps of one source of joint states as one steady time, whatever its clock does."""

TOLERANCE = 20_000_000   # a stamp that far from its arrival is of another clock [ns]
_WAITED = 100_000_000    # a sample that had to wait comes so late at most [ns]
_BACKLOG = 200_000_000   # and after so long one is in time again [ns]
_CALM = 5_000_000        # nothing is corrected within that [ns]
_SLEW = 1e-3             # how fast a drifting clock is followed, beyond any quartz


class Timeline:
    """
    Map stamps to a time that never jumps and never runs backwards.

    A stamp near the time of arrival is taken as it is, so that recordings of robot and bridge
    agree. One of another clock is shifted by a constant, which follows slow drift and is chosen
    anew when that clock jumps. Samples that come late because they had to wait are no jump: the
    next ones are in time again. A source without stamps has the time of arrival.

    Attributes
    ----------
    jumps : int
        How often the clock of the source jumped.

    """

    def __init__(self):
        self._stamp = self._offset = self._last = None
        self._arrival = 0
        self._in_time = None       # when a sample last came as its stamp has it
        self.jumps = 0

    def read(self, stamp, now):
        """
        Return the time of a sample.

        Parameters
        ----------
        stamp : int
            As sent [ns]; 0 if the source has no clock.
        now : int
            When it arrived, by a steady clock [ns].

        Returns
        -------
        int or None
            Time [ns], above all before; None if this is no new sample: its stamp is that of the
            one before, or it was overtaken on its way.

        """
        if stamp == 0:
            return self._keep(now, now)
        if stamp == self._stamp:
            return None
        if self._offset is None or self._is_of_another_clock(stamp, now):
            self.jumps += self._offset is not None
            self._offset = 0 if abs(stamp - now) <= TOLERANCE else now - stamp
        if abs(stamp + self._offset - now) <= TOLERANCE:
            self._in_time = now
        self._stamp = stamp
        self._follow(stamp, now)
        return self._keep(stamp + self._offset, now)

    def _is_of_another_clock(self, stamp, now):
        late = now - stamp - self._offset
        if abs(late) <= TOLERANCE:
            return False
        waited = 0 < late <= _WAITED and stamp > self._stamp
        return not waited or now - self._in_time > _BACKLOG

    def _follow(self, stamp, now):
        behind = now - stamp - self._offset
        if abs(behind) > _CALM and self._last is not None:
            most = round(_SLEW * (now - self._arrival))
            self._offset += max(-most, min(most, behind))

    def _keep(self, time, now):
        self._arrival = now
        if self._last is not None and time <= self._last:
            return None
        self._last = time
        return time
