# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Nuisance parameters: what a user knows of a robot, but never exactly, each with its prior.

Each is a relative change of numbers the model has, re-tuned with every hypothesis. Its prior is
normal; a change that such a prior makes implausible is an error with a name, such as
stiffness_error, whose own prior is as wide as errors are.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from gms_flex_control import records
from gms_flex_control.data.recording import later
from gms_flex_control.discrepancy.motion import Motion
from gms_flex_control.effects.registry import find
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import RobotParams, sd_of, WHOLE_ARM
from gms_flex_control.simulation import plant
import numpy as np

LARGEST = 0.8     # relative change: nothing that a model has vanishes altogether
OF_SHAPE = ('static', 'velocity', 'attraction', 'blocks')  # residuals are not linear in them
_CARRIED = {'planar': ('coupling', 'moment'), 'urdf': ('mass', 'inertia')}  # of links
_OF_LINKS = frozenset(name for names in _CARRIED.values() for name in names)
_PROBE = 0.01     # relative change that shows what effects make of them
_TURNS = 3        # of the search for what they are without effects


class _Kind(NamedTuple):
    """One way in which recordings differ."""

    sd: float             # of its prior, in units
    least: float          # that is reported, in units
    what: str
    unit: str             # in which it is reported
    factor: float         # of which one SI unit has so many
    clear: Callable | None = None  # clears torques of a joint (T,) of a size; None: of angles


def _of_bias(torque, size):
    torque -= size


def _of_scale(torque, size):
    torque /= 1.0 + size


def _of_delay(torque, size):
    torque[1:] -= size * np.diff(torque)  # held: a sample has the mean of what acted in it


# units: Coulomb friction, torque, a sample, and the torsion that ten times Coulomb friction makes
OF_RECORDING = {
    'torque_bias_of_recording': _Kind(0.05, 0.01, 'torque', 'N m', 1.0, _of_bias),
    'torque_scale_of_recording': _Kind(0.01, 0.01, 'torque', '%', 100.0, _of_scale),
    'delay_of_recording': _Kind(0.1, 0.1, 'torque', 'samples later', 1.0, _of_delay),
    'zero_of_recording': _Kind(0.1, 0.001, 'zero of the link encoder', 'mrad', 1e3)}
_ZEROS = 10.0


class Nuisance(NamedTuple):
    """One relative change of known parameters."""

    name: str
    joint: int            # -1 for the whole arm
    sd: float             # standard deviation of its prior
    fields: tuple         # of (part, field, index) of the kernels' record
    signs: tuple          # +1 or -1 for each field

    def apply(self, boxed, value, own) -> None:
        """
        Change a boxed record of simulation.plant.constants_of in place by ``value``.

        Of links that is a share of what they are in the record ``own``, without effects: what is
        known of a link says nothing of its payload, and the sum is linear in both.
        """
        for (part, field, index), sign in zip(self.fields, self.signs, strict=True):
            if field in _OF_LINKS:
                boxed[part][field][0][index] += sign * value * own[part][field][index]
            else:
                boxed[part][field][0][index] *= 1.0 + sign * value


class RotorNuisance(NamedTuple):
    """One relative change of the motor inertia of a rigid joint, which several numbers share."""

    joint: int
    sd: float             # standard deviation of its prior
    name = 'motor_inertia'
    fields = (('chain', 'motor_inertia', ...), ('chain', 'rigid_inertia', ...))

    def apply(self, boxed, value, own) -> None:
        """Change a boxed record of simulation.plant.constants_of in place by ``value``."""
        own, seen, inverse = (boxed['chain'][name][0] for name in (
            'motor_inertia', 'rigid_inertia', 'inverse'))
        toward = inverse[self.joint]
        seen += value * own[self.joint] * np.outer(toward, toward)  # theta is not the joint's
        own[self.joint] *= 1.0 + value


