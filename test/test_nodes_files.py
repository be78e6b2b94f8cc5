# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What nodes say of parameter files they cannot use: one sentence, exit code 2, no traceback."""

from concurrent.futures import ThreadPoolExecutor

from gms_flex_control.identification.output import write_friction
from identified import identification
from node_harness import CONFIG, FILES, Lab, PATIENCE, TERM, write_parameters
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

EXAMPLE = CONFIG.parent / 'examples' / 'industrial_arm'
ARM = [EXAMPLE / 'robot.yaml', EXAMPLE / 'controller.yaml']
# node, text of a file (None: it is missing), what the sentence says, and the files before it if
# not the usual two; values that no robot has are test_schema's
REFUSED = {
    'unknown key of another node': (
        'plant_node', 'trajectory: {tpye: hold}', "did you mean 'trajectory.type'?"),
    'via points': (
        'trajectory_node', 'trajectory: {type: via_points, joint1: {points: [0.0, 1.0]}}',
        'each joint needs the same number of points, got [2, 3]'),
    'no YAML': ('controller_node', 'gains: [', "Couldn't parse params file"),
    'name of a topic': ('plant_node', 'emergency_stop_topic: a b',
                        "'a b' is not the name of a topic or service: topic name must not"),
    'name of a service': ('plant_node', 'hold_services: [a b]',
                          "'a b' is not the name of a topic or service: "),
    'missing file': ('plant_node', None, 'Error opening YAML file'),
    'no robot': ('controller_node', 'mode: realtime', 'joints is missing: no robot file was read',
                 FILES[1:]),
    'limit of a URDF': (
        'trajectory_node', 'trajectory: {joint2: {amplitude: 1.7}}', 'its limit of 1.6 rad in ',
        [EXAMPLE / 'robot.yaml', EXAMPLE / 'trajectory.yaml']),
}


@pytest.fixture(scope='module')
def outcomes(tmp_path_factory):
    """Start every node with its bad file, two at a time; return what became of each."""
    folder = tmp_path_factory.mktemp('files')
    with Lab(folder) as lab:
        def start(case, name, text, files=FILES, **parameters):
            path = folder / f'{case.replace(" ", "_")}.yaml'
            if text is not None:
                write_parameters(path, text)
            space = f'__ns:=/{path.stem}'  # of its own: two of one name refuse each other
            node = lab.start(f'{name}.{case}', files=[*files, path], arguments=('-r', space),
                             **parameters)
            return node.wait(PATIENCE), node.printed(), path

        with ThreadPoolExecutor(2) as pool:
            running = {case: pool.submit(start, case, name, text, *files)
                       for case, (name, text, _, *files) in REFUSED.items()}
            running['no URDF'] = pool.submit(
                start, 'no URDF', 'controller_node', 'arm: {urdf: /robot_description}', files=ARM)
            # whole numbers where doubles belong, and parameters of ROS itself
            running['whole numbers'] = pool.submit(
                start, 'whole numbers', 'plant_node',
                'arm: {joint1: {mass: 2}}\nrate: 500\nfriction: {joint1: {stiffness: '
                '[2, 6, 7, 64, 11, 111]}}\nuse_sim_time: false', duration=0.02)
            running['empty lists'] = pool.submit(start, 'empty lists', 'plant_node',
                                                 'hold_services: []\nmotors: []', duration=0.02)
            return {case: result.result() for case, result in running.items()}


@pytest.mark.parametrize('case', REFUSED)
def test_a_bad_file_is_refused_in_one_sentence(outcomes, case):
    code, printed, path = outcomes[case]
    sentence = REFUSED[case][2]
    assert code == 2 and 'Traceback' not in printed
    # beside what is logged: 'Failed to parse global arguments' of rcl, and how the node starts
    lines = [line for line in printed.splitlines() if not line.startswith('[')]
    assert len(lines) == 1 and sentence in lines[0], printed
    assert lines[0].startswith(('plant_node', 'controller_node', 'trajectory_node'))
    if case in ('no YAML', 'missing file'):
        assert str(path) in lines[0]


@pytest.mark.parametrize('case', ['whole numbers', 'empty lists'])
def test_what_ros_has_no_other_type_for_is_taken(outcomes, case):
    code, printed, _ = outcomes[case]
    assert code == 0 and 'Traceback' not in printed, printed


def test_shipped_and_identified_files_are_accepted_by_every_node(tmp_path):
    """Through ROS 2's own parser."""
    write_friction(identification(), tmp_path / 'friction.yaml')
    with Lab(tmp_path) as lab:
        files = [*FILES, CONFIG / 'sinusoid.yaml', CONFIG / 'polynomial.yaml',
                 tmp_path / 'friction.yaml']
        nodes = [lab.start(name, files=files)
                 for name in ('plant_node', 'controller_node', 'trajectory_node')]
        lab.until(lambda: all('[INFO]' in node.printed() for node in nodes))
        assert all(node.runs for node in nodes)


def test_a_urdf_comes_from_the_topic_that_the_robot_file_names_or_the_node_says_so(
        outcomes, tmp_path):
    code, printed, _ = outcomes['no URDF']
    assert code == 2
    assert ('arm.urdf: no URDF came on the topic /robot_description in 5 s; start '
            'robot_state_publisher, or name a URDF file') in printed
    files = [*ARM, write_parameters(tmp_path / 'topic.yaml', 'arm: {urdf: /robot_description}')]
    with Lab(tmp_path) as lab:
        publisher = lab.node.create_publisher(String, '/robot_description', QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        urdf, = EXAMPLE.glob('*.urdf')
        publisher.publish(String(data=urdf.read_text()))
        node = lab.start('controller_node', files=files)
        lab.until(lambda: 'the URDF of /robot_description is taken' in node.printed())
        assert node.signal(TERM) == 0  # before it compiles; the bench drives such arms
