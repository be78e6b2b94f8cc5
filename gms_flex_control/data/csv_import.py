# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Turn other people's logs, tables of text, into recordings."""

from array import array
import csv
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path

from gms_flex_control.data import csv_map
from gms_flex_control.data.csv_map import load_map, POSITION_OF
from gms_flex_control.data.recording import Recording, with_own_stamps
from gms_flex_control.errors import did_you_mean, ImportDataError
import numpy as np


class CsvTable:
    """A UTF-8 table of numbers read into memory, laid out as a FileFormat says."""

    def __init__(self, path, form):
        self.path = Path(path)
        self._form = form
        rows = self._rows()
        header = list(islice(rows, form.header_rows))
        first = next(rows, None)
        if first is None:
            raise ImportDataError(f'{path}: has no data below {len(header)} header rows; '
                                  'is it the right file, or file.header_rows too large?')
        if header:
            self.names, *self._other_names = map(_names, (row for _, row in reversed(header)))
            self._check_header(*header[-1])
        else:
            self.names, self._other_names = [str(i + 1) for i in range(len(_names(first[1])))], []
        self._texts = {}  # (row, column): what is no number
        self._values, self.lines = self._numbers(chain([first], rows))

    def _numbers(self, rows):
        """Return all cells (T, columns), NaN for texts, and their lines (T,)."""
        values, lines, comma = array('d'), array('q'), self._form.decimal == ','
        for line, cells in rows:
            cells = self._fitting(line, cells, rows)
            if comma:
                cells = [cell.replace(',', '.') for cell in cells]
            try:
                numbers = tuple(map(float, cells))
            except ValueError:
                numbers = [self._number(cell, len(lines), i) for i, cell in enumerate(cells)]
            values.extend(numbers)
            lines.append(line)
        table = np.array(values).reshape(len(lines), len(self.names))
        table[~np.isfinite(table)] = np.nan
        return table, np.array(lines)

    def _number(self, cell, row, column):
        text = cell.strip()
        try:
            return float(text)
        except ValueError:
            if text.lower() not in ('', 'nan', 'na', 'n/a', 'null', 'none', '-'):
                self._texts[row, column] = text
            return np.nan

    def column(self, name, asked_by) -> np.ndarray:
        """Return numbers (T,) by name, or number from 1; ImportDataError names ``asked_by``."""
        index = self._index(name, asked_by)
        texts = [row for row, column in self._texts if column == index]
        if texts:
            self._refuse(min(texts), index)
        return self._values[:, index].copy()

    def _index(self, name, asked_by):
        if isinstance(name, int):
            if not 1 <= name <= len(self.names):
                raise ImportDataError(f'{self.path}: has {len(self.names)} columns, {asked_by} '
                                      f'requires column {name}; they count from 1')
            return name - 1
        for names in self._other_names:
            if name not in self.names and names.count(name) == 1:
                return names.index(name)  # the last header row holds units or the like
        if name not in self.names:
            raise ImportDataError(f'{self.path}: has no column {name!r}, which {asked_by} '
                                  f'requires{did_you_mean(name, self.names)}')
        if self.names.count(name) > 1:
            raise ImportDataError(f'{self.path}: has {self.names.count(name)} columns named '
                                  f'{name!r}; give the number of the one meant (from 1)')
        return self.names.index(name)

    def _refuse(self, row, index):
        text = self._texts[row, index]
        hint = '; correct the cell or leave it empty'
        if text.replace(',', '').lstrip('-').isdigit():
            hint = "; set file.decimal: ','"
        elif ':' in text:
            hint = '; give a time of day as seconds since the start'
        elif row == 0:
            hint = ('; if this line is not data, set file.header_rows: '
                    f'{self._form.header_rows + 1}')
        raise ImportDataError(f'{self.path}:{self.lines[row]}: column {self.names[index]!r} '
                              f'holds {text[:40]!r}, which is not a number{hint}')

    def _rows(self):
        """Yield (line, cells) of every line that is neither blank nor a comment."""
        try:
            text = self.path.read_text(encoding='utf-8-sig')
        except OSError as error:
            raise ImportDataError(f'{self.path}: cannot be read ({error.strerror})') from error
        except UnicodeDecodeError as error:
            raise ImportDataError(
                f'{self.path}: is not UTF-8 text (byte {error.start} is '
                f'0x{error.object[error.start]:02x}); export it as UTF-8 CSV') from error
        if not text:
            raise ImportDataError(f'{self.path}: is empty (0 bytes); export the log again')
        if '\0' in text:
            raise ImportDataError(f'{self.path}: holds NUL bytes, so it is not a text table; '
                                  'export it as CSV')
        comment, blank = self._form.comment, self._form.delimiter == ' '
        lines = text.splitlines(keepends=True)
        del text
        if blank:
            source = ((i + 1, line.split()) for i, line in enumerate(lines))
        else:
            reader = csv.reader(lines, delimiter=self._form.delimiter)
            source = ((reader.line_num, cells) for cells in reader)
        for line, cells in source:
            if any(cell.strip() for cell in cells) and not (
                    comment and cells[0].lstrip().startswith(comment)):
                yield line, cells

    def _check_header(self, line, cells):
        """Refuse a row of numbers as names: the first sample would be lost in silence."""
        names = _names(cells)
        if len(names) < 2 or names == [str(i + 1) for i in range(len(names))]:
            return
        comma = self._form.decimal == ','
        try:
            for name in names:
                float((name.replace(',', '.') if comma else name) or 'nan')
        except ValueError:
            return
        raise ImportDataError(f'{self.path}:{line}: has numbers where file.header_rows: '
                              f'{self._form.header_rows} expects column names; set '
                              f'file.header_rows: {self._form.header_rows - 1} and give '
                              'columns by number, from 1')

    def _fitting(self, line, cells, following):
        count = len(self.names)
        while len(cells) > count and not cells[-1].strip():
            cells = cells[:-1]  # delimiters at the end of each row
        if len(cells) != count:
            last = next(following, None) is None
            hint = 'the file seems cut off, remove the last line' if last else (
                'check file.delimiter and file.decimal, or correct the line')
            raise ImportDataError(f'{self.path}:{line}: has {len(cells)} cells where there are '
                                  f'{count} columns; {hint}')
        return cells


