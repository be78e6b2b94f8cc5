# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""An experiment on a simulated axis, identified; also where the links were not recorded."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from bench.hidden_arms.plant import recording_of
from core_runs import scaled_friction, single_axis
from discrepancy_runs import FRICTIONLESS
from gms_flex_control.data.recording import Phase
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.friction_map import friction_map, repeatability
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.problem import Problem
from gms_flex_control.identification.segments import resolution, Segment
from gms_flex_control.schema.files import load_robot
from identified_axis import axis, experiment, JOINT, part, STATIC, without_phases, YIELDS
import numpy as np
import pytest

FOUR = IdentifyOptions(blocks=(4,))
NAMES = ('static', 'coulomb', 'velocity', 'viscous')
TOLERANCES = dict(zip(NAMES, (0.03, 0.03, 0.15, 0.03), strict=True))  # of the requirement
NEVER = 5.0  # rad, farther than the axis goes


@pytest.fixture(scope='module')
def flexible():
    return identify([experiment()], axis(), options=FOUR)


@pytest.fixture(scope='module')
def rigid():
    return identify([experiment(rigid=True)], axis(rigid=True), options=FOUR)


@pytest.fixture(params=['flexible', 'rigid'])
def found(request):
    """Return the identification of either axis."""
    return request.getfixturevalue(request.param)


def steady_errors(friction):
    """Return the relative error of each steady parameter by name."""
    truth = axis().friction
    return {f'{side}.{name}': float(getattr(getattr(friction, side), name)[0]
                                    / getattr(getattr(truth, side), name)[0] - 1.0)
            for side in ('forward', 'backward') for name in NAMES}


@pytest.mark.parametrize('frequency', [0.5, 6.0])
def test_friction_is_seen_where_no_quarter_second_goes_one_way(frequency):
    """Coulomb friction of 0.3 N m both ways, also of motion that turns twelve times a second."""
    time, turn = np.arange(3000) * 1e-3, 2.0 * np.pi * frequency
    angle, rate = np.sin(turn * time)[:, None], turn * np.cos(turn * time)[:, None]
    inertia, friction = 0.02, 0.3
    held = np.diff(rate, axis=0, append=rate[-1:]) / 1e-3  # the mean to the next sample
    torque = inertia * held + friction * np.sign(rate)
    segment = Segment(begin=0.0, angle=angle, rate=rate, acceleration=-turn ** 2 * angle,
                      torque=torque, tested=np.ones_like(rate, dtype=bool),
                      phase=np.full(len(time), ''), source='sine', factor=np.ones_like(rate))
    found = friction_map([segment], single_axis(FRICTIONLESS, inertia).arm, 0, 1e-3, 1e-6)
    for way in (1.0, -1.0):
        rows = way * found.velocity > 0.0
        assert rows.sum() >= 3
        np.testing.assert_allclose(np.median(found.torque[rows]), way * friction, rtol=0.02)


def test_repeatability_is_the_spread_of_friction_among_strokes_not_of_torques_at_rest():
    """Six strokes either way, 3 s of rest after each, when the torque is anything."""
    levels = 0.3 + 0.01 * np.random.default_rng(3).standard_normal((6, 2))
    rate, torque = [], []
    for k, (forward, backward) in enumerate(levels):
        for speed, level in ((0.5, forward), (-0.5, -backward)):
            rate += [*np.full(2000, speed), *np.zeros(3000)]
            torque += [*np.full(2000, level), *np.full(3000, 0.05 * k)]
    rate = np.array(rate)[:, None]
    segment = Segment(begin=0.0, angle=np.cumsum(rate, axis=0) * 1e-3, rate=rate,
                      acceleration=np.zeros_like(rate), torque=np.array(torque)[:, None],
                      tested=np.ones_like(rate, dtype=bool),
                      phase=np.full(len(rate), 'constant_velocity'), source='strokes',
                      factor=np.ones_like(rate))
    arm = single_axis(FRICTIONLESS, 0.02).arm
    assert repeatability([segment], arm, 0, 1e-3, 1e-6) == pytest.approx(
        np.sqrt(np.mean(np.var(levels, axis=0, ddof=1))), rel=1e-3)
    segment.phase[:] = 'sliding'
    assert np.isnan(repeatability([segment], arm, 0, 1e-3, 1e-6))


def assert_recovered(found):
    """Raise unless all steady parameters and C are within the tolerances of the requirement."""
    friction = found.robot.friction
    for name, error in steady_errors(friction).items():
        assert abs(error) < TOLERANCES[name.split('.')[1]], f'{name} is off by {error:.2%}'
    assert friction.attraction[0] == pytest.approx(1.0, rel=0.1)


def curve(friction, displacement):
    """Return the torque (D,) of blocks pushed from rest, by hand."""
    level = 0.5 * (friction.forward.static[0] + friction.backward.static[0])
    return np.minimum(np.outer(displacement, friction.stiffness[0]),
                      level * friction.weight[0]).sum(axis=1)


