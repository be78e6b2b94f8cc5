# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Who sends commands or references, two at once among them, and since when nobody does."""

_WINDOW = 50_000_000   # a source that was heard within this is still there [ns]
UNNAMED = 'somebody without a source label'


class SourceWatch:
    """
    Tell two who send at once.

    Parameters
    ----------
    what : str
        They do, such as 'controllers command'.

    """

    def __init__(self, what):
        self._what, self._heard, self._conflict = what, {}, ''

    def hear(self, source, now):
        """
        Note that somebody sends, acted on or not.

        Parameters
        ----------
        source : str
            As its layout says; '' if that says nothing.
        now : int
            Time [ns].

        Returns
        -------
        str
            A sentence that names both if another one sends as well; else ''.

        """
        self._heard[source] = now
        self._conflict = ''
        if len(self._heard) > 1:
            self._forget(now)
        if len(self._heard) > 1:
            names = sorted(name or UNNAMED for name in self._heard)
            self._conflict = f"{len(names)} {self._what} at once: {' and '.join(names[:4])}"
        return self._conflict

    def _forget(self, now):
        self._heard = {name: time for name, time in self._heard.items() if now - time <= _WINDOW}

    def conflict(self, now):
        """Return what `hear` did last (str); '' once nobody sends any more."""
        if self._conflict:
            self._forget(now)
            if not self._heard:
                self._conflict = ''
        return self._conflict


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
        self._sources = SourceWatch('controllers command')
        self.last, self.source = None, ''

    def hear(self, source, now):
        """Note that somebody commands, acted on or not; see `SourceWatch.hear`."""
        return self._sources.hear(source, now)

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
