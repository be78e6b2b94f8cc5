# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The identification node with real nodes over DDS: whole runs, and every way one can end."""

from dataclasses import replace
import re
import warnings

from bench.identification_simulated import read_identification_plan
from gms_flex_control.data.reader import read_experiment
from gms_flex_control.design.determination import experiments_for
from gms_flex_control.schema import files
import node_harness
from node_harness import FILES, services, Trigger
import numpy as np
import pytest

RATE = 125.0
SHORT = """identification:
  joints: [joint2]
  compensation: gms
  speeds: 2
  repeats: 1
  dwell_time: 0.25
  counts: 10.0
  lead_in: 0.0
  rest_time: 0.05
  relax_time: 0.3
  torque_rate: 4.0
  break_away_repeats: 1
  presliding_levels: [0.4]
  presliding_places: 1
  minor_loop: 0.0
  sliding_speeds: [2.0]
  sliding_duration: 1.0
  sliding_period: 0.3
  joint1: {lower: -1.0, upper: 1.0, velocity: 1.0}
  joint2: {lower: -1.0, upper: 1.0, velocity: 1.0, acceleration: 4.0, slowest: 0.3}
"""


class Experiment(node_harness.Lab):
    """Plant, controller and trajectory in lockstep, and the identification node."""

    def __init__(self, folder, **changes):
        super().__init__(folder)
        self.file = node_harness.write_parameters(folder / 'short.yaml', SHORT)
        self.bag = folder / 'bag'
        self._plant, self.believed = changes, FILES[0]

    @property
    def plan(self):
        robot = files.load_robot(FILES[0])
        return read_identification_plan([self.file], robot, files.load_controller(FILES[1], robot))

    def begin(self, **parameters):
        """Start all four; the plant when three listen."""
        self.others = {name: self.start(name, mode='lockstep')
                       for name in ('controller_node', 'trajectory_node')}
        node = self.identify(**parameters)
        self.others['plant_node'] = self.start(
            'plant_node', mode='lockstep', rate=RATE, wait_for_subscribers=3, **self._plant)
        return node

    def identify(self, name='identification_node', **parameters):
        given = {'identification__fit': False} | {
            f'identification__{key}': value for key, value in parameters.items()}
        return self.start(name, files=(self.believed, FILES[1], self.file),
                          mode='lockstep', identification__bag=self.bag, **given)

    def until_step(self, process, words):
        """Wait until the node says that it begins a step with ``words`` in its name."""
        self.until(lambda: words in process.printed() or not process.runs)
        assert process.runs, process.printed()


@pytest.fixture
def lab(tmp_path):
    with Experiment(tmp_path) as experiment:
        yield experiment


def read(path):
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        return read_experiment(path)


def test_a_whole_experiment_is_recorded_with_its_phases(lab):
    """It is not fitted, as its plan leaves out a joint."""
    node = lab.begin(fit=True)
    lab.until(lambda: 'no fit: the plan leaves out joint1' in node.printed() or not node.runs,
              bound=300.0)
    assert not lab.bag.with_name('bag_identified').exists()
    assert node.wait() == 0, node.printed()
    check_recording(lab)
    assert '100 %, done in' in node.printed() and 'estimated' in node.printed()
    assert lab.get('/cascade_controller', 'compensation') == 'gms'
    refused = lab.identify('identification_node.again')
    assert refused.wait() == 2 and 'has been recorded already' in refused.printed()


def test_experiments_that_next_plans_find_what_was_believed_wrong_within_the_limits(lab):
    """F_s of joint2 is believed 25 % too large; the torque that moves it says so."""
    true = files.load_robot(FILES[0])
    limits = files.load_limits([node_harness.CONFIG / 'bridge.yaml'], true.joints)
    believed = replace(true, friction=replace(true.friction, **{side: replace(
        getattr(true.friction, side), static=getattr(true.friction, side).static * [1.0, 1.25])
        for side in ('forward', 'backward')}))
    planned = experiments_for([('static', 'joint2')], [believed],
                              files.load_controller(FILES[1], believed), limits)
    files.save_robot(believed, lab.folder / 'believed.yaml')
    files.save_values(planned.values | {'identification.break_away_repeats': 1},
                      lab.folder / 'identification.yaml', comment=planned.sentence())
    lab.file, lab.believed = lab.folder / 'identification.yaml', lab.folder / 'believed.yaml'
    node = lab.begin()
    assert node.wait(bound=300.0) == 0, node.printed()
    found = [float(torque) for torque in re.findall(
        r'joint2 broke away at about (\S+) N m', node.printed())]
    static = [getattr(true.friction, side).static[1] for side in ('forward', 'backward')]
    assert len(found) >= 2
    assert min(static) * 0.95 < min(found) <= max(found) < 1.1 * max(static)
    recording, _ = read(lab.bag)
    assert np.all((recording.q_link > limits.lower) & (recording.q_link < limits.upper))
    assert np.all(np.nanmax(np.abs(recording.command), axis=0) <= limits.torque)


