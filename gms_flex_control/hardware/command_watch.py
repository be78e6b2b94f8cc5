# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Who commands, and since when nobody does."""

_WINDOW = 50_000_000   # a source that was heard within this is still there [ns]
UNNAMED = 'somebody without a source label'


class CommandWatch:
    """
    Tell two commanding controllers and the silence of one.

    Attributes
    ----------
    last : int or None
        When the last command came that was acted on [ns].
    source : str
        Who sent it.

    """

    def __init__(self):
        self.last, self.source = None, ''
        self._heard = {}

    def hear(self, source, now):
        """
        Note that somebody commands, acted on or not.

        Parameters
        ----------
        source : str
            As its layout says; '' if that says nothing.
        now : int
            Time [ns].

        Returns
        -------
        str
            A sentence that names both if another one commands as well; else ''.

        """
        self._heard[source] = now
        if len(self._heard) == 1:
            return ''
        self._heard = {name: time for name, time in self._heard.items() if now - time <= _WINDOW}
        if len(self._heard) == 1:
            return ''
        names = sorted(name or UNNAMED for name in self._heard)
        return f"{len(names)} controllers command at once: {' and '.join(names[:4])}"

    def take(self, source, now):
        """Note that a command is acted on."""
        self.last, self.source = now, source

    def silence(self, now):
        """Return how long nobody has commanded [ns]; None if nobody ever did."""
        return None if self.last is None else now - self.last

    @property
    def name(self):
        """Return who commanded last."""
        return self.source or UNNAMED
