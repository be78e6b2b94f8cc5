# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Speed of identification: the fit of one joint, beside plain numpy, and a whole bag."""

from dataclasses import fields, is_dataclass, replace
import os
from pathlib import Path
import subprocess
import tempfile
from time import perf_counter
from typing import NamedTuple

from bench.identification_simulated import read_identification_plan, simulate_identification
from bench.speed.numpy_identification import PlainObjective, search
from bench.speed.timing import Measurement
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.experiment.driven import executable
from gms_flex_control.experiment.identification_plan import plan_identification
from gms_flex_control.file_io import share_path
from gms_flex_control.identification.coordinates import Coordinates, N_STEADY
from gms_flex_control.identification.friction_fit import fit_all, rough_theta
from gms_flex_control.identification.friction_map import friction_map, start_of
from gms_flex_control.identification.least_squares import prior_of, refine
from gms_flex_control.identification.objective import Bundle, Objective, observer_bandwidth
from gms_flex_control.identification.segments import drive_sides, half_count, segments_of
from gms_flex_control.schema.files import save_robot
import numpy as np

N_BLOCKS = 6          # as in the paper
_RATES = (250.0, 125.0)  # of the recordings: presliding, full [Hz]
_SHARPNESS = (2.0, 1.0)
_KNOWN = 1e12         # precision of numbers that are known
_REPEATS = 3
_TARGET = 50.0        # times faster
_AS_GOOD = 1e-4       # relative cost that counts as equal
_BUDGETS, _QUICK_BUDGET = (45.0, 75.0), 2.0  # of the reference: presliding, full [s]
_PRESLIDING = {'identification.experiments': ('presliding',),
               'identification.presliding_levels': (0.5, 0.8)}
_FULL = {'identification.speeds': 4, 'identification.presliding_levels': (0.8,),
         'identification.sliding_speeds': (2.0,), 'identification.sliding_duration': 5.0}
_LIMITS = {'lower': -1.6, 'upper': 1.6, 'velocity': 2.5, 'acceleration': 6.0}
_SHORT = {'identification.repeats': 1, 'identification.break_away_repeats': 1,
          'identification.presliding_places': 1}
_TEN_MINUTES = {'identification.speeds': 8, 'identification.repeats': 2,
                'identification.break_away_repeats': 2, 'identification.presliding_places': 2}
_SHORT_BAG = {'identification.speeds': 3, 'identification.repeats': 1,
              'identification.break_away_repeats': 1, 'identification.presliding_places': 1}
_LONGEST, _MEMORY = 60.0, 1.0  # targets [s, GB] for ten minutes


class Comparison(NamedTuple):
    """One fit, in our way and in the plain way."""

    name: str
    bundle: Bundle
    objective: Objective
    coordinates: Coordinates
    start: np.ndarray     # free numbers to begin with
    prior: object         # Prior of our fit
    ours: object          # () -> free numbers
    moving: np.ndarray    # which numbers the reference moves


def single(params, j):
    """Return a parameter dataclass with the arrays of all joints cut down to joint ``j``."""
    changes = {}
    for field in fields(params):
        value = getattr(params, field.name)
        if is_dataclass(value):
            changes[field.name] = single(value, j)
        elif isinstance(value, np.ndarray) and value.ndim and field.name != 'gravity':
            changes[field.name] = value[j:j + 1]
    return replace(params, **changes)


def single_axis(robot, j):
    """Return joint ``j`` of a robot as an axis of its own, without gravity."""
    arm = replace(single(robot.arm, j), kind='decoupled', gravity=np.zeros(2))
    return replace(robot, joints=robot.joints[j:j + 1], motors=robot.motors[j:j + 1], arm=arm,
                   friction=single(robot.friction, j), effects=())


