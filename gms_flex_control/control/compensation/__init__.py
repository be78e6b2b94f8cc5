# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Friction compensations, one per module, chosen by name in `choice`.

Each has ``estimate(state, measured, reference, dt, constants, work)``, with the arguments of
control.cascade.tick. It advances its memory in ``state.observer`` and leaves F_hat and two time
derivatives in ``work.estimate`` (3, n); ``gms_paper`` alone leaves the derivatives to the model's
acceleration and jerk.
"""