class OfRecording(NamedTuple):
    """Encoder zero, torque or time in which a recording differs from the first of them."""

    name: str
    joint: int
    recording: int
    sd: float             # standard deviation of its prior, in units
    unit: float           # of the kind [rad], [N m], 1 or [samples]
    fields = ()

    @property
    def kind(self) -> _Kind:
        """Return the way in which it differs."""
        return OF_RECORDING[self.name]

    def apply(self, boxed, value, own) -> None:
        """Leave a record of simulation.plant.constants_of as it is: no robot has it."""

    def words(self, joints, value) -> str:
        """Return ``value`` units in words, of a robot with ``joints``."""
        size = self.kind.factor * value * self.unit
        return (f'{self.kind.what} of {joints[self.joint]} {size:+.3g} {self.kind.unit} in '
                f'recording {self.recording + 1}')

    def is_reported(self, value) -> bool:
        """Return whether ``value`` units matter."""
        return abs(value) > self.kind.least


def recorded(motion, values) -> Motion:
    """Return a Motion cleared of what is particular: ``values`` (OfRecording, float), tuple."""
    zeros = tuple((one.joint, value * one.unit) for one, value in values if not one.kind.clear)
    if zeros:
        motion = motion.once(('zeros', zeros), lambda: _with_zeros(motion, zeros))
    if len(zeros) == len(values):
        return motion

    def cleared(command):
        torque = command.copy()
        for one, value in values:
            if one.kind.clear:
                one.kind.clear(torque[:, one.joint], value * one.unit)
        return torque
    return motion.with_torque(tuple((one.name, one.joint, value) for one, value in values),
                              cleared)


def _misrecorded(robot):
    """Return the effects of a robot that are errors of recorded torques, list of EffectSpec."""
    return [spec for spec in robot.effects if find(spec.name).torque_delay]


def _acting_later(torque, period, delay):
    """Return torques (T, n) held over samples as means over these if they act later [s]."""
    return later(torque, period * np.arange(len(torque) + 1), delay)


def acting(motions, robot) -> tuple:
    """
    Return Motions with the torques that acted, and the robot without errors of recorded ones.

    That is exact, where errors of angles, which such effects are in the plant, are not.
    """
    wrong = _misrecorded(robot)
    for spec in wrong:
        motions = [motion.with_torque((spec.name, *spec.values), partial(
            _acting_later, period=motion.samples.period,
            delay=find(spec.name).torque_delay(spec.values)))
            for motion in motions]
    return motions, replace(robot, effects=tuple(
        spec for spec in robot.effects if spec not in wrong)) if wrong else robot


def as_recorded(run, motion, acted, robot) -> Motion:
    """
    Return a Motion with its torques as they would have been recorded.

    ``run`` is under torques of ``acted``, which `acting` makes of the recorded ``motion``, and
    slow ones beside them; the ``robot`` has its errors of recorded torques.
    """
    wrong = _misrecorded(robot)

    def back(held):
        beside = held - acted.samples.command
        for spec in reversed(wrong):
            beside = _acting_later(beside, motion.samples.period,
                                   -find(spec.name).torque_delay(spec.values))
        return motion.samples.command + beside
    return run.with_torque('as recorded', back) if wrong else run


def _with_zeros(motion, zeros):
    """Return a Motion with link encoders of joints reading less, (joint, rad) each."""
    states, fine, readings = (one.copy() for one in (
        motion.states, motion.samples.states, motion.samples.readings))
    for j, size in zeros:
        for angles in (states, fine, readings):
            angles[:, 0, j] -= size
    return replace(motion, states=states, samples=replace(
        motion.samples, states=fine, readings=readings), _kept={})


