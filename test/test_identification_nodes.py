# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The nodes take friction.yaml as it was written, through ROS 2's own parser."""

from gms_flex_control.identification.output import write_friction
from identified import identification
from node_harness import FILES, Lab


def test_plant_and_controller_node_start_with_an_identified_friction_file(tmp_path):
    write_friction(identification(), tmp_path / 'friction.yaml')
    files = [*FILES, tmp_path / 'friction.yaml']
    with Lab(tmp_path) as lab:
        nodes = [lab.start(name, files=files) for name in ('plant_node', 'controller_node')]
        lab.until(lambda: all('[INFO]' in node.printed() for node in nodes))
        assert all(node.runs for node in nodes)
