# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The metadata.yaml of a bag folder, and the message definitions and type hashes of a bag."""

from functools import lru_cache
from typing import NamedTuple

from gms_flex_control.errors import BagError
from gms_flex_control.file_io import read_yaml
from ruamel.yaml.error import YAMLError

try:  # every module on bags imports this one first
    import mcap  # noqa: F401
    from rosbags.typesys import get_typestore, Stores
    from rosbags.typesys.base import TypesysError
except ImportError as error:  # rosdep has no package of Ubuntu for them
    raise BagError('bags need mcap and rosbags for Python: pip install '
                   "'mcap>=1.5,<2' 'rosbags>=0.11,<0.12', on Ubuntu 24.04 with --user "
                   '--break-system-packages or in a virtual environment') from error


class Definition(NamedTuple):
    """What a bag says about a message type."""

    text: str       # the ros2msg text with its dependencies
    type_hash: str  # RIHS01_...


@lru_cache(maxsize=1)
def _typestore():
    return get_typestore(Stores.ROS2_JAZZY)


@lru_cache(maxsize=256)
def definition(type_name) -> Definition:
    """Return the Definition of a standard message type of Jazzy; BagError if it is none."""
    store = _typestore()
    try:
        text, _ = store.generate_msgdef(type_name, ros_version=2)
        return Definition(text, store.hash_rihs01(type_name))
    except (TypesysError, KeyError) as error:
        raise BagError(f'message type {type_name!r} is not a standard type of Jazzy ({error}); '
                       "leave its topic out, or record it with 'ros2 bag record'") from error


LARGEST = 10_000_000  # bytes; a thousand topics take some hundred thousand
NEVER = 2**63 - 1  # starting time of a bag without messages

_FOREVER = {'sec': 9223372036, 'nsec': 854775807}


def qos_profile(reliability='reliable', durability='volatile') -> dict:
    """Return one offered QoS profile, as `ros2 bag record` writes it."""
    return {'history': 'unknown', 'depth': 0, 'reliability': reliability,
            'durability': durability, 'deadline': _FOREVER, 'lifespan': _FOREVER,
            'liveliness': 'automatic', 'liveliness_lease_duration': _FOREVER,
            'avoid_ros_namespace_conventions': False}


class TopicEntry(NamedTuple):
    """One topic in the metadata."""

    name: str
    type_name: str
    type_hash: str
    qos: dict  # the offered profile
    count: int


def information(topics, file_name, start, end, custom=None) -> dict:
    """Return the metadata of a bag of one mcap file, below ``rosbag2_bagfile_information``."""
    count = sum(topic.count for topic in topics)
    begin, duration = (int(start), int(end - start)) if count else (NEVER, 0)
    time = {'duration': {'nanoseconds': duration},
            'starting_time': {'nanoseconds_since_epoch': begin}}
    return {
        'version': 9, 'storage_identifier': 'mcap', **time, 'message_count': count,
        'topics_with_message_count': [{
            'topic_metadata': {
                'name': topic.name, 'type': topic.type_name, 'serialization_format': 'cdr',
                'offered_qos_profiles': [topic.qos], 'type_description_hash': topic.type_hash},
            'message_count': topic.count} for topic in topics],
        'compression_format': '', 'compression_mode': '', 'relative_file_paths': [file_name],
        'files': [{'path': file_name, **dict(reversed(time.items())), 'message_count': count}],
        'custom_data': custom or None,
        'ros_distro': 'jazzy'}


class FolderMetadata(NamedTuple):
    """What of a metadata.yaml matters for reading."""

    files: tuple          # names relative to the folder
    count: int            # messages announced; 0 as long as the recorder runs
    custom: dict
    topics: tuple         # names


def load(path) -> FolderMetadata:
    """Return the FolderMetadata in a metadata.yaml; BagError if it is of no bag."""
    try:
        info = read_yaml(path, 'safe', LARGEST)['rosbag2_bagfile_information']
        return FolderMetadata(tuple(str(name) for name in info['relative_file_paths']),
                              int(info['message_count']),
                              dict(info.get('custom_data') or {}), _topic_names(info))
    except (OSError, UnicodeDecodeError, YAMLError, KeyError, TypeError, ValueError,
            AttributeError) as error:
        reason = ' '.join(str(error).split())[:120]
        raise BagError(f'{path}: is not the metadata of a bag ({type(error).__name__}: {reason}); '
                       "the bag's files are read without it") from error


def _topic_names(info):
    """Return the names of the topics; none where they are not written as rosbag2 writes them."""
    listed = info.get('topics_with_message_count') or ()
    metadata = [one.get('topic_metadata') for one in listed if isinstance(one, dict)]
    return tuple(str(one['name']) for one in metadata if isinstance(one, dict) and 'name' in one)