def of_recordings(motions, robot) -> tuple:
    """Return the nuisance parameters of all recordings (Motions) but the first, tuple."""
    level = 0.5 * (robot.friction.forward.coulomb + robot.friction.backward.coulomb)
    unseen, found = {link.joint for motion in motions for link in motion.samples.unseen}, []
    for j in range(robot.n_joints):
        kinds = [('torque_bias_of_recording', level[j]), ('torque_scale_of_recording', 1.0),
                 ('delay_of_recording', 1.0)]
        if not robot.arm.rigid[j] and j not in unseen:
            kinds.append(('zero_of_recording', _ZEROS * level[j] / robot.arm.stiffness[j]))
        found += [OfRecording(name, j, m, OF_RECORDING[name].sd, unit)
                  for name, unit in kinds for m in range(1, len(motions))]
    return tuple(found)


def nuisances_of(robot) -> tuple:
    """Return the nuisance parameters of a robot, tuple of Nuisance and RotorNuisance."""
    constants, found, n = plant.constants_of(robot), [], robot.n_joints
    chain, friction = constants.chain, constants.friction

    def sd(kind, joint):
        return sd_of(robot, kind, robot.joints[joint] if joint >= 0 else WHOLE_ARM)

    def add(kind, joint, *fields, signs=None):
        found.append(Nuisance(kind, joint, sd(kind, joint), fields, signs or (1,) * len(fields)))

    planar = 'coupling' in chain.dtype.names
    heavy = np.any(chain.gravity != 0.0)
    for i in range(n):
        if not planar:
            add('gravity' if heavy else 'inertia', i, ('chain', 'mass', i))
            add('inertia', i, ('chain', 'inertia', i))
            continue
        # what link i has of mass times distance: gravity and its coupling to every link before
        moment = [('chain', 'coupling', pair) for k in range(i) if chain.coupling[k, i] != 0.0
                  for pair in ((k, i), (i, k))]
        if heavy and chain.moment[i] != 0.0:
            add('gravity', i, *moment, ('chain', 'moment', i))
        elif moment:
            add('inertia', -1, *moment, ('chain', 'moment', i))
        if chain.coupling[i, i] != 0.0:
            add('inertia', i, ('chain', 'coupling', (i, i)))
    for j in range(n):
        if chain.flexible[j]:
            add('stiffness', j, ('chain', 'stiffness', j))
            add('motor_inertia', j, ('chain', 'motor_inertia', j))
        elif chain.motor_inertia[j] > 0.0 and not planar:
            add('motor_inertia', j, ('chain', 'motor_inertia', j))
        elif chain.motor_inertia[j] > 0.0:
            found.append(RotorNuisance(j, sd('motor_inertia', j)))
        if chain.damping[j] > 0.0:
            add('damping', j, ('chain', 'damping', j))
        level = [('friction', name, (row, j)) for row in (0, 1) for name in ('static', 'coulomb')]
        add('level', j, *level)
        add('asymmetry', j, *level, signs=(1, 1, -1, -1))
        for kind, signs in (('viscous', (1, 1)), ('viscous_asymmetry', (1, -1))):
            add(kind, j, *(('friction', 'viscous', (row, j)) for row in (0, 1)), signs=signs)
        above = (1.0 - 2.0 * sd('static', j)) * friction.static[:, j] >= friction.coulomb[:, j]
        if above.all():  # else it may fall below Coulomb friction; stribeck_error lifts it
            add('static', j, *(('friction', 'static', (row, j)) for row in (0, 1)))
        for row in (0, 1):
            add('velocity', j, ('friction', 'velocity', (row, j)))
        add('attraction', j, ('friction', 'attraction', j))
        add('blocks', j, ('friction', 'stiffness', j))
    return tuple(found)


def tuned(constants, nuisances, values, own=None) -> np.record:
    """Return a copy of constants with nuisances at ``values`` (P,); ``own`` lack effects."""
    boxed = records.boxed(constants)
    for nuisance, value in zip(nuisances, values, strict=True):
        if value != 0.0:
            nuisance.apply(boxed, value, constants if own is None else own)
    return boxed[0]


