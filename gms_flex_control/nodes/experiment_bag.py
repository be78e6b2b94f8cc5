# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The recording of an experiment, and by its growth the signs of life of the other nodes."""

import time

from gms_flex_control.bags.writer import BagWriter
from gms_flex_control.nodes.recorder import Recorder

STATES, COMMANDS, REFERENCE = 'joint_states', 'effort_controller/commands', 'reference'
_WHO = {STATES: 'joint states', COMMANDS: 'commands of the controller',
        REFERENCE: 'references of the trajectory node'}


class ExperimentBag:
    """
    A bag of the experiment's topics; use it in a ``with`` statement.

    Parameters
    ----------
    node : rclpy.node.Node
        Which subscribes.
    path : Path
        The bag to be made.
    topics : sequence of str
        Names in the node's namespace; the loop's three among them.
    say : callable
        Called with a sentence when something happens.

    """

    def __init__(self, node, path, topics, say):
        self._writer = BagWriter(path)
        self._node, self._say = node, say
        self._topics = [node.resolve_topic_name(topic) for topic in topics]
        self._who = {node.resolve_topic_name(topic): words for topic, words in _WHO.items()}
        self._growth = {}

    def __enter__(self):
        """Make the bag and begin to record."""
        self._writer.__enter__()
        self._recorder = Recorder(self._node, self._writer, self._topics, self._say)
        return self

    def poll(self):
        """Look for topics and for errors of the disk; raises BagError."""
        self._recorder.poll()

    @property
    def missing(self):
        """Return the topics that nobody publishes yet."""
        return self._recorder.missing

    def silent(self, bound):
        """Return what has not grown for ``bound`` seconds (list of str)."""
        now, found = time.monotonic(), []
        for topic, words in self._who.items():
            count = self._writer.counts.get(topic, 0)
            known, since = self._growth.get(topic, (None, now))
            if count != known:
                self._growth[topic] = (count, now)
            elif now - since > bound:
                found.append(words)
        return found

    def __exit__(self, *failure):
        """End the recording and the bag."""
        try:
            self._recorder.close()
        finally:
            self._writer.__exit__(*failure)
