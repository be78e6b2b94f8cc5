# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What several tests of the search for what is missing need: motions, and likelihoods of them."""

from dataclasses import replace

from bench.hidden_robots import motions, truth
from core_runs import single_axis
from gms_flex_control.data.recording import Recording
from gms_flex_control.discrepancy.fitting import retuned
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.motion import make_motion, motion_of
from gms_flex_control.discrepancy.null_simulation import null_readings
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.samples import make_samples
from gms_flex_control.params.robot import FrictionParams, StribeckParams, widened
from gms_flex_control.simulation import plant
import numpy as np
from scipy.ndimage import uniform_filter1d

NONE = StribeckParams(static=[1e-14], coulomb=[1e-14], velocity=[1.0], viscous=[0.0])
FRICTIONLESS = FrictionParams(forward=NONE, backward=NONE, stiffness=[[1e-14]], weight=[[1.0]],
                              attraction=[1.0])


def motion_along(robot, time, read, command):
    """Return the Motion of a robot read at (T, 2, n), or alike on both sides (T, n), as driven."""
    read = np.stack([read, read], axis=1) if read.ndim == 2 else np.ascontiguousarray(read)
    return make_motion(make_samples(robot.joints, time, time[1], read, command,
                                    np.zeros(len(time)), True, 'made up'))


def driven_motion(robot, gains, seed=0, duration=20.0):
    """Return the Motion of a rich motion of a robot, by the integrator of hidden robots."""
    time = np.arange(round(duration / 2e-3)) * 2e-3
    reference = motions.draw_reference(np.random.default_rng(7), 'rich', 'soft', time)
    run = truth.simulate(robot, replace(robot, effects=()), gains, reference, seed=seed)
    return motion_along(robot, time, run.measured[:, [0, 2]], run.command)


def rigid_motion(inertia=0.02, motor_inertia=0.0):
    """Return a rigid axis without friction, and a Motion of 0.8 s."""
    robot = single_axis(FRICTIONLESS, inertia, motor_inertia=motor_inertia)
    time = np.arange(200)[:, None] * 4e-3
    return robot, motion_along(robot, time[:, 0], np.sin(time), np.cos(time))


def null_run(motion, robot):
    """Return the first null simulation of a Motion by a robot."""
    return null_readings(motion, plant.constants_of(robot))(np.random.default_rng(0))


def likelihood_of(case, times=1.0):
    """Return the Likelihood of a case as its user believes the robot, known so badly."""
    return Likelihood([motion_of(case.recording, case.nominal)], widened(case.nominal, times))


def as_believed(likelihood, robot=None):
    """Return a Fitted of the robot as believed, or of another one, nothing re-tuned."""
    return likelihood.fitted(robot or likelihood.robot, np.zeros(len(likelihood.nuisances)))


def retuned_of(likelihood, plausible=np.inf):
    """Return a Fitted with all known parameters re-tuned, and its columns (P, R)."""
    return retuned(likelihood, likelihood.robot, np.zeros(len(likelihood.nuisances)), plausible)


def driven(robot, nominal, gains, reference, time, *effects, **options):
    """Return the Recording of a robot with effects, by the integrator of hidden robots."""
    run = truth.simulate(replace(robot, effects=effects), nominal, gains, reference, seed=1,
                         **options)
    return Recording(
        joints=robot.joints, time=time, q_link=run.measured[:, 0], q_motor=run.measured[:, 2],
        command=run.command, tau_motor=np.vstack([np.zeros((1, 2)), run.command[:-1]]),
        reference=reference, source='simulated')


def rms_left(motion, constants):
    """Return the residual torque (2 n,) of a model in the middle of a Motion, rms [N m]."""
    left = unexplained(motion, constants)[50:-50]
    return np.sqrt(np.mean(uniform_filter1d(left, 10, axis=0) ** 2, axis=0))
