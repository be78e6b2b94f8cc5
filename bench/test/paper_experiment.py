# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A short simulated identification experiment of a robot whose friction nobody was reported."""

from dataclasses import replace
from pathlib import Path

from bench.identification_simulated import read_identification_plan, simulate_identification
from gms_flex_control.identification.segments import drive_sides, half_count, segments_of
from gms_flex_control.params.robot import EncoderParams
import numpy as np

CONFIG = Path(__file__).parents[2] / 'config'
SHORT = {'identification.speeds': 6, 'identification.repeats': 1,
         'identification.break_away_repeats': 1, 'identification.presliding_places': 1}


def hidden(robot, seed):
    """Return the robot with friction drawn at random, every block soft or stiff enough to see."""
    rng, friction = np.random.default_rng(seed), robot.friction

    def about(values, spread):
        return values * np.exp(rng.uniform(-spread, spread, np.shape(values)))

    def of_direction(steady):
        coulomb = about(steady.coulomb, 0.1)
        drop = about(steady.static - steady.coulomb, 0.3)
        return replace(steady, coulomb=coulomb, static=coulomb + drop,
                       velocity=about(steady.velocity, 0.2), viscous=about(steady.viscous, 0.2))

    return replace(robot, friction=replace(
        friction, forward=of_direction(friction.forward), backward=of_direction(friction.backward),
        stiffness=about(np.maximum(friction.stiffness, 8.0), 0.2),
        attraction=about(friction.attraction, 0.2)))


def experiment(robot, gains, joint, seed, *, ideal, **options):
    """Return recording, phases, and what a fit takes: segments, period and half a count."""
    plan = read_identification_plan(
        [CONFIG / 'robot.yaml', CONFIG / 'controller.yaml', CONFIG / 'identification.yaml'],
        robot, gains, overrides=SHORT | {'identification.joints': [joint]} | options)
    plant = hidden(robot, seed)
    if ideal:
        plant = replace(plant, encoder=EncoderParams())
    recording, phases = simulate_identification(plan, plant, gains, seed,
                                                torque_noise=0.0 if ideal else 1e-3)
    segments = segments_of(recording, robot, drive_sides(recording, robot), phases)
    return recording, phases, segments, half_count(recording, robot)


def unnamed(segments):
    """Return the segments as of a recording without phases."""
    return [replace(segment, phase=np.full(len(segment.phase), '', dtype='U20'))
            for segment in segments]
