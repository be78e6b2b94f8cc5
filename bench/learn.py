# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench learn`: learned terms on hidden robots, clean ones and real machines."""

from dataclasses import replace
from functools import partial
import json
from pathlib import Path
import time
from typing import NamedTuple

from bench.hidden_robots import outsiders
from bench.hidden_robots.cases import make_case, require_known
from bench.hidden_robots.hide import seeds_of
from bench.journal import fingerprint, run_kept
from bench.real_machines.machines import BAND, MACHINES
from bench.real_machines.motion import low_pass, motion_of, residual_torque, rms
from bench.real_machines.split import identified, model_rms, parts_of
from gms_flex_control.answer import align
from gms_flex_control.cli.options import add_verb, number, option, out_folder, Verb, WORKERS
from gms_flex_control.discrepancy import motion as measured
from gms_flex_control.discrepancy.fitting import retuned
from gms_flex_control.discrepancy.gap import HORIZON, STRIDE, torque_rms
from gms_flex_control.discrepancy.learning import learn
from gms_flex_control.discrepancy.likelihood import Likelihood, Residuals
from gms_flex_control.discrepancy.residuals import fresh_state
from gms_flex_control.discrepancy.result import UNEXPLAINED
from gms_flex_control.discrepancy.samples import samples_of
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import write_text
from gms_flex_control.simulation import plant
import numpy as np

STATE = ('local_bump', 'stick_at_angle', 'speed_band')  # outsiders that are functions of state
OTHERS = ('friction_step', 'periodic_link_torque', 'random_link_torque', 'sliding_cogging')
CLEAN = 20.0          # recordings of clean robots [s]
ASKED_TORQUE, ASKED_FREE = 0.3, 0.6  # held-out energy above the floor, free-run error: at most
_SAMPLES = 800        # that a Gaussian process or a network is fitted to
_AWAY = 10.0          # times the error of the identified model: such a free run has run away
LONG, _GONE = 60.0, 10.0  # of free runs [s]; times the largest speed: such a run is ended
_STEP = 4e-4          # of integration [s]
_SOURCES = ('discrepancy', 'effects', 'identification', 'simulation')


class Item(NamedTuple):
    """One robot or machine to be tried."""

    kind: str        # of bench.hidden_robots.cases.KINDS, or 'real'
    name: str        # of an outsider or a machine
    seed: int
    duration: float  # of each recording [s]


VERB = Verb(
    'learn', lambda args: run(args),
    'learned terms on hidden robots, clean ones and real machines',
    'Hide disturbances that no effect of the catalogue explains, learn a term for each, and '
    'compare held-out torque and free runs before and after; the same for clean robots and for '
    'recordings of real machines, there beside a Gaussian process and a neural network. A killed '
    'run goes on.', (
        option('--seeds', default='0:3', metavar='A:B',
               help='of each disturbance (default: %(default)s)'),
        option('--disturbances', nargs='*', default=[*STATE, *OTHERS], metavar='NAME',
               help='hidden in robots (default: %(default)s)'),
        option('--clean', default='0:20', metavar='A:B',
               help='of clean robots (default: %(default)s)'),
        option('--machines', nargs='*', default=list(MACHINES), metavar='MACHINE',
               help=f'real ones (default: {" ".join(MACHINES)})'),
        number('--duration', 'S', 30.0, 'of recordings with a disturbance'),
        WORKERS, out_folder('learned.json, journal', 'learned')), ())
add_parser = partial(add_verb, VERB)


def run(args):
    """Try all, write and print the figures; return 0."""
    unknown = [name for name in args.machines if name not in MACHINES]
    if unknown:
        raise ConfigError(f'--machines {unknown[0]}: unknown, known are {", ".join(MACHINES)}')
    for name in args.disturbances:
        require_known('disturbance', name, outsiders.NAMES)
    items = [Item('outside', name, seed, args.duration) for seed in seeds_of(args.seeds)
             for name in args.disturbances if name in STATE or seed == 0]
    items += [Item('clean', '', seed, CLEAN) for seed in seeds_of(args.clean)]
    items += [Item('real', name, 0, 0.0) for name in args.machines
              if not MACHINES[name].absent()]
    found = run_kept(tried, {'/'.join(map(str, item)): item for item in items}, args, fingerprint(
        _SOURCES) + fingerprint(('learn.py',), Path(__file__).parent), 'robots')
    rows = list(found.values())
    write_text(Path(args.out) / 'learned.json', json.dumps(rows, indent=2) + '\n')
    print('\n\n'.join(text_of(rows)))
    return 0


def tried(item):
    """Return the figures of one Item as plain values."""
    return {**item._asdict(), **(of_machine(item) if item.kind == 'real' else of_robot(item))}


# --- hidden robots ------------------------------------------------------------------------------


