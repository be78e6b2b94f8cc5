# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Layouts for PlotJuggler, Foxglove and RViz show what the nodes publish."""

import json
from pathlib import Path
import re
import xml.etree.ElementTree as ElementTree

from gms_flex_control.file_io import robot_file
from gms_flex_control.schema.files import load_robot
import pytest

pytestmark = pytest.mark.fast

ROOT = Path(__file__).resolve().parents[1]
ROBOT = load_robot(robot_file())
N, BLOCKS = ROBOT.friction.stiffness.shape
ARRAYS = {'/reference': 5 * N, '/effort_controller/commands': N,  # topic: numbers in it
          '/cascade_controller/blocks': N * BLOCKS}
STATES = {'/joint_states': [*ROBOT.joints, *ROBOT.motors],
          '/cascade_controller/state': list(ROBOT.joints)}
FIELDS = ('position', 'velocity', 'effort')


def foxglove():
    return json.loads((ROOT / 'layouts' / 'foxglove.json').read_text())


def plotjuggler():
    return ElementTree.parse(ROOT / 'layouts' / 'plotjuggler.xml').getroot()


def test_plotjuggler_draws_series_that_exist():
    """A joint state is /topic/joint/field to it, an array /topic/data[i]."""
    root = plotjuggler()
    known = {f'{topic}/data[{i}]' for topic, size in ARRAYS.items() for i in range(size)}
    known |= {f'{topic}/{joint}/{field}' for topic, joints in STATES.items()
              for joint in joints for field in FIELDS}
    drawn = [curve.get('name') for curve in root.iter('curve')]
    assert drawn
    assert set(drawn) <= known
    for splitter in root.iter('DockSplitter'):
        sizes = splitter.get('sizes').split(';')
        assert int(splitter.get('count')) == len(sizes) == len(splitter)


def test_plotjuggler_subscribes_to_what_it_draws():
    """What its plugin does not find in the layout it takes as false or 0."""
    root = plotjuggler()
    plugin, = root.iterfind('Plugins/plugin')
    assert root.find('previouslyLoaded_Streamer').get('name') == plugin.get('ID')
    settings = {setting.tag: setting.get('value') for setting in plugin}
    topics = settings.pop('selected_topics').split(';')
    drawn = {curve.get('name') for curve in root.iter('curve')}
    assert sorted(topics) == sorted(topic for topic in (*ARRAYS, *STATES)
                                    if any(name.startswith(f'{topic}/') for name in drawn))
    assert int(settings.pop('max_array_size')) >= max(ARRAYS.values())
    assert settings == {'use_header_stamp': 'false', 'discard_large_arrays': 'true',
                        'boolean_strings_to_number': 'true', 'remove_suffix_from_strings': 'true'}


def test_foxglove_draws_fields_that_exist():
    for name, panel in foxglove()['configById'].items():
        for path in panel.get('paths', ()):
            topic, field, index = re.fullmatch(r'(/[\w/]+)\.(\w+)\[(\d+)\]',
                                               path['value']).groups()
            size = ARRAYS[topic] if field == 'data' else len(STATES[topic])
            assert field in ('data', *FIELDS), name
            assert int(index) < size, name
