# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""One split of one machine: identify, ask what is missing, and put least squares beside it."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from bench.real_machines import least_squares
from bench.real_machines.least_squares import Part
from bench.real_machines.motion import low_pass, motion_of, residual_torque, rms
from gms_flex_control.discrepancy.compared import compare
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.output import write_friction
from gms_flex_control.schema.files import load_robot
import numpy as np

CRASHED = 'crashed'
FINE = 30.0   # bands above are looked at with every sample of the recording [Hz]


@dataclass(frozen=True, kw_only=True)
class InBand:
    """Residual torque of the data held out, rms in one band [N m]."""

    band: float
    torque: float       # what is measured
    textbook: float     # least squares (a)
    library: float      # least squares (b), all columns
    chosen: float       # (b), groups chosen by cross validation of what is fitted
    identified: float
    final: float
    groups: tuple       # of (b) that were chosen
    delay: float        # of (b), chosen [s]
    alone: dict         # residual over that of (a), one group more
    weights: dict       # of (b), chosen

    @property
    def ratio(self):
        """Return final over the better one of both (b)."""
        return self.final / min(self.library, self.chosen)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a split of a machine gave."""

    machine: str
    split: str
    bands: tuple                 # of InBand
    verdict: str
    named: tuple = ()            # (effect, {parameter: value})
    identified: tuple = ()       # effects of the identified robot, by name
    added: tuple = ()            # effects of the final robot, by name
    words: str = ''
    refused: str = ''            # why identification gave no robot
    free_before: float = np.nan  # [rad]
    free_after: float = np.nan
    identify_seconds: float = 0.0
    seconds: float = 0.0         # of discrepancy
    pictured: dict = field(default_factory=dict, repr=False, compare=False)


def try_split(machine, split, say=lambda text: None):
    """Run one Split of a Machine, whose files are there; return its Outcome."""
    fitted, held_out = ([machine.recording(piece) for piece in pieces]
                        for pieces in (split.fitted, split.held_out))
    say('least squares')
    peers = {band: least_squares.compared(parts_of(fitted, band), band, machine.gravity,
                                          machine.loaded) for band in machine.bands}
    say('identification')
    begun = time.monotonic()
    robot, refused = identified(machine, fitted)
    identify_seconds = time.monotonic() - begun
    say('discrepancy')
    begun = time.monotonic()
    answer = asked(fitted, robot, held_out)
    seconds = time.monotonic() - begun
    final = answer.get('robot') or robot
    bands = tuple(in_band(peers[band], held_out, robot, final, band)
                  for band in machine.bands)
    return Outcome(
        machine=machine.name, split=split.name, bands=bands, verdict=answer['verdict'],
        named=answer.get('named', ()), identified=tuple(spec.name for spec in robot.effects),
        added=tuple(spec.name for spec in final.effects),
        words=answer['words'], refused=refused,
        free_before=answer.get('free_before', np.nan),
        free_after=answer.get('free_after', np.nan), identify_seconds=identify_seconds,
        seconds=seconds,
        pictured=pictured(machine, peers[machine.bands[0]], held_out, robot, final))


def parts_of(recordings, band):
    """Return a Part per recording, with every sample where the band asks for it."""
    motions = [motion_of(recording, band > FINE) for recording in recordings]
    return [Part(motion, motion.used) for motion in motions]


def identified(machine, recordings):
    """
    Return the robot that identification finds, and '' or why it refuses: then the belief.

    As it is read from the files that users give to discrepancy.
    """
    robot = machine.believed(recordings[0])
    try:
        found = identify([(recording, ()) for recording in recordings], robot,
                         options=IdentifyOptions(estimate=machine.estimate))
    except GmsFlexError as error:
        return robot, str(error).replace(str(recordings[0].source), '').lstrip(': ')
    with TemporaryDirectory() as folder:
        written = Path(folder) / 'friction.yaml'
        write_friction(replace(found, described=bool(machine.files)), written)
        return load_robot((*machine.files, written)), ''


def asked(fitted, robot, held_out):
    """
    Return what discrepancy answers of fitted data; refused data are forced as well.

    Data held out take no part in the answer: its free runs on them are measured afterwards.
    """
    try:
        result = find_discrepancy(fitted, robot)
        verdict, words = result.verdict, result.words
        if result.robot is None:
            result = find_discrepancy(fitted, robot, SearchOptions(force=True))
            verdict, words = f'{verdict}, forced: {result.verdict}', f'{words} {result.words}'
    except Exception as error:  # noqa: B902  a crash is a result of this bench
        return {'verdict': CRASHED, 'words': f'{type(error).__name__}: {error}'}
    before, after = (float(one.free_run[0]) for one in compare(
        result, (('identified', robot), ('final', result.robot)), held_out))
    return {'verdict': verdict, 'words': words, 'robot': result.robot,
            'free_before': before, 'free_after': after,
            'named': tuple((one.effect, one.parameters) for one in result.named)}


def in_band(peers, held_out, robot, final, band):
    """Return the InBand of least squares and of both models."""
    parts = parts_of(held_out, band)
    plain = peers.plain.rms(parts)
    return InBand(
        band=band, torque=rms(np.concatenate([
            low_pass(motion.torque, band, motion.period)[mask] for motion, mask in parts])),
        textbook=plain, library=peers.whole.rms(parts), chosen=peers.chosen.rms(parts),
        identified=model_rms(held_out, robot, band), final=model_rms(held_out, final, band),
        groups=tuple(group for group in peers.chosen.groups if group not in peers.plain.groups),
        delay=peers.chosen.delay,
        alone={group: fit.rms(parts) / plain for group, fit in peers.alone.items()},
        weights={column.name: float(weight) for column, weight in
                 zip(peers.chosen.columns, peers.chosen.weights, strict=True)})


def model_rms(recordings, robot, band):
    """Return the residual torque of a model behind the low-pass, rms [N m]."""
    return rms(np.concatenate([
        low_pass(residual_torque(one, robot, band > FINE), band, motion.period)[mask]
        for one, (motion, mask) in zip(recordings, parts_of(recordings, band), strict=True)]))


def pictured(machine, peers, held_out, robot, final):
    """Return what a picture shows of the first recording held out: residuals over the motion."""
    band, recording = machine.bands[0], held_out[0]
    (motion, mask), = parts_of([recording], band)

    def low(values):
        return low_pass(values, band, motion.period)[mask]
    return {'time': motion.time[mask], 'angle': motion.angle[mask], 'rate': motion.rate[mask],
            'torque': low(motion.torque), 'library': peers.chosen.residual(motion)[mask],
            'identified': low(residual_torque(recording, robot)),
            'final': low(residual_torque(recording, final))}