def simulated(robot, gains, values, rate):
    """
    Simulate an experiment on the last joint of a robot, as an axis of its own.

    With ``values`` (dict) of ``identification.*`` parameters at a ``rate`` [Hz]; return the axis
    and its Bundle.
    """
    j = robot.n_joints - 1
    axis, own = single_axis(robot, j), single(gains, j)
    plan = plan_identification(_SHORT | values | {
        f'identification.{axis.joints[0]}.{name}': value for name, value in _LIMITS.items()},
        axis, own)
    recording, phases = simulate_identification(plan, axis, own, 1, rate=rate)
    pieces = segments_of(recording, axis, drive_sides(recording, axis), phases)
    half, period = half_count(recording, axis), recording.period
    observer = observer_bandwidth(axis.arm, axis.friction.forward.coulomb, half, 0.0 * half,
                                  period)
    return axis, Bundle(tuple(pieces), axis.arm, period, half, observer, (None,))


def known_steady(friction):
    """Return the steady parameters and C of one joint, shape (9,)."""
    return np.array([*(getattr(way, name)[0] for way in (friction.forward, friction.backward)
                       for name in ('static', 'coulomb', 'velocity', 'viscous')),
                     friction.attraction[0]])


def packed(steady, yields):
    """Return Coordinates and free numbers of blocks of equal weight with given yields."""
    coordinates = Coordinates(len(yields))
    return coordinates, coordinates.pack(steady[[0, 4]], steady[[1, 5]], steady[[2, 6]],
                                         steady[[3, 7]], steady[8], yields)


def fit_presliding(bundle, axis):
    """Return how the block stiffnesses of an axis are fitted, all else known: a Comparison."""
    finest = 0.5 * bundle.half[0]
    coordinates, start = packed(known_steady(axis.friction), np.geomspace(finest, 0.3, N_BLOCKS))
    objective = Objective(bundle, 0, [coordinates.unpack(start)[0]],
                          lambda segment: segment.phase == 'presliding')
    prior = prior_of(coordinates, start)
    prior.precision[:N_STEADY] = _KNOWN

    def ours():
        free = start
        for sharpness in _SHARPNESS:
            free = refine(objective, coordinates, free, prior, sharpness=sharpness,
                          roughly=sharpness > 1.0).free
        return free

    return Comparison('presliding fit', bundle, objective, coordinates, start, prior, ours,
                      np.arange(N_STEADY, coordinates.size))


def fit_everything(bundle, axis):
    """Return how all parameters of an axis are fitted: a Comparison."""
    angle = np.concatenate([segment.angle[:, 0] for segment in bundle.segments])
    start = start_of(friction_map(bundle.segments, bundle.arm, 0, bundle.period, bundle.half[0]),
                     float(np.ptp(angle)), 2.0 * bundle.half[0], axis.joints[0],
                     bundle.segments[0].source)
    theta = rough_theta(start, np.zeros(0))
    coordinates, free = packed(theta, np.geomspace(*start.yields[[0, -1]], N_BLOCKS))

    def ours():
        return fit_all(bundle, [start], [np.zeros(0)], 2.0 * bundle.half,
                       blocks=(N_BLOCKS,))[0].free

    return Comparison('full fit', bundle, Objective(bundle, 0, [theta]), coordinates, free,
                      prior_of(coordinates, free), ours, np.arange(coordinates.size))


def compare(case, budget, repeats):
    """
    Return Measurements of a fit, and of Nelder-Mead over plain numpy from the same start.

    On the same cost; ``budget`` is that of the reference, unless it reaches the same cost before
    [s]. The median of ``repeats`` of our fit counts.
    """
    free, times = case.ours(), []
    for _ in range(repeats):
        begin = perf_counter()
        case.ours()
        times.append(perf_counter() - begin)
    evaluation = case.objective.evaluate(case.coordinates, free, 1.0)
    cost, seconds = float(evaluation.cost.sum()), float(np.median(times))
    plain = PlainObjective(case.bundle, case.objective, evaluation.floor)

    def plain_cost(numbers):
        every = case.start.copy()
        every[case.moving] = numbers
        return plain.cost(case.coordinates.unpack(every)[0])

    first = plain_cost(case.start[case.moving])
    found = search(plain_cost, case.start[case.moving], cost * (1.0 + _AS_GOOD), budget)
    data = sum(len(segment.angle) for segment in case.bundle.segments)
    if found.reached:
        end = 'it reached our cost'
    elif found.seconds > budget:
        end = f'more than that: in {budget:g} s it did not reach our cost'
    else:
        end = 'it converged above our cost, which it never reaches'
    target = _TARGET if budget > _QUICK_BUDGET or found.reached else None
    return _rows(case, found, cost, seconds, first, data, end, target)


