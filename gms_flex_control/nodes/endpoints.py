# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Publishers and subscribers that DDS does not connect because of their quality of service."""

from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile

_COMMON = ('rosout', 'parameter_events')
_ENDLESS = 2**62  # the graph tells a duration that was never set as about this or more [ns]


def mismatches(node):
    """
    Yield a sentence for every endpoint of others that does not fit one of ``node``.

    It reads the graph: QoS events would tell sooner, but with the EventsExecutor they can
    deadlock.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose topics are looked at.

    Yields
    ------
    str
        Names the topic, the other node and the policy.

    """
    for own in node.subscriptions:
        for other in node.get_publishers_info_by_topic(own.topic_name):
            yield from _complaint(own.topic_name, other, other.qos_profile, own.qos_profile,
                                  'publishes what cannot be received here')
    for own in node.publishers:
        if own.topic_name.rsplit('/', 1)[-1] in _COMMON:
            continue
        for other in node.get_subscriptions_info_by_topic(own.topic_name):
            yield from _complaint(own.topic_name, other, own.qos_profile, other.qos_profile,
                                  'requests more than is offered here')


def _complaint(topic, other, offered, requested, what):
    compatible, reason = qos_check_compatible(_plain(offered), _plain(requested))
    if compatible == QoSCompatibility.ERROR:
        reason = ' '.join(str(reason).removeprefix('ERROR: ').split()).rstrip(';')
        yield (f'QoS mismatch on {topic}: {other.node_namespace.rstrip("/")}/{other.node_name} '
               f'{what} ({reason})')


def _plain(profile):
    """Return the policies that matter, endless durations as if they had never been set."""
    given = {name: value for name in ('deadline', 'liveliness_lease_duration')
             if 0 < (value := getattr(profile, name)).nanoseconds < _ENDLESS}
    return QoSProfile(depth=1, reliability=profile.reliability, durability=profile.durability,
                      **given)
