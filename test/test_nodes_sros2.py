# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The SROS2 policy names exactly what the running nodes publish, subscribe to, serve and call."""

from pathlib import Path
import time
from xml.etree import ElementTree

from node_harness import CONFIG, FILES, Lab
import pytest

DiagnosticArray = pytest.importorskip('diagnostic_msgs.msg').DiagnosticArray
POLICY = Path(__file__).parents[1] / 'sros2' / 'gms_flex_control.policy.xml'
RIGHTS = {'publish': 'publisher', 'subscribe': 'subscriber', 'reply': 'service',
          'request': 'client'}
DISCOVERED = 30.0  # after so long everything has found each other [s]
# only with use_sim_time, a URDF from a topic, or control_msgs
SOMETIMES = {(node, 'subscribe', topic) for topic in ('/clock', '/robot_description')
             for node in ('plant', 'cascade_controller', 'trajectory', 'identification')} | {
    ('trajectory', 'execute', '/trajectory/follow_joint_trajectory')}


def allowed(*enclaves):
    """Return every (node, right, name) the policy allows in some enclaves, by default in all."""
    paths = {f'/gms_flex_control/{name}' for name in enclaves}
    return {(profile.get('node'), right, name.text.strip())
            for enclave in ElementTree.parse(POLICY).iter('enclave')
            if not paths or enclave.get('path') in paths
            for profile in enclave.iter('profile')
            for rule in profile for right, word in rule.attrib.items() if word == 'ALLOW'
            for name in rule}


def used_in(lab, granted):
    """Return every (node, right, name) of the nodes of a lab, once all ``granted`` was seen."""
    found, end = set(), time.monotonic() + DISCOVERED

    def complete():
        """Look again, at least until everything that is allowed was seen."""
        for node in lab.node.get_node_names():
            for right, kind in RIGHTS.items():
                get = getattr(lab.node, f'get_{kind}_names_and_types_by_node')
                found.update((node, right, name) for name, _ in get(node, '/')
                             if '/_action/' not in name)
        return granted - found <= SOMETIMES or time.monotonic() > end
    lab.until(complete)
    lab.more(lab.listen(DiagnosticArray, '/diagnostics'), 3)  # what comes late is seen too
    complete()
    return {entry for entry in found if entry[0] != 'probe'}


def test_the_policy_is_one_that_sros2_reads():
    """Version, enclave paths and the words of its schema."""
    root = ElementTree.parse(POLICY).getroot()
    assert root.tag == 'policy' and root.get('version') == '0.2.0'
    assert all(enclave.get('path').startswith('/gms_flex_control/')
               for enclave in root.iter('enclave'))
    for profile in root.iter('profile'):
        assert profile.get('ns') == '/'
        for rule in profile:
            assert rule.tag in ('topics', 'services', 'actions')
            assert set(rule.attrib.values()) == {'ALLOW'}
            assert {name.tag for name in rule} == {rule.tag.removesuffix('s')}


@pytest.mark.parametrize('enclaves', [
    ('plant', 'controller', 'trajectory', 'identification'), ('bridge',)])
def test_what_the_nodes_do_is_allowed_and_nothing_else(enclaves, tmp_path):
    """All nodes with a simulated robot, in lockstep, and the bridge."""
    granted = allowed(*enclaves)
    with Lab(tmp_path) as lab:
        if enclaves == ('bridge',):
            lab.start('plant_node', files=[*FILES, CONFIG / 'bridge.yaml'])
        else:
            for name in ('controller_node', 'trajectory_node', 'plant_node'):
                lab.start(name, mode='lockstep')
            lab.start('identification_node', files=[*FILES, CONFIG / 'identification.yaml'],
                      mode='lockstep', identification__bag=str(lab.folder / 'bag'))
        used = used_in(lab, granted)
    assert used - granted == set()
    assert granted - used - SOMETIMES == set()


def test_only_one_node_may_command_or_refer_or_speak_with_the_robot():
    publishers = {name: {node for node, right, topic in allowed()
                         if right == 'publish' and topic == name}
                  for name in ('/effort_controller/commands', '/reference', '/joint_states',
                               '/robot/effort_controller/commands')}
    assert publishers == {'/effort_controller/commands': {'cascade_controller'},
                          '/reference': {'trajectory'}, '/joint_states': {'plant'},
                          '/robot/effort_controller/commands': {'plant', '_plant_guardian'}}
