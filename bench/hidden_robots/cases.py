# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Cases of the test bench: a robot with something hidden in it, drawn from kind and seed."""

from dataclasses import dataclass, replace
from functools import partial

from bench.hidden_robots import motions, outsiders, plants, sizes, truth
from bench.hidden_robots.populations import belief_errors, Drives, POPULATIONS
from gms_flex_control.data.recording import Recording
from gms_flex_control.effects import registry
from gms_flex_control.errors import ConfigError, did_you_mean, SimulationError
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams
import numpy as np

KINDS = ('single', 'clean', 'double', 'outside', 'clutter', 'deleted')
DURATION = 60.0
CLUTTER, CLUTTER_SIZE = 14, (0.01, 0.03)  # how many small effects, of how much of F_s
_DOMINANT = 1.5       # times the torque of each small one
_TRIES, _SOFTER = 20, 0.8  # of draws, and what each takes off the gains of the motor law
# beyond these nobody would record the robot: from the reference, rms [rad]; time at the limit
_FARTHEST, _LIMITED = 0.6, 0.01
_OF_POPULATION = 1    # stream of the numbers that are no others' than a population's
_SHORTEST, _LONGEST = 2.0, 3600.0  # recordings [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """What is hidden in a case."""

    kind: str  # one of `KINDS`
    seed: int  # from which it was drawn
    population: str
    plant: str  # 'soft' or 'stiff'
    motion: str  # one of `motions.MOTIONS`
    effects: tuple  # the main effects
    clutter: tuple  # small ones in the background
    outsider: str | None  # name of the disturbance from outside the catalogue
    outsider_joint: str | None  # where it acts
    robot: RobotParams  # the true robot, all effects included
    # (n_joints,), how far the robot is from what is believed, see `populations.belief_errors`
    belief_errors: dict
    # (n_joints,), standard deviation over a sample of the torque the drives add [N m]
    torque_noise: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One case as the user of a robot has it, and the truth about it."""

    # two motions of the same robot; ``tau_motor`` is the torque the drives were asked for
    recording: Recording
    held_out: Recording
    nominal: RobotParams  # the robot as believed: at home every parameter is 1 to 3 % off
    # with which it was driven; None of another controller than the cascade
    gains: ControllerParams | None
    truth: Truth  # not for the tool that is tried

    def without_links(self):
        """Return the Case of a robot whose links have no encoders."""
        return replace(self, recording=_without_links(self.recording),
                       held_out=_without_links(self.held_out))


def _without_links(recording):
    unknown = np.full_like(recording.q_link, np.nan)
    return replace(recording, q_link=unknown, dq_link=unknown)


def available_effects():
    """Return the effects that can be hidden, tuple of str in a fixed order."""
    return tuple(name for name in sizes.MAIN if name in registry.names())


def in_turn(seed):
    """Return the effect whose turn it is at a seed, str."""
    names = available_effects()
    return names[seed % len(names)]


def require_known(what, value, known):
    """Raise ConfigError if ``value`` (str) is not among those ``known``."""
    if value not in known:
        raise ConfigError(f'{what} {value!r} is unknown{did_you_mean(value, known)}')


def require_duration(duration):
    """Raise ConfigError if recordings cannot take ``duration`` (float) [s]."""
    if not _SHORTEST <= duration <= _LONGEST:
        raise ConfigError(f'--duration {duration:g}: give {_SHORTEST:g} to {_LONGEST:g} s')


def make_case(kind, seed, *, population='home', motion=None, plant=None, duration=DURATION,
              effect=None, gravity=False, healthy=False):
    """
    Draw a case.

    Parameters
    ----------
    kind : str
        'single', 'clean', 'double', 'outside' (a disturbance the catalogue lacks), 'clutter'
        (one effect among many small ones) or 'deleted' (single; the catalogue will lack it).
    seed : int
        Every number comes from it and from ``kind``. Effects and disturbances are taken in
        turn, so that successive seeds hold each of them.
    population : str
        Which robots, of `populations.POPULATIONS`.
    motion : str, optional
        What the robot does, of `motions.MOTIONS`, instead of what the population does.
    plant : {'soft', 'stiff'}, optional
        Default: drawn.
    duration : float
        Of each recording [s].
    effect : str, optional
        Main effect, or outsider, instead of the one whose turn it is.
    gravity : bool
        Whether the plane is tilted in any case.
    healthy : bool
        Whether the disturbance of kind 'outside' is left out, all else the same.

    Returns
    -------
    Case

    Raises
    ------
    ConfigError
        If kind, population, motion, plant or effect is unknown, or the duration none.
    SimulationError
        If no draw gave a robot that can be driven.

    """
    require_known('kind', kind, KINDS)
    require_known('population', population, POPULATIONS)
    row = POPULATIONS[population]
    row = replace(row, motion=motion or row.motion, gravity=gravity or row.gravity)
    require_known('motion', row.motion, motions.MOTIONS)
    require_duration(duration)
    if plant is not None:
        require_known('plant', plant, plants.PLANTS)
    if effect is not None:
        require_known('effect', effect,
                      outsiders.NAMES if kind == 'outside' else (
                          *available_effects(), *sizes.ASKED))
    if kind not in ('clean', 'outside') and (effect or in_turn(seed)) in row.without:
        raise ConfigError(f'robots of {population} cannot have {effect or in_turn(seed)}: take '
                          'another seed or effect')
    rng = np.random.default_rng([KINDS.index(kind), seed])
    own = np.random.default_rng([KINDS.index(kind), seed, _OF_POPULATION])
    drawn_plant = str(rng.choice(plants.PLANTS))
    plant = plant or drawn_plant
    for softer in row.softness * _SOFTER ** np.arange(_TRIES):
        try:
            case = _draw(rng, own, kind, seed, row, plant, duration, effect, softer,
                         healthy)
        except SimulationError:  # cannot be driven with that in it: another one, more gently
            continue
        case = replace(case, truth=replace(case.truth, population=population))
        return case if row.links_seen else case.without_links()
    raise SimulationError(f'{kind} {seed}: none of {_TRIES} draws could be driven')


def _draw(rng, own, kind, seed, population, plant, duration, effect, softer, healthy):
    period = 1.0 / population.rate
    time = np.arange(round(duration / period)) * period
    robot, gains = plants.draw_robot(rng, plant)
    if population.gravity:
        robot, gains = plants.under_gravity(rng, robot, gains)
    gains = replace(gains, kd_motor=gains.kd_motor * softer,
                    lambda_motor=gains.lambda_motor * softer)
    nominal = plants.draw_belief(rng, robot)
    robot, nominal = (_with_encoders(one, population) for one in (robot, nominal))
    if population.beliefs is not None:
        nominal = plants.draw_belief(own, robot, population.beliefs)
    drives = Drives(own, population, robot)
    references = [motions.draw_reference(rng, population.motion, plant, time) for _ in range(2)]
    seeds = rng.integers(2 ** 31, size=3)
    driven = partial(_driven, period=period, drive=population.drive)
    bare = driven(robot, nominal, gains, references[0], seeds[2])
    figures = sizes.figures_of(robot, bare, period)
    effects, disturbances = (), (None, None)
    if kind == 'outside':
        name = effect or outsiders.NAMES[seed % len(outsiders.NAMES)]
        joint = int(rng.integers(robot.n_joints))
        first = outsiders.draw_disturbance(rng, name, joint, figures[joint], len(time), period)
        disturbances = first, first._replace(
            drawn=outsiders.draw_course(rng, name, len(time), period))
        disturbances = (None, None) if healthy else disturbances
    elif kind != 'clean':
        names = [name for name in available_effects() if name not in population.without]
        chosen = _names(rng, 2 if kind == 'double' else 1, effect or in_turn(seed), names)
        effects = tuple(_main(rng, name, robot, figures) for name in chosen)
    clutter = ()
    if kind == 'clutter':
        clutter = _clutter(rng, effects, robot, figures)
        torques = sizes.Torques(recording_of(bare, references[0], time, robot, False,
                                             'without effects', None), robot)
        others = (effect,) if effect else names
        effects = _dominant(rng, effects[0], clutter, robot, figures, torques, others)
    robot = replace(robot, effects=effects + clutter)
    with_rates = rng.random() < 0.5
    recordings = []
    for k, reference in enumerate(references):
        supply, seen = plants.draw_supply(rng, time)
        run = driven(robot, nominal, gains, reference, seeds[k], disturbance=disturbances[k],
                     supply=supply, noise=drives.draw(own, len(time)))
        recordings.append(recording_of(run, reference, time, robot, with_rates,
                                       f'{kind} {seed}', seen))
    if all(spec.name != 'supply_sag' for spec in effects) and rng.random() < 0.5:
        recordings = [replace(recording, supply=None) for recording in recordings]
    first = disturbances[0]
    return Case(recording=recordings[0], held_out=recordings[1], nominal=nominal,
                gains=None if population.drive is truth.under_pid else gains,
                truth=Truth(kind=kind, seed=seed, population='', plant=plant,
                            motion=population.motion, effects=effects, clutter=clutter,
                            outsider=first.name if first else None,
                            outsider_joint=robot.joints[first.joint] if first else None,
                            robot=robot, belief_errors=belief_errors(robot, nominal),
                            torque_noise=drives.deviation))


def _with_encoders(robot, population):
    """Return a robot with the encoders of its population, and as much noise in counts."""
    encoder = robot.encoder
    counts = float(population.counts or encoder.counts)
    return replace(robot, encoder=replace(
        encoder, counts=counts, noise=encoder.noise * (encoder.counts / counts),
        velocity_cutoff=population.velocity_cutoff))


def _driven(robot, nominal, gains, reference, seed, **others):
    motion = truth.simulate(robot, nominal, gains, reference, seed=int(seed), **others)
    limited = np.mean(np.abs(motion.command) >= gains.torque_limit, axis=0)
    if (sizes.rms(motion.true[:, 0] - reference[:, 0]).max() > _FARTHEST
            or limited.max() > _LIMITED):
        raise SimulationError('the robot does not follow its reference')
    return motion


def _names(rng, count, first, names):
    """Return the names of ``count`` different main effects, list of str."""
    chosen = [first]
    while len(chosen) < count:
        name = str(rng.choice(names))
        if name not in chosen:
            chosen.append(name)
    return chosen


def _main(rng, name, robot, figures):
    joint = sizes.place(rng, name, robot.joints)
    return sizes.spec(name, joint, robot.joints, (sizes.MAIN | sizes.ASKED)[name](
        rng, figures[joint]))


def _dominant(rng, main, clutter, robot, figures, torques, others):
    """
    Return the ``main`` effect alone in a tuple, with a size at which it is the dominant one.

    Where its usual sizes are too small on such a robot, one of ``others`` is drawn.
    """
    least = _DOMINANT * max(torques.of(spec) for spec in clutter)
    small = {spec.name for spec in clutter}
    others = [name for name in others if name not in small]
    for _ in range(_TRIES):
        for _ in range(_TRIES):
            if torques.of(main) >= least:
                return (main,)
            main = _main(rng, main.name, robot, figures)
        main = _main(rng, str(rng.choice(others)), robot, figures)
    raise SimulationError(f'{main.name} is not larger than the small effects')


def _clutter(rng, effects, robot, figures):
    """Return small effects with other names than the main ones, EffectSpec each."""
    names = [name for name in sizes.SMALL if name in registry.names()
             and name not in {spec.name for spec in effects}]
    specs = []
    for name in rng.choice(names, CLUTTER, replace=False).tolist():
        joint = sizes.place(rng, name, robot.joints)
        torque = rng.uniform(*CLUTTER_SIZE) * figures[joint].static
        specs.append(sizes.spec(name, joint, robot.joints,
                                sizes.SMALL[name](rng, figures[joint], torque)))
    return tuple(specs)


def recording_of(motion, reference, time, robot, with_rates, source, supply):
    """Return a Motion of a hidden robot as the Recording that its user has."""
    q_link, dq_link, q_motor, dq_motor = np.moveaxis(motion.measured, 1, 0)
    asked = np.vstack([np.zeros(robot.n_joints), motion.command[:-1]])
    unknown = np.full(q_link.shape, np.nan)
    return Recording(
        joints=robot.joints, time=time, q_link=q_link, q_motor=q_motor,
        dq_link=dq_link if with_rates else unknown,
        dq_motor=dq_motor if with_rates else unknown, tau_motor=asked, command=motion.command,
        reference=reference, friction_hat=motion.friction_hat, source=source,
        supply=supply)