def truths(robot):
    """Return the true value of each estimate's name; blocks from soft to stiff."""
    friction = robot.friction
    values = {f'friction.{JOINT}.{side}.{name}': getattr(getattr(friction, side), name)[0]
              for side in ('forward', 'backward') for name in NAMES}
    values[f'friction.{JOINT}.attraction'] = friction.attraction[0]
    return values | {f'friction.{JOINT}.stiffness[{i}]': stiffness
                     for i, stiffness in enumerate(np.sort(friction.stiffness[0, :4]))}


def by_name(found):
    return {estimate.name: estimate for estimate in found.joints[0].estimates}


def test_steady_friction_and_attraction_are_recovered(found):
    assert_recovered(found)
    assert found.warnings == ()


def test_the_presliding_curve_is_within_two_percent_everywhere(found):
    at = np.geomspace(1e-5, 2.0 * YIELDS.max(), 400)
    off = np.abs(curve(found.robot.friction, at) - curve(axis().friction, at)) / STATIC
    assert off.max() < 0.02, f'off by {off.max():.2%} of F_s at {at[off.argmax()]:.2g} rad'


def test_the_torque_comes_from_the_spring_where_there_is_one(flexible, rigid):
    assert flexible.joints[0].side == 'spring'
    assert rigid.joints[0].side == 'motor'


def test_intervals_are_true_and_narrow_where_torque_noise_is_what_limits(rigid):
    """95 % intervals of 13 numbers: fewer than 10 hits have a probability of 1 in 300."""
    estimates, truth = by_name(rigid), truths(axis(rigid=True))
    reported = {name: one for name, one in estimates.items() if np.isfinite(one.interval).all()}
    missed = [f'{name}: {truth[name]:.5g} not in {one.interval}' for name, one in reported.items()
              if not one.interval.low <= truth[name] <= one.interval.high]
    assert len(reported) >= 10 and len(missed) <= 3, missed
    for name in ('forward.static', 'forward.coulomb', 'backward.coulomb'):
        low, high = estimates[f'friction.{JOINT}.{name}'].interval
        assert high - low < 0.03 * truth[f'friction.{JOINT}.{name}']


def test_intervals_contain_the_truth_or_a_hair_beyond(flexible):
    """Within half a percent beyond an interval where nothing but counts is noise."""
    truth = truths(axis())
    for name, estimate in by_name(flexible).items():
        if estimate.flags:
            continue
        low, high = estimate.interval
        assert 0.995 * low < truth[name] < 1.005 * high, f'{name}: {truth[name]} {estimate}'


def test_held_out_errors_are_below_those_of_coulomb_and_viscous_friction(found):
    held_out = found.joints[0].held_out
    assert held_out.relative < 0.5 * held_out.coulomb_viscous
    assert held_out.free_run_rms < 0.2 * held_out.free_run_coulomb_viscous


def test_as_many_blocks_as_were_tried_may_be_too_few(found):
    assert any('--blocks' in text for text in found.joints[0].warnings)


def test_a_block_that_slips_beyond_presliding_only_is_not_passed_off_as_presliding(found):
    softest = by_name(found)[f'friction.{JOINT}.stiffness[0]']
    assert softest.value == pytest.approx(0.25 * STATIC / YIELDS.max(), rel=0.05)
    assert 'not identifiable' in softest.flags
    assert 'slips only after 0.1' in softest.note
    for i in (1, 2, 3):
        assert 'not identifiable' not in by_name(found)[f'friction.{JOINT}.stiffness[{i}]'].flags


def test_a_block_that_never_slips_is_no_friction():
    """One of four blocks is a spring over all of the range: three carry what friction there is."""
    yields = (NEVER, *YIELDS[1:])
    found = identify([experiment(rigid=True, yields=yields)], axis(rigid=True, yields=yields),
                     options=IdentifyOptions(blocks=(3,))).robot.friction
    for name, error in steady_errors(found).items():
        if name.endswith(('static', 'coulomb')):
            assert error == pytest.approx(-0.25, abs=0.03), name
    stiffness = np.sort(0.25 * STATIC / YIELDS[1:])
    np.testing.assert_allclose(np.sort(found.stiffness[0]), stiffness, rtol=0.05)


def test_two_bags_determine_what_one_does():
    """The same experiment cut in two where a phase begins, near its middle."""
    recorded = experiment(rigid=True)
    starts = np.array([phase.time_ns for phase in recorded[1]]) * 1e-9
    middle = starts[np.searchsorted(starts, 0.5 * recorded[0].time[-1])]
    halves = part(recorded, 0.0, middle), part(recorded, middle, np.inf)
    assert sum(len(half[0].time) for half in halves) == len(recorded[0].time)
    two = identify(halves, axis(rigid=True), options=FOUR)
    assert_recovered(two)
    assert len(two.sources) == 2
    assert two.duration == pytest.approx(recorded[0].time[-1], abs=0.01)


