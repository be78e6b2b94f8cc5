# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Turn other people's logs into recordings, and say what looks wrong in them."""

from dataclasses import dataclass

from gms_flex_control.data import csv_map
from gms_flex_control.data.csv_map import load_map, POSITION_OF
from gms_flex_control.data.csv_table import CsvTable
from gms_flex_control.data.recording import Recording
from gms_flex_control.errors import ImportDataError
import numpy as np


@dataclass(frozen=True, eq=False)
class ImportedLog:
    """A recording made from a text table."""

    recording: Recording  # in SI units, time from the first sample
    motors: tuple         # motor name per joint, '' where the joint is rigid
    remarks: tuple        # what the import itself did: estimates, rows left out, resampling

    def summary(self) -> str:
        """Return a few lines of text: size, sampling, ranges and remarks."""
        recording = self.recording
        steps = 1e3 * np.diff(recording.time)
        lines = [f'{recording.source}: {len(recording.time)} samples in '
                 f'{recording.time[-1]:.6g} s, period {np.median(steps):.4g} ms '
                 f'({np.min(steps):.4g} to {np.max(steps):.4g} ms)']
        for i, (joint, motor) in enumerate(zip(recording.joints, self.motors, strict=True)):
            lines.append(f'  {joint} ({motor or "rigid"}):')
            lines += [f'    {name:<16}{np.nanmin(values[:, i]):>12.5g} to '
                      f'{np.nanmax(values[:, i]):>12.5g} {unit}'
                      for name, values, unit in _quantities(recording)
                      if np.isfinite(values[:, i]).any()]
        lines += [f'  note: {remark}' for remark in self.remarks]
        return '\n'.join(lines)


def import_csv(path, import_map, resample=None) -> ImportedLog:
    """
    Read a text table as a recording.

    ``import_map`` is an ImportMap, or the YAML file that says what the columns are; ``resample``
    puts everything on a fixed rate [Hz] by linear interpolation and overrides the map.
    ImportDataError if file and map do not fit, a cell is no number or time does not increase.
    """
    if not hasattr(import_map, 'joints'):
        import_map = load_map(import_map)
    if resample is not None and not (np.isfinite(resample) and resample > 0):
        raise ImportDataError(f'resample must be a positive rate [Hz], got {resample}')
    table = CsvTable(path, import_map.file)
    remarks = []
    time, keep = _time(table, import_map, remarks)
    joints = [_joint_values(table, import_map, joint, time, keep, remarks)
              for joint in import_map.joints]
    remarks += _units_kept(import_map)
    remarks += _units_doubted(import_map)
    rate = resample or import_map.resample
    if rate:
        time, joints = _resampled(time, joints, rate, remarks)
    return ImportedLog(_recording(str(path), import_map, time, joints),
                       tuple(joint.motor for joint in import_map.joints), tuple(remarks))


def _time(table, import_map, remarks):
    """Return stamps from 0 [s] and the rows they belong to."""
    spec, rows = import_map.time, np.arange(len(table.lines))
    if spec.rate is not None:
        time = rows / spec.rate
    else:
        time = csv_map.TIME[spec.unit] * table.column(
            spec.column, f'time ({import_map.path}:{spec.line})')
    missing = np.flatnonzero(np.isnan(time))
    if missing.size:
        raise ImportDataError(f'{table.path}:{table.lines[missing[0]]}: time column '
                              f'{spec.column!r} is empty or no finite number; remove the line')
    latest = np.maximum.accumulate(time)
    ahead = np.concatenate([[True], time[1:] > latest[:-1]])
    if not ahead.all():
        k = int(np.argmin(ahead))
        if not spec.drop_disorder:
            raise ImportDataError(
                f'{table.path}:{table.lines[k]}: time does not increase, {time[k]:.9g} s after '
                f'{latest[k - 1]:.9g} s ({np.sum(~ahead)} such lines); correct the file or set '
                'time.not_increasing: drop')
        remarks.append(f'{np.sum(~ahead)} samples whose time did not increase were left out, '
                       f'the first in line {table.lines[k]}')
        time, rows = time[ahead], rows[ahead]
    if len(time) < 2:
        raise ImportDataError(f'{table.path}: has {len(time)} usable sample; at least 2 make a '
                              'recording')
    return time - time[0], rows


def _joint_values(table, import_map, joint, time, keep, remarks):
    """Return {channel: values in SI, shape (T,)} of one joint."""
    values = {}
    # positions first: estimates and the back-emf need them
    for name, channel in sorted(joint.channels.items(), key=lambda item: _ORDER.index(
            item[1].quantity)):
        if channel.estimate is not None:
            values[name] = estimate_velocity(time, values[POSITION_OF[name]], channel.estimate)
            remarks.append(f'{joint.name} {name.replace("_", " ")} is estimated by central '
                           f'differences over {1e3 * channel.estimate:.4g} ms')
        else:
            place = f'{joint.name}.{name} ({import_map.path}:{channel.line})'
            raw = table.column(channel.column, place)[keep]
            values[name] = _in_si(raw, channel, table, keep, place)
            if channel.pwm.back_emf:
                values[name] = values[name] - _back_emf_torque(channel, joint, values, time)
            if channel.enabled is not None:
                values[name] = np.where(table.column(channel.enabled, place)[keep] == 0, 0.0,
                                        values[name])
    return values


_ORDER = ('position', 'velocity', 'torque')
CURRENT = {'A': 1.0, 'mA': 1e-3}