def of_robot(item):
    """Return what is learned of a hidden robot: terms, changes of held-out torque and free run."""
    case = make_case(item.kind, item.seed, effect=item.name or None, duration=item.duration)
    recordings, holdout = [case.recording], [case.held_out]
    found = find_discrepancy(recordings, case.nominal, holdout=holdout)
    given = found
    if found.behind is not None:  # asked for all the same
        given = replace(found, verdict=UNEXPLAINED)
    begun = time.monotonic()
    result = learn(given, holdout=holdout)
    seconds = time.monotonic() - begun
    floor = healthy_torque(item) if item.kind == 'outside' else found.gap.floor
    before, after = (np.sum(np.maximum(one ** 2 - floor ** 2, 0.0)) for one in (
        found.gap.retuned, result.gap.after))
    free = [float(np.nansum(one ** 2)) for one in (
        found.gap.free_before, found.gap.free_after, result.gap.free_after)]
    worse = free[2] > free[1] or np.sum(result.gap.after ** 2) > np.sum(found.gap.after ** 2)
    return {'verdict': found.verdict, 'joint': case.truth.outsider_joint,
            'terms': [[one.effect, one.joint, one.formula] for one in result.learned],
            'energy': float(after / before) if before > 0.0 else 1.0,
            'free': float(np.sqrt(free[2] / free[0])), 'worse': bool(worse), 'seconds': seconds}


def healthy_torque(item):
    """Return the held-out residual of the same robot without the disturbance, rms (n,) [N m]."""
    case = make_case(item.kind, item.seed, effect=item.name, duration=item.duration,
                     healthy=True)
    likelihood = Likelihood([measured.motion_of(case.recording, case.nominal)], case.nominal)
    model, _ = retuned(likelihood, case.nominal, np.zeros(len(likelihood.nuisances)), PLAUSIBLE)
    held = Residuals([measured.motion_of(case.held_out, case.nominal)], case.nominal)
    return torque_rms(held, model)


# --- real machines ------------------------------------------------------------------------------


def of_machine(item):
    """Return held-out torque and free runs of a machine's models, learned ones of others too."""
    machine = MACHINES[item.name]
    split = machine.splits[0]
    fitted, held = ([machine.recording(piece) for piece in pieces]
                    for pieces in (split.fitted, split.held_out))
    robot, _ = identified(machine, fitted)
    found = find_discrepancy(fitted, robot, SearchOptions(force=True), holdout=held)
    begun = time.monotonic()
    result = learn(found, holdout=held)
    rows = {'as found': (model_rms(held, found.robot, BAND), *free_error(held, found.robot), 0.0),
            'learned term': (model_rms(held, result.robot, BAND),
                             *free_error(held, result.robot), time.monotonic() - begun)}
    for name, make in (('Gaussian process', gaussian_process), ('neural network', network)):
        begun = time.monotonic()
        inputs, torque = (np.concatenate(one) for one in zip(
            *(along(one, found.robot) for one in fitted), strict=True))
        peer = _Peer(make, inputs, torque)
        left = np.concatenate([
            low_pass(residual_torque(one, found.robot) - peer.of(along(one, found.robot)[0]),
                     BAND, motion.period)[mask]
            for one, (motion, mask) in zip(held, parts_of(held, BAND), strict=True)])
        seconds = time.monotonic() - begun
        rows[name] = (rms(left), *free_error(held, found.robot, peer), seconds)
    return {'verdict': found.verdict, 'models': rows, 'unit': machine.unit,
            'factor': machine.factor, 'length': list(machine.length),
            'terms': [[one.effect, one.joint, one.formula] for one in result.learned]}


def along(recording, robot):
    """Return the inputs (S, 3) of a peer along a recording, and the torque it is to learn (S,)."""
    motion = motion_of(recording)
    return inputs_of(motion.angle, motion.rate, rms(motion.rate)), residual_torque(
        recording, robot)


def inputs_of(angle, rate, usual):
    """
    Return angle, rate and direction as the inputs (S, 3) of a peer.

    Not the torque: what is left is the torque less that of the model, so a function of it and the
    motion says nothing of the machine.
    """
    return np.stack([angle, rate, np.tanh(rate / (0.03 * usual))], axis=1)


class _Peer:
    """A regression of a residual torque on the state, inputs scaled."""

    def __init__(self, make, inputs, torque):
        self._middle, self._width = inputs.mean(axis=0), inputs.std(axis=0) + 1e-12
        self._size, self.usual = float(torque.std()), rms(inputs[:, 1])
        at = np.random.default_rng(0).permutation(len(torque))[:_SAMPLES]
        self._fit = make().fit((inputs[at] - self._middle) / self._width, torque[at] / self._size)

    def of(self, inputs):
        """Return the torque of the drive (S,) that a model lacks."""
        return self._size * self._fit.predict((inputs - self._middle) / self._width)