def test_phases_are_not_needed_and_a_recording_apart_sets_the_errors(rigid):
    """The held-out recording is predicted only; the fit uses all of the others."""
    found = identify([without_phases(experiment(rigid=True))], axis(rigid=True), options=FOUR,
                     holdouts=[without_phases(experiment(2, rigid=True))])
    assert_recovered(found)
    with_phases = steady_errors(rigid.robot.friction)
    for name, error in steady_errors(found.robot.friction).items():
        assert abs(error - with_phases[name]) < 0.02, name
    assert found.holdouts == ('simulated identification',)
    held_out = found.joints[0].held_out
    assert held_out.relative < 0.5 * held_out.coulomb_viscous
    assert held_out.relative != rigid.joints[0].held_out.relative


def assert_same_data(one, other):
    """Raise unless two Data hand the same numbers to a fit."""
    for a, b in zip(one.bundle.segments, other.bundle.segments, strict=True):
        for name in ('angle', 'rate', 'acceleration', 'torque', 'tested'):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    np.testing.assert_array_equal(one.bundle.half, other.bundle.half)
    np.testing.assert_array_equal(one.bundle.observer, other.bundle.observer)
    for a, b in zip(one.starts, other.starts, strict=True):
        assert a[:3] == b[:3]
        np.testing.assert_array_equal(a.yields, b.yields)


def test_the_friction_of_the_robot_file_has_no_say():
    recorded, robot = experiment(), axis()
    wrong = replace(robot, friction=scaled_friction(robot.friction, 3.0))
    assert_same_data(Problem([recorded], (), robot), Problem([recorded], (), wrong))


def test_recordings_of_unlike_rates_are_taken_at_the_slower_one():
    recorded = experiment()
    slow = (replace(recorded[0], time=1.5 * recorded[0].time, source='slow'), ())
    with pytest.warns(UserWarning, match='sampled every 4 to 6 ms; all are taken every 6 ms'):
        assert Problem([recorded, slow], (), axis()).bundle.period == pytest.approx(6e-3)


def test_noise_of_an_encoder_is_seen_beside_lost_samples():
    angle = np.linspace(0.0, 3.0, 4000) + 1e-4 * np.random.default_rng(4).standard_normal(4000)
    angle[::97] = np.nan
    segments = [SimpleNamespace(angle=part[:, None]) for part in np.split(angle, 2)]
    assert resolution(segments, 0, 0.0) == pytest.approx(3e-4, rel=0.1)


def test_few_data_of_which_a_quarter_is_no_test_of_the_joint_are_fitted():
    """Each quarter is held out in turn, but one with nothing in it."""
    recorded, _ = part(experiment(), 0.0, 20.0)
    phases = tuple(Phase(2 * k * 10**9, *(('idle', '', '', 0.0) if k % 4 == 1 else
                                          ('sliding', JOINT, f'step{k}', 0.1)))
                   for k in range(10))
    steady = identify([(recorded, phases)], axis(), options=IdentifyOptions(
        blocks=(1, 3))).robot.friction.forward
    assert steady.coulomb[0] == pytest.approx(0.09087, rel=0.05)


EXAMPLES = Path(__file__).parents[1] / 'examples'


def motors_only(recording, **changes):
    """Return a Recording whose links have no encoder."""
    nothing = np.full_like(recording.q_link, np.nan)
    return replace(recording, q_link=nothing, dq_link=nothing, **changes)


def test_coulomb_friction_of_a_flexible_joint_shows_by_its_motor_alone():
    """And a sentence says that the link was computed."""
    recording, phases = part(experiment(), 0.0, 40.0)
    found = identify([(motors_only(recording), phases)], axis())
    assert [one for one in found.warnings if f'link angles of {JOINT} were not recorded' in one]
    assert found.joints[0].side == 'motor' and not found.robot.arm.rigid.any()
    for side in ('forward', 'backward'):
        own, true = (getattr(robot.friction, side).coulomb for robot in (found.robot, axis()))
        assert own == pytest.approx(true, rel=0.05)


def test_torques_of_links_that_are_computed_are_not_lost_in_noise_of_their_accelerations():
    """Noise of a drive moves the link that is computed with it, and a heavy one's torque far."""
    robot = load_robot(EXAMPLES / 'light_arm' / 'robot.yaml')
    recording = recording_of(robot, robot, seconds=12.0, noise=0.03, motors_only=True, seed=7500)
    found = identify([recording], robot)
    for side in ('forward', 'backward'):
        own, true = (getattr(one.friction, side).coulomb for one in (found.robot, robot))
        assert own == pytest.approx(true, rel=0.05)


def test_without_the_torque_of_the_motor_nothing_says_where_the_link_is():
    recording, phases = part(experiment(), 0.0, 40.0)
    blind = motors_only(recording, tau_motor=np.full_like(recording.tau_motor, np.nan))
    with pytest.raises(IdentificationError, match=f'nor a torque .* as rigid, .* {JOINT}_motor'):
        identify([(blind, phases)], axis())
