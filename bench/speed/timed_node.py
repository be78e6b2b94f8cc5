# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A node with a simulated robot whose samples are timed.

``python -m bench.speed.timed_node NODE FILE --ros-args ...`` runs plant_node or loop_node and
writes what the plant measured to FILE.
"""

import json
import sys
import time

from gms_flex_control.file_io import write_text
from gms_flex_control.nodes import plant_node, simulated_robot, start
import numpy as np

_LONGEST = 3600 * 10**9  # that is measured; later samples are not [ns]


class LoopTiming:
    """Times of the samples of one run, ``period`` [ns] apart, for the JSON file ``path``."""

    def __init__(self, path, period):
        self._path, self._period = path, period
        self._published, self._answered = np.zeros((2, _LONGEST // period), dtype=np.int64)
        self._count = 0

    def published(self) -> int:
        """Note that the next state leaves now; return its number."""
        if self._count < len(self._published):
            self._published[self._count] = time.monotonic_ns()
            self._count += 1
        return self._count - 1

    def answered(self, sample, arrived) -> None:
        """Note that the command for state number ``sample`` came at ``arrived`` [ns]."""
        if 0 <= sample < self._count and self._answered[sample] == 0:
            self._answered[sample] = arrived

    def save(self) -> None:
        """Write the figures; an answer is in time if it came before the next state left."""
        if self._count < 3:
            return
        sent, came = self._published[:self._count], self._answered[:self._count - 1]
        trips = (came - sent[:-1])[came > 0] / 1e3
        error = np.abs(np.diff(sent) - self._period) / 1e3
        write_text(self._path, json.dumps({
            'samples': len(came), 'rate': float(1e9 / np.mean(np.diff(sent))),
            'answered_in_time': float(np.mean((came > 0) & (came <= sent[1:]))),
            'lost': int(np.sum(came == 0)),
            'round_trip_median_us': float(np.median(trips)) if len(trips) else None,
            'round_trip_p99_us': float(np.percentile(trips, 99)) if len(trips) else None,
            'interval_error_p99_us': float(np.percentile(error, 99))}, indent=2) + '\n')


def timed(path) -> type:
    """Return the class of a simulated robot that times its samples into a file."""
    class TimedRobot(simulated_robot.SimulatedRobot):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            self._timing, self._numbers = LoopTiming(path, self._arm.period), {}
            publish, arm = self._arm.outlet.publish, self._arm

            def published(message):
                self._numbers[arm.stamp] = self._timing.published()
                publish(message)
            arm.outlet.publish = published

        def _on_command(self, message):
            before = self.command
            understood = super()._on_command(message)
            if self.command is not before:
                _, stamp, came = self.command
                self._timing.answered(self._numbers.get(stamp, -1), came)
            return understood

        def finish(self):
            super().finish()
            self._timing.save()
    return TimedRobot


def main() -> int:
    """Run what the command line names; return its exit code."""
    node, path = sys.argv[1:3]
    del sys.argv[1:3]
    plant_node.SimulatedRobot = timed(path)
    return start.run(node)


if __name__ == '__main__':
    sys.exit(main())