def _names(cells):
    """Return the names in a header row, without empty columns at its end."""
    names = [cell.strip().lstrip('#%').strip() for cell in cells]
    while len(names) > 1 and not names[-1]:
        names.pop()
    return names


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
    recording, said = with_own_stamps(_recording(str(path), import_map, time, joints))
    remarks += said
    rate = resample or import_map.resample
    if rate:
        recording = _resampled(recording, rate, remarks)
    return ImportedLog(recording, tuple(joint.motor for joint in import_map.joints),
                       tuple(remarks))


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


def sliding(import_map) -> list:
    """Return the joints that are linear axes."""
    return [joint.name for joint in import_map.joints if joint.angle.unit in csv_map.LENGTH]


def _units_kept(import_map):
    """Yield what is not in the units the bag's topics are meant for."""
    currents = currents_in(import_map)
    if currents:
        yield (f'no torque_constant for {", ".join(currents)}: a current stays a current [A]; '
               'recording.yaml beside the bag says so, and takes the constant once it is known')
    linear = sliding(import_map)
    if linear:
        yield (f'{", ".join(linear)}: linear axis, so read m for rad, N for N m and kg for '
               'kg m^2')


def _units_doubted(import_map):
    """Yield a torque beside a position along a slide, and a force beside an angle."""
    for joint in import_map.joints:
        slides = joint.angle.unit in csv_map.LENGTH
        for name in ('torque', 'command'):
            channel = joint.channels.get(name)
            if channel is None or slides == (channel.unit in csv_map.FORCE) or (
                    csv_map.TORQUE[channel.unit] is None) or channel.gear_ratio != 1:
                continue
            yield (f'{joint.name}.{name} is in {channel.unit!r} beside a position in '
                   f'{joint.angle.unit!r}; ' + (
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
    if channel.unwrap or channel.unwrap_range:
        period = factor * channel.unwrap_range if channel.unwrap_range else 2 * np.pi
        known = np.isfinite(values)
        values[known] = np.unwrap(values[known], period=period * abs(channel.scale))
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


def _resampled(recording, rate, remarks):
    time = recording.time
    grid = np.arange(int(np.floor(time[-1] * rate * (1 + 1e-12))) + 1) / rate
    if len(grid) < 2:
        raise ImportDataError(f'resampling {time[-1]:.6g} s at {rate:g} Hz leaves '
                              f'{len(grid)} sample; choose a higher rate')
    own = 1 / float(np.median(np.diff(time)))
    remarks.append(f'resampled from about {own:.4g} Hz to {rate:g} Hz by linear interpolation'
                   + (', without a filter against aliasing' if rate < 0.8 * own else ''))
    return replace(recording.with_channels(partial(
        np.apply_along_axis, lambda values: np.interp(grid, time, values), 0)), time=grid)


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