def check_recording(lab):
    """Check that no sample was lost and each step has its phase."""
    recording, phases = read(lab.bag)
    steps = lab.plan.steps()
    # where the arm is after a torque only the node knows: it may add or spare no step
    assert [phase.step for phase in phases] == [*(step.name for step in steps), '']
    assert phases[-1].phase == 'idle'
    # a phase holds from a joint state on
    assert {phase.time_ns for phase in phases} <= set(np.rint(1e9 * recording.time).astype(int))
    assert np.isfinite(recording.tau_motor).all() and np.isfinite(recording.command[:-1]).all()
    assert recording.period == pytest.approx(1 / RATE)
    assert np.all(np.diff(recording.time) < 1.5 / RATE)  # none was lost
    for now, after in zip(phases, phases[1:], strict=False):
        part = slice(*np.searchsorted(recording.time, [now.time_ns * 1e-9, after.time_ns * 1e-9]))
        if now.phase == 'constant_velocity':
            reference = recording.reference[part, 1, 1]
            assert np.isclose(reference, now.value, rtol=1e-9).sum() > 0.2 * RATE
        if now.phase == 'break_away':
            assert np.ptp(recording.q_link[part, 1]) > 0.03


def test_start_stop_and_resume_and_a_signal_gives_zero_torque(lab):
    node = lab.begin(autostart=False)
    lab.until(lambda: 'waiting for ~/start' in node.printed())
    assert lab.call(Trigger, '/identification/start').success
    commands = lab.hear('commands')
    lab.until_step(node, 'constant_velocity/joint2/-0.9')
    assert lab.call(Trigger, '/identification/stop').success
    states = lab.hear('states')
    lab.until(lambda: 'stopped: zero torque' in node.printed())
    lab.more(states, 1)
    assert no_torque(lab.more(commands, 100)[-50:])
    assert lab.call(Trigger, '/identification/resume').success
    assert not lab.call(Trigger, '/identification/start').success  # it runs already
    lab.until_step(node, 'break_away')
    assert node.signal(node_harness.INT) == 0, node.printed()
    begun = len(commands)
    lab.until(lambda: len(commands) > begun + 50 and no_torque(commands[-50:]))
    assert 'ended by a signal' in node.printed()
    recording, phases = read(lab.bag)
    stop = next(phase for phase in phases if phase.phase == 'idle')
    after = np.searchsorted(recording.time, stop.time_ns * 1e-9)
    # the phase is published once the trajectory node has let go
    assert np.all(recording.command[after + 50:after + 80] == 0.0)
    assert phases[-1].phase == 'idle'
    again = [phase for phase in phases if 'constant_velocity/joint2/-0.9' in phase.step and (
        phase.value or not phase.step.endswith(('/approach', '/relax')))]
    assert len(again) == 2  # the step that was stopped is carried out once more


def no_torque(commands):
    return not any(np.any(command.data) for command in commands)


def test_a_lost_node_ends_the_experiment_with_a_sentence(lab):
    node = lab.begin(silence=2.0)
    lab.until_step(node, 'constant_velocity/joint2/+0.9')
    lab.others['trajectory_node'].kill()
    assert node.wait() == 2
    assert 'no references of the trajectory node for 2 s' in node.printed()
    assert len(read(lab.bag)[0].time) > 100


def test_parameters_that_are_refused_end_it_with_the_reason(lab):
    def refuse(request, response):
        response.result.reason = 'too bold'
        return response

    def answer(request, response):
        response.values = [node_harness.interfaces.ParameterValue(type=3, double_value=1.0)
                           for _ in request.names]
        return response

    lab.node.create_service(services.SetParametersAtomically,
                            '/picky/set_parameters_atomically', refuse)
    lab.node.create_service(services.GetParameters, '/picky/get_parameters', answer)
    node = lab.begin(controller_node='/picky')
    lab.until(lambda: not node.runs)
    assert node.wait() == 2
    assert '/picky refused gains.joint1.torque_limit' in node.printed()
    assert 'too bold' in node.printed()
    lab.bag = lab.folder / 'other'
    other = lab.identify('identification_node.other', controller_node='/trajectory')
    assert other.wait() == 2
    assert 'lacks one of the parameters compensation' in other.printed()


def test_without_other_nodes_it_says_whom_it_misses(lab):
    node = lab.identify(patience=0.5)
    assert node.wait() == 2
    assert 'the services of /trajectory did not appear in 0.5 s' in node.printed()
