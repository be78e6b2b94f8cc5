# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The bridge without ROS: when torque flows, what stops it, and what it says of that."""

from dataclasses import replace
import math

from gms_flex_control.errors import ConfigError, ParameterError
from gms_flex_control.hardware.bridge import Bridge, BridgeParams
from gms_flex_control.hardware.limits import Limits, UNLIMITED
from gms_flex_control.hardware.mapping import Actuation, JointMap, Reading
from gms_flex_control.hardware.supervision import CommandWatch, SourceWatch, Supervisor
from gms_flex_control.schema.build import bridge_from_values
import pytest

MS = 1_000_000
LIMITS = {'torque': 1.0, 'torque_rate': 10.0, 'velocity': 2.0, 'velocity_margin': 1.0,
          'lower': -1.0, 'upper': 1.0, 'position_margin': 0.1, 'torsion': 0.5}


def params(**changed):
    """Return what a bridge of one flexible joint needs to know."""
    joint_map = JointMap(('j',), [Reading(name='l')], [Reading(name='m')], [Actuation(name='m')])
    return BridgeParams(joint_map=joint_map, sources=('robot',),
                        limits=Limits(**{key: [value] for key, value in
                                         (LIMITS | changed).items()}))


class Run:
    """A bridge with robot and controller that speak every 2 ms."""

    def __init__(self, **changed):
        self.bridge, self.now = Bridge(params(**changed)), 10**12
        self.q, self.motor, self.command, self.source = 0.0, 0.0, 0.5, '/c#1'

    def tick(self, count=1, *, states=True, commands=True, stamp=None):
        """Let ``count`` samples pass; return the torques (list of float)."""
        torques = []
        for _ in range(count):
            self.now += 2 * MS
            if states:
                self.bridge.take_state(0, ['m', 'l'], [self.motor, self.q], [0.0, 0.0], (),
                                       self.now, self.now)
            if commands:
                self.bridge.take_command([self.command], stamp or self.bridge.robot.stamp,
                                         self.source, self.now + MS // 2)
            self.bridge.watch(self.now + MS)
            torques.append(float(self.bridge.torque[0]))
        return torques

    def enabled(self, count=50):
        """Enable torque and let it rise."""
        self.tick(5)
        assert self.bridge.enable(self.now).success
        self.tick(count)
        return self

    @property
    def said(self):
        """Return state and reason."""
        return f'{self.bridge.supervisor.state}: {self.bridge.supervisor.reason}'


def test_torque_begins_at_zero_and_rises_at_the_rate_limit():
    run = Run()
    assert run.tick(50) == [0.0] * 50  # ZERO
    assert run.bridge.enable(run.now).success
    rising = run.tick(40)
    # the command of the first sample comes 2.5 ms after it was enabled, later ones 2 ms apart
    assert rising == pytest.approx([min(0.5, 10.0 * (0.0025 + 0.002 * k)) for k in range(40)])


def test_nothing_that_was_asked_before_torque_was_enabled_acts():
    run = Run()
    run.tick(5)
    before = run.bridge.robot.stamp
    assert run.bridge.enable(run.now).success
    assert not run.bridge.take_command([0.5], before, '/c#1', run.now + MS)
    assert run.tick(1)[0] > 0.0


def test_to_enable_what_is_active_changes_nothing():
    """Neither torque nor the watch over a controller that has died meanwhile begins anew."""
    run = Run().enabled()
    assert run.bridge.enable(run.now + MS) == (True, 'ACTIVE already')
    assert run.tick(3) == [0.5] * 3
    run.tick(17, commands=False)
    run.bridge.enable(run.now + MS)
    run.tick(1, commands=False)
    assert run.said == 'FAULT: no command from /c#1 for 36 ms'


def test_a_bridge_that_stood_still_does_not_obey_what_waited_for_it():
    """The command that comes first afterwards, without a stamp, is no end of the silence."""
    run = Run().enabled()
    later = run.now + 200 * MS
    assert run.bridge.take_command([0.5], None, '/c#1', later)
    assert run.bridge.torque == [0.0] and run.said.startswith('FAULT: no ')


@pytest.mark.parametrize(('asked', 'reported'), [(1.0, True), (0.015, False)])
def test_a_robot_that_swings_because_its_torque_comes_late_is_named(asked, reported):
    """It is asked to turn round every 10 ms, and may rise by 0.02 N m in a sample of 2."""
    run = Run().enabled()
    for _ in range(100):
        run.command = -asked if run.command > 0.0 else asked
        run.tick(5)
    run.q = run.motor = 1.2
    run.tick()
    assert run.said.startswith('FAULT: j is at 1.2 rad, beyond its range of -1 to 1 by more')
    assert ('; torque_rate (10 N m/s) held back the torque of j for ' in run.said) == reported
    assert (run.bridge.counters['commands held back by torque_rate'] > 100) == reported


def test_states_whose_command_comes_after_the_next_one_are_counted_and_named_in_a_fault():
    run = Run().enabled()
    assert run.bridge.controller.lateness.share == 0.0
    for _ in range(3000):  # every second state is not answered
        run.tick()
        run.tick(commands=False)
    assert run.bridge.controller.lateness.share == pytest.approx(0.5, abs=0.001)
    assert run.bridge.counters['states without a fresh command'] == 2999
    run.q = run.motor = 1.2
    run.tick()
    assert run.said.endswith(f'; {0.5:.0%} of the states of the last second had no fresh command: '
                             'the controller is late')
    run.tick()
    assert run.bridge.controller.lateness.share == 0.0  # nothing is asked of it in FAULT


@pytest.mark.parametrize('prepare, words', [
    (lambda run: None, 'no joint states from robot yet'),
    (lambda run: run.tick(5, commands=False), 'no controller commands yet'),
    (lambda run: (run.tick(5), run.tick(30, commands=False)), 'no command from /c#1 for 6'),
    (lambda run: (run.tick(5), run.tick(30, states=False)), 'no new joint states for 60 ms'),
    (lambda run: (setattr(run, 'q', 1.2), setattr(run, 'motor', 1.2), run.tick(5)),
     'j is at 1.2 rad, beyond its range')])
def test_what_stands_against_torque_is_said(prepare, words):
    run = Run()
    prepare(run)
    outcome = run.bridge.enable(run.now)
    assert not outcome.success and words in outcome.message and 'not enabled' in outcome.message


def test_a_silent_controller_is_a_fault_that_says_how_long_and_is_latched():
    run = Run().enabled()
    torques = run.tick(40, commands=False)
    last = 2.0 * sum(torque > 0.0 for torque in torques)
    assert last <= 36.0  # milliseconds
    assert run.said == 'FAULT: no command from /c#1 for 36 ms'
    run.tick(20, commands=False)
    assert run.tick(50) == [0.0] * 50
    # the last command came 1.5 ms before the first of those 60 samples
    assert run.said == 'FAULT: no command from /c#1 for 122 ms; they come again'
    assert not run.bridge.enable(run.now).success
    assert run.bridge.supervisor.reset().success and run.bridge.enable(run.now).success
    assert run.tick(5)[-1] > 0.0


def test_a_silent_robot_is_named_before_the_controller_that_has_nothing_to_answer():
    run = Run().enabled()
    run.tick(40, states=False, commands=False)
    assert run.said == 'FAULT: no new joint states for 31 ms'
    run = Run().enabled()
    run.bridge.refuse_state("joint states lack 'l'")
    run.tick(40, states=False)
    # the command of that sample comes half a millisecond before the watch looks
    assert run.said == "FAULT: no new joint states for 30 ms: joint states lack 'l'"
    run = Run().enabled()
    for _ in range(20):
        run.now += 2 * MS
        run.bridge.take_state(0, ['m'], [0.0], (), (), run.now, run.now)
        run.bridge.watch(run.now)
    assert run.said == 'FAULT: no new joint states for 32 ms: nothing of l'


def test_refused_commands_are_silence_and_the_reason_is_kept():
    run = Run().enabled()
    for _ in range(30):
        run.bridge.refuse_command('command for joint 1 is nan')
        run.tick(commands=False)
    assert run.said.endswith('ms; refused last: command for joint 1 is nan')


def test_answers_to_states_of_long_ago_or_never_do_not_act():
    run = Run().enabled()
    old = run.bridge.robot.stamp
    run.tick(12)
    for stamp in (old, old + 1, run.now + 10**9):
        torque, run.command = run.bridge.torque.copy(), -1.0
        run.tick(stamp=stamp)
        if stamp != old:
            assert (run.bridge.torque == torque).all()
    run.tick(20, stamp=old)
    assert 'FAULT: no command' in run.said


def test_two_controllers_are_reported_at_once_and_a_restarted_one_is_not_two():
    run = Run().enabled()
    run.source = '/c#2'
    assert run.tick(1) == [0.0]
    assert run.said == 'FAULT: 2 controllers command at once: /c#1 and /c#2'
    watch = CommandWatch()
    assert watch.hear('/c#1', 0) == '' and watch.hear('/c#2', 60 * MS) == ''
    assert 'somebody without a source label' in watch.hear('', 61 * MS)
    assert watch.hear('/c#2', 120 * MS) == ''


def test_two_sources_are_reported_until_one_of_them_or_nobody_sends_any_more():
    watch = SourceWatch('nodes send references')
    assert watch.hear('/a#1', 0) == watch.conflict(0) == ''
    both = watch.hear('', 40 * MS)
    assert both == ('2 nodes send references at once: /a#1 and somebody without a source label')
    assert watch.conflict(80 * MS) == both  # one of them may have ended: the next one shows
    assert watch.hear('', 91 * MS) == watch.conflict(91 * MS) == ''
    assert watch.hear('/a#1', 92 * MS) and watch.conflict(140 * MS)
    assert watch.conflict(143 * MS) == ''


@pytest.mark.parametrize('break_it, words', [
    (lambda run: setattr(run, 'q', 0.4), 'j jumped from 0 to 0.4 rad'),
    (lambda run: setattr(run, 'motor', 0.6), 'motor and link of j are 0.6 rad apart')])
def test_a_robot_that_does_what_it_may_not_is_given_nothing(break_it, words):
    run = Run().enabled()
    break_it(run)
    assert run.tick(3) == [0.0] * 3
    assert words in run.said and run.bridge.supervisor.state == 'FAULT'


def test_outward_torque_ends_at_the_limit_and_inward_torque_begins():
    run = Run(torque=0.2).enabled()
    while run.q < 1.0:
        run.q = run.motor = run.q + 0.003
        run.tick()
    assert run.tick(10) == [0.0] * 10 and run.bridge.supervisor.active
    run.command = -0.5
    assert run.tick(30)[-1] == -0.2


def test_an_effort_under_a_name_that_no_encoder_has_is_measured_while_it_comes():
    joint_map = JointMap(('j',), [Reading(name='l')], [None],
                         [Actuation(name='a', torque_constant=2.0)])
    bridge = Bridge(replace(params(), joint_map=joint_map))
    for k, (names, effort, torque) in enumerate([
            (['a', 'l'], [0.4, math.nan], 0.8), (['l'], [], 0.0), (['l', 'a'], [9.0, -0.1], -0.2),
            (['l', 'a'], [], 0.0)]):
        assert bridge.take_state(0, names, [0.0] * len(names), (), effort, 10**12 + k * MS,
                                 10**12 + k * MS)
        assert bridge.robot.applied[0] == pytest.approx(torque)


@pytest.mark.parametrize('guarded', [False, True])
def test_torque_does_not_come_back_at_once_after_the_guardian_took_it_away(guarded):
    """The timeouts would allow the bridge to stand still for so long."""
    run = Run()
    run.bridge.params = replace(params(), state_timeout=0.2, silence_timeout=0.2, guarded=guarded)
    run.enabled()
    run.now += 100 * MS
    run.tick()
    assert run.said.startswith('FAULT: the bridge stood still for 10') == guarded
    assert run.bridge.supervisor.active != guarded and any(run.bridge.torque) != guarded


def test_an_emergency_stop_outranks_everything_until_it_is_released_and_reset():
    supervisor = Supervisor()
    supervisor.stop('emergency stop by service')  # from ZERO as well
    assert supervisor.state == 'FAULT' and not supervisor.enable().success
    assert supervisor.reset().success and supervisor.state == 'ZERO'
    assert supervisor.enable().success and supervisor.trip('broken') and not supervisor.trip('x')
    supervisor.button(True, '/stop')
    assert supervisor.reason == 'emergency stop by /stop'
    supervisor.amend('something else')
    assert supervisor.reason == 'emergency stop by /stop'
    refused = supervisor.reset()
    assert not refused.success and refused.message.endswith('release the button first')
    supervisor.button(False, '/stop')
    assert supervisor.state == 'FAULT' and supervisor.disable().success
    assert supervisor.state == 'FAULT' and supervisor.reset().success
    assert supervisor.faults == 2


def values(**changed):
    """Return flat parameters of a bridge of one joint."""
    flat = {f'limits.j.{name}': value for name, value in LIMITS.items()}
    return flat | {key.replace('__', '.'): value for key, value in changed.items()}


def test_parameters_become_a_bridge():
    built = bridge_from_values(values(
        mapping__j__motor__name='m7', mapping__j__motor__ratio=50, mapping__j__link__sign=-1,
        mapping__j__effort__side='motor', mapping__j__effort__ratio=50.0,
        mapping__j__effort__torque_constant=0.1, silence_timeout=0.02), ['j'], ['j_motor'])
    assert built.joint_map.names == ('j', 'm7') and built.joint_map.command_names == ('m7',)
    assert built.joint_map.efforts(built.limits.torque)[0] == pytest.approx(1.0 / 5.0)
    assert built.silence_timeout == 0.02 and built.sources == ('robot/joint_states',)


@pytest.mark.parametrize('changed, words', [
    ({'limits__j__torque': UNLIMITED}, 'limits.j.torque is missing: the bridge to a real robot'),
    ({'limits__j__lower': 2.0}, 'lower \\[2.\\] must be below upper'),
    ({'mapping__j__link__sign': 0.5}, 'mapping.j: j: sign must be 1 or -1'),
    ({'mapping__j__effort__side': 'shaft'}, 'must be one of motor, joint'),
    ({'bridge__command_order': ['j', 'k']}, 'must name each of'),
    ({'bridge__state_topics': []}, 'bridge.state_topics is empty'),
    ({'silence_timeout': 5.0}, 'silence_timeout must be from 0.002 to 1 s, got 5')])
def test_parameters_that_make_no_bridge_are_refused(changed, words):
    with pytest.raises((ConfigError, ParameterError), match=words):
        bridge_from_values(values(**changed), ['j'], ['m'])