def _rows(case, found, cost, seconds, first, data, end, target):
    ratio = found.seconds / seconds
    return [
        Measurement(suite='fit', name=f'{case.name}, ours', value=seconds, unit='s',
                    note=f'cost {first:.5g} -> {cost:.5g}, {data} samples of one joint'),
        Measurement(suite='fit', name=f'{case.name}, Nelder-Mead over numpy',
                    value=found.seconds, unit='s',
                    note=f'cost {first:.5g} -> {found.cost:.5g} in {found.evaluations} '
                         'evaluations'),
        Measurement(suite='fit', name=f'{case.name}, times faster', value=ratio, unit='times',
                    target=target, note=end)]


def measure_fit(robot, gains, quick=False):
    """Time the presliding fit and the full fit of one joint beside the plain way."""
    found = []
    for values, make, budget, rate in zip(
            (_PRESLIDING, _FULL), (fit_presliding, fit_everything), _BUDGETS, _RATES,
            strict=True):
        axis, bundle = simulated(robot, gains, values, rate)
        found += compare(make(bundle, axis), _QUICK_BUDGET if quick else budget,
                         1 if quick else _REPEATS)
    return found


def measure_identification(robot, gains, quick=False):
    """Identify a simulated bag by the command in a process of its own; ``quick``: a short bag."""
    plan = read_identification_plan([share_path() / 'config' / 'identification.yaml'], robot,
                                    gains, overrides=_SHORT_BAG if quick else _TEN_MINUTES)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / 'bag'
        recording, phases = simulate_identification(plan, robot, gains, 1, rate=1000)
        write_recording(bag, recording, robot.motors, phases=phases)
        note = f'{recording.time[-1]:.0f} s at 1 kHz, {robot.n_joints} joints'
        del recording
        save_robot(robot, Path(folder) / 'robot.yaml')
        seconds, processor, memory = identified(bag, Path(folder))
    return [Measurement(suite='identify', name='identify a bag', value=seconds, unit='s',
                        target=None if quick else _LONGEST, at_least=False, note=note),
            Measurement(suite='identify', name='identify a bag, processor time of two cores',
                        value=0.5 * processor, unit='s', target=None if quick else _LONGEST,
                        at_least=False, note='what it takes where nothing else runs'),
            Measurement(suite='identify', name='identify a bag, peak memory',
                        value=memory / 1e9, unit='GB', target=_MEMORY, at_least=False)]


def identified(bag, folder):
    """
    Run the command on a bag, with robot.yaml in ``folder``; results go to ``out`` in it.

    Return wall time [s], processor time of all threads [s], and the largest resident memory
    [bytes] (Linux). GmsFlexError if it fails.
    """
    command = [*executable('gms_flex'), 'identify', str(bag), '--robot',
               str(folder / 'robot.yaml'), '--out', str(folder / 'out')]
    begin = perf_counter()
    with open(folder / 'log.txt', 'w', encoding='utf-8') as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)  # the usage of this child alone
        process.returncode = os.waitstatus_to_exitcode(status)
    seconds = perf_counter() - begin
    if process.returncode != 0:
        text = (folder / 'log.txt').read_text(encoding='utf-8').strip()
        raise GmsFlexError(f'gms_flex identify ended with {process.returncode}: '
                           f'{text.splitlines()[-1] if text else "no output"}')
    return seconds, usage.ru_utime + usage.ru_stime, 1024.0 * usage.ru_maxrss
