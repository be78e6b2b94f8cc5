# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Flexible joints of which only the motors were recorded: friction is identified all the same."""

from dataclasses import replace
from pathlib import Path

from bench.hidden_arms.plant import recording_of
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.identify import identify
from gms_flex_control.schema.files import load_robot
from identified_axis import axis, experiment, JOINT, part
import numpy as np
import pytest

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


@pytest.mark.parametrize('arm, noise, seconds, seed', [
    ('industrial_arm', 0.06, 20.0, 7601), ('light_arm', 0.03, 12.0, 7500)])
def test_torques_of_links_that_are_computed_are_not_lost_in_noise_of_their_accelerations(
        arm, noise, seconds, seed):
    """Noise of a drive moves the link that is computed with it, and a heavy one's torque far."""
    robot = load_robot(EXAMPLES / arm / 'robot.yaml')
    recording = recording_of(robot, robot, seconds=seconds, noise=noise, motors_only=True,
                             seed=seed)
    found = identify([recording], robot)
    for side in ('forward', 'backward'):
        own, true = (getattr(one.friction, side).coulomb for one in (found.robot, robot))
        assert own == pytest.approx(true, rel=0.05)


def test_without_the_torque_of_the_motor_nothing_says_where_the_link_is():
    recording, phases = part(experiment(), 0.0, 40.0)
    blind = motors_only(recording, tau_motor=np.full_like(recording.tau_motor, np.nan))
    with pytest.raises(IdentificationError, match=f'nor a torque .* as rigid, .* {JOINT}_motor'):
        identify([(blind, phases)], axis())
