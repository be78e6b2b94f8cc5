# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How the nodes of one process reach each other: topics and services without DDS in between.

A message is published for everybody else, and given to those who hear its topic in the same
process. They do not hear it once more from DDS, see transport.py.
"""

from collections import defaultdict
import threading

from gms_flex_control.nodes import process
from gms_flex_control.nodes.serialized import Serialized


class Direct:
    """
    What one process hears and serves itself.

    Attributes
    ----------
    lock : threading.RLock
        Taken by whoever runs a callback of these nodes or a sample of their loop.
    hearers : dict of str to list of callable
        Topic -> those who take its messages, in the order in which they are called.
    services : dict of str to callable
        Name -> the handler of a service, which takes request and response.

    """

    def __init__(self):
        self.lock = threading.RLock()
        self.hearers, self.services = defaultdict(list), {}


class Outlet:
    """
    Publisher of one reused message, which nodes of the same process may hear.

    Parameters
    ----------
    node : rclpy.node.Node
        Who publishes; it has ``direct``, a Direct.
    kind : type
        Of the message: JointState or Float64MultiArray.
    topic : str
        Its name.
    mode : {'realtime', 'lockstep'}
        Of the loop.

    """

    def __init__(self, node, kind, topic, mode='realtime'):
        self._publisher = node.create_publisher(kind, topic, process.publisher_qos(mode))
        self._hearers = node.direct.hearers[self._publisher.topic_name]
        self._serialized = None

    def publish(self, message):
        """Publish the message, and give it to those who hear it here; they keep nothing of it."""
        if self.count_others():
            if self._serialized is None:
                self._serialized = Serialized(message)
            self._publisher.publish(self._serialized.data())
        for hear in self._hearers:
            hear(message)

    def count_others(self):
        """Return how many other processes' subscriptions take the message."""
        return self._publisher.get_subscription_count()

    def count_hearers(self):
        """Return how many take the message, here and elsewhere."""
        return self.count_others() + len(self._hearers)

    def wait_for_all_acked(self, timeout):
        """Wait until those who acknowledge have what was published, for ``timeout`` at most."""
        self._publisher.wait_for_all_acked(timeout)