def currents_in(import_map) -> list:
    """Return the joints whose torque stays a current, its constant unknown."""
    return [joint.name for joint in import_map.joints if any(
        channel.unit in CURRENT and channel.torque_constant is None
        for channel in joint.channels.values())]


def _units_kept(import_map):
    """Yield what is not in the units the bag's topics are meant for."""
    currents = currents_in(import_map)
    if currents:
        yield (f'no torque_constant for {", ".join(currents)}: a current stays a current [A]; '
               'recording.yaml beside the bag says so, and takes the constant once it is known')
    linear = [joint.name for joint in import_map.joints
              if joint.channels['link_position'].unit in csv_map.LENGTH]
    if linear:
        yield (f'{", ".join(linear)}: linear axis, so read m for rad, N for N m and kg for '
               'kg m^2')


def _units_doubted(import_map):
    """Yield a torque beside a position along a slide, and a force beside an angle."""
    for joint in import_map.joints:
        slides = joint.channels['link_position'].unit in csv_map.LENGTH
        for name in ('torque', 'command'):
            channel = joint.channels.get(name)
            if channel is None or slides == (channel.unit in csv_map.FORCE) or (
                    csv_map.TORQUE[channel.unit] is None) or channel.gear_ratio != 1:
                continue
            yield (f'{joint.name}.{name} is in {channel.unit!r} beside a position in '
                   f'{joint.channels["link_position"].unit!r}; ' + (
                       'give the force at the slide: gear_ratio: 2 pi over the lead of the screw '
                       '[rad/m]' if slides else 'give the torque: scale: the lever arm [m]'))


def _in_si(raw, channel, table, keep, place):
    factor = csv_map.UNITS[channel.quantity][channel.unit]
    if channel.unit in ('counts', 'counts/s'):
        factor = 2 * np.pi / channel.counts_per_rev
    elif channel.unit in CURRENT:
        factor = CURRENT[channel.unit] * (channel.torque_constant or 1.0)
    elif channel.unit == 'pwm':
        pwm = channel.pwm
        volts = pwm.voltage if isinstance(pwm.voltage, float) else table.column(
            pwm.voltage, place)[keep]
        factor = pwm.torque_per_volt * volts / pwm.full_scale
    values = channel.sign * channel.scale * factor * (raw + channel.offset)
    if channel.unwrap:
        known = np.isfinite(values)
        values[known] = np.unwrap(values[known], period=2 * np.pi * abs(channel.scale))
    gear = channel.gear_ratio
    return values * gear if channel.quantity == 'torque' else values / gear


def _back_emf_torque(channel, joint, values, time):
    """Return the torque a voltage-driven motor loses to its own speed [N m]."""
    side = 'motor' if joint.motor else 'link'
    velocity = values.get(f'{side}_velocity')
    if velocity is None:
        velocity = estimate_velocity(time, values[f'{side}_position'], 0.02)
    # the map's velocity is the joint's: the motor behind a gear turns gear_ratio times as fast
    pwm = channel.pwm
    return pwm.torque_per_volt * pwm.back_emf * velocity * channel.gear_ratio ** 2


def estimate_velocity(time, position, window) -> np.ndarray:
    """
    Return velocity [rad/s] by central differences over a window [s], NaN beside missing positions.

    Stamps [s] need not be even. The difference is one-sided and shorter at the ends, and never
    shorter than the neighbouring samples.
    """
    before = np.maximum(time - window / 2, time[0])
    after = np.minimum(time + window / 2, time[-1])
    # at least the sample before and the one after
    before[1:] = np.minimum(before[1:], time[:-1])
    after[:-1] = np.maximum(after[:-1], time[1:])
    step = np.interp(after, time, position) - np.interp(before, time, position)
    return step / (after - before)


def _resampled(time, joints, rate, remarks):
    grid = np.arange(int(np.floor(time[-1] * rate * (1 + 1e-12))) + 1) / rate
    if len(grid) < 2:
        raise ImportDataError(f'resampling {time[-1]:.6g} s at {rate:g} Hz leaves '
                              f'{len(grid)} sample; choose a higher rate')
    own = 1 / float(np.median(np.diff(time)))
    remarks.append(f'resampled from about {own:.4g} Hz to {rate:g} Hz by linear interpolation'
                   + (', without a filter against aliasing' if rate < 0.8 * own else ''))
    return grid, [{name: np.interp(grid, time, values) for name, values in joint.items()}
                  for joint in joints]


def _recording(source, import_map, time, joints):
    def stack(name):
        return np.stack([joint.get(name, np.full(len(time), np.nan)) for joint in joints], axis=1)

    reference = np.full((len(time), 5, len(joints)), np.nan)
    reference[:, 0] = stack('reference')
    reference[:, 1] = stack('reference_velocity')
    return Recording(
        joints=tuple(joint.name for joint in import_map.joints), time=time,
        q_link=stack('link_position'), dq_link=stack('link_velocity'),
        q_motor=stack('motor_position'), dq_motor=stack('motor_velocity'),
        tau_motor=stack('torque'), command=stack('command'), reference=reference, source=source)


def _quantities(recording):
    return (('link angle', recording.q_link, 'rad'),
            ('link velocity', recording.dq_link, 'rad/s'),
            ('motor angle', recording.q_motor, 'rad'),
            ('motor velocity', recording.dq_motor, 'rad/s'),
            ('torsion', recording.q_motor - recording.q_link, 'rad'),
            ('torque', recording.tau_motor, 'N m'), ('command', recording.command, 'N m'),
            ('reference', recording.reference[:, 0], 'rad'))