def gaussian_process():
    """Return a Gaussian process with a length for each input."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, RBF, WhiteKernel
    return GaussianProcessRegressor(
        ConstantKernel() * RBF(np.ones(3), (0.05, 1e3)) + WhiteKernel(), normalize_y=True)


def network():
    """Return a small neural network, stopped where a tenth of the data says so."""
    from sklearn.neural_network import MLPRegressor
    return MLPRegressor(hidden_layer_sizes=(16, 16), early_stopping=True, max_iter=1000,
                        random_state=0)


def free_runs(recording, robot, peer=None):
    """
    Return the rms errors of free runs of half a second [rad], and how fast one of a minute gets.

    That is driven by the recorded torque, again and again; its largest speed is over the largest
    measured. Blocks of friction begin unloaded; a peer's torque is that of the state simulated,
    held over a sample.
    """
    samples = samples_of(recording, robot)
    horizon, stride = (max(round(one / samples.period), 2) for one in (HORIZON, STRIDE))
    begins = np.arange(stride, len(samples.time) - horizon, stride)
    squares, fastest = np.zeros(len(begins)), 0.0
    for k, (angle, _) in enumerate(_simulated(samples, robot, begins, horizon, peer)):
        squares += (samples.readings[begins + k, 0, 0] - angle) ** 2
    largest = np.abs(samples.states[:, 1, 0]).max()
    for _, rate in _simulated(samples, robot, begins[:1], round(LONG / samples.period), peer):
        fastest = max(fastest, float(np.nan_to_num(abs(rate[0]), nan=np.inf)))
        if fastest > _GONE * largest:
            break
    return np.sqrt(squares / horizon), fastest / largest


def _simulated(samples, robot, begins, steps, peer):
    """Yield angles and rates (B,) at each of so many steps of runs that begin at samples (B,)."""
    constants, work = plant.constants_of(robot), plant.workspace(1)
    states = [fresh_state(constants) for _ in begins]
    for state, k in zip(states, begins, strict=True):
        for row, name in enumerate(('q_link', 'dq_link', '', 'q_motor', 'dq_motor')):
            if name:
                state[name][:] = samples.states[k, row]
    for step in range(steps):
        angle, rate = (np.array([state[name][0] for state in states])
                       for name in ('q_link', 'dq_link'))
        yield angle, rate
        at = (begins + step) % len(samples.command)
        pushed = np.zeros(len(begins)) if samples.pushed is None else samples.pushed[at, 0]
        if peer is not None:  # what the drive gives too little
            pushed = pushed - peer.of(np.nan_to_num(inputs_of(
                angle, rate, peer.usual), posinf=1e9, neginf=-1e9))
        for i, state in enumerate(states):
            work.outside[:] = pushed[i]
            plant.advance(state, samples.command[at[i]], samples.time[at[i]], samples.period,
                          max(1, round(samples.period / _STEP)), constants, work)


def free_error(recordings, robot, peer=None):
    """Return the median error of free runs [rad], the share that ran away, and of a minute."""
    errors, fastest = zip(*(free_runs(one, robot, peer) for one in recordings), strict=True)
    errors = np.concatenate(errors)
    errors = errors[~np.isnan(errors) | (peer is not None)]
    away = ~(errors < _AWAY * np.nanmedian(errors))
    return float(np.nanmedian(errors)), float(np.mean(away)), float(max(fastest))


# --- words --------------------------------------------------------------------------------------


def text_of(rows):
    """Yield tables of the figures."""
    hidden = [one for one in rows if one['kind'] == 'outside']
    yield align(['disturbance', 'seed', 'verdict', 'energy', 'free run', 's', 'learned'], [
        [one['name'], str(one['seed']), one['verdict'], f'{one["energy"]:.2f}',
         f'{one["free"]:.2f}', f'{one["seconds"]:.0f}',
         '; '.join(formula for _, _, formula in one['terms']) or '-'] for one in hidden])
    state = [one for one in hidden if one['name'] in STATE]
    if state:
        yield (f'Functions of state: {sum(bool(one["terms"]) for one in state)} of {len(state)} '
               f'learned; held-out energy above that of the healthy robot, median '
               f'{np.median([one["energy"] for one in state]):.2f}, at most {ASKED_TORQUE} in '
               f'{sum(one["energy"] <= ASKED_TORQUE for one in state)}; free-run error, median '
               f'{np.median([one["free"] for one in state]):.2f}, at most {ASKED_FREE} in '
               f'{sum(one["free"] <= ASKED_FREE for one in state)}.')
    yield f'Made worse by a term: {sum(one["worse"] for one in hidden)} of {len(hidden)}.'
    clean = [one for one in rows if one['kind'] == 'clean']
    if clean:
        yield (f'Clean robots with a term: {sum(bool(one["terms"]) for one in clean)} of '
               f'{len(clean)}.')
    for one in rows:
        if one['kind'] == 'real':
            name, factor = one['length']
            yield '\n'.join([f'{MACHINES[one["name"]].title} ({one["verdict"]}): ' + (
                '; '.join(formula for _, _, formula in one['terms']) or 'no term'), align(
                ['model', f'torque [{one["unit"]}]', f'free run [{name}]', 'ran away',
                 'speed in a minute', 's'],
                [[model, f'{one["factor"] * torque:.3g}', f'{factor * free:.3g}',
                  f'{100 * away:.0f} %', f'{minute:.1f}' if minute < _GONE else 'runs away',
                  f'{seconds:.1f}']
                 for model, (torque, free, away, minute, seconds) in one['models'].items()])])