def with_nuisances(robot, nuisances, x) -> RobotParams:
    """Return a robot whose own parameters are what nuisances ``x`` (P,) make them, as `tuned`."""
    bare = plant.constants_of(replace(robot, effects=()))
    wanted = tuned(plant.constants_of(robot), nuisances, x, bare).chain
    record = tuned(bare, nuisances, x)
    # some effects scale what a link is, and so what nuisance parameters add; what effects make of
    # it is affine in what it is without them, unless a mass must give way
    probes = {name: _probe(name, robot.n_joints)
              for name in _CARRIED['urdf' if robot.arm.frames else 'planar']}
    for _ in range(_TURNS):
        whole, other = _carried(probes, robot, record), record.copy()
        for name, probe in probes.items():
            getattr(other.chain, name)[...] *= 1.0 + probe
        for (name, probe), one, two in zip(
                probes.items(), whole, _carried(probes, robot, other), strict=True):
            own = getattr(record.chain, name)
            change = probe * own
            own += (getattr(wanted, name) - one) / np.divide(
                two - one, change, out=np.ones_like(own), where=change != 0.0)
    return _with_record(robot, record)


def _probe(name, joints):
    """Return relative changes of a field of links with which each keeps its mass."""
    moments = np.sqrt(1.0 + _PROBE) - 1.0
    if name == 'coupling':
        return np.where(np.eye(joints, dtype=bool), _PROBE, moments)
    return moments if name == 'moment' else _PROBE


def _carried(names, robot, record):
    """Return fields of links, with effects, of a robot whose own parameters are a record's."""
    chain = plant.constants_of(_with_record(robot, record)).chain
    return [np.array(getattr(chain, name)) for name in names]


def _with_record(robot, record):
    """Return a robot whose parameters, effects left out, are those of a kernels' record."""
    friction, links = record.friction, record.chain
    sides = {}
    for row, side in enumerate(('forward', 'backward')):
        steady = getattr(robot.friction, side)
        coulomb = np.array(friction.coulomb[row])
        sides[side] = replace(steady, coulomb=coulomb,
                              static=np.maximum(friction.static[row], coulomb),
                              velocity=np.array(friction.velocity[row]),
                              viscous=np.array(friction.viscous[row]))
    arm = with_base(robot.arm, links)
    arm = replace(
        arm, stiffness=np.where(robot.arm.rigid, robot.arm.stiffness, links.stiffness),
        damping=np.where(robot.arm.rigid, robot.arm.damping, links.damping),
        motor_inertia=np.array(links.motor_inertia))
    return replace(robot, arm=arm, friction=replace(
        robot.friction, **sides, stiffness=np.array(friction.stiffness),
        attraction=np.array(friction.attraction)))


def with_base(arm, links) -> ArmParams:
    """Return an arm whose links have the inertia and moments of the kernels' record."""
    if arm.frames:
        rows, columns = np.triu_indices(3)
        tensor = np.empty(arm.inertia.shape)
        tensor[:, rows, columns] = tensor[:, columns, rows] = links.inertia
        return replace(arm, mass=np.array(links.mass), inertia=tensor)
    mass, com, inertia = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
    planar = arm.kind == 'planar'
    for i in range(arm.n_joints - 1, -1, -1):
        carried = mass[i + 1:].sum() if planar else 0.0
        moment = links.moment[i]
        if planar and i > 0 and arm.length[i - 1] > 0.0:
            moment = links.coupling[i - 1, i] / arm.length[i - 1]
        own = moment - carried * arm.length[i]
        about = links.coupling[i, i] - carried * arm.length[i] ** 2
        if mass[i] > 0.0:
            if own ** 2 > mass[i] * about > 0.0:  # with that mass no link turns so easily
                mass[i] = own ** 2 / about
            com[i] = own / mass[i]
        inertia[i] = max(about - mass[i] * com[i] ** 2, 0.0)
    return replace(arm, mass=mass, com=com, inertia=inertia)
