# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
All limits of the checks of a recording.

A share is one of all samples unless it says otherwise. Where no origin is given, a limit was
chosen on recordings with injected faults (docs/data_checks.md), between healthy and faulty ones.
"""

# length and channels
FEWEST = 200                    # samples of a recording
SHORTEST, SHORT = 2.0, 4.0      # duration refused and warned about below [s]
MISSING_WARN, MISSING_MOST, MISSING_REFUSE = 0.001, 10, 0.3  # share, samples, share without number
# clock
FASTEST, SLOWEST = 2e-5, 0.2    # plausible periods [s]
LOST_WARN, LOST_REFUSE = 0.003, 0.3  # share of lost samples
GAP_WARN = 0.05                 # a single gap worth a word [s]
ON_GRID = 0.1                   # a step of a steady clock is this near a multiple of the period
TOO_SOON = 0.55                 # of a period: sooner than jitter puts a sample
CLUSTER = 10                    # short steps near each other are no late message
TOO_SOON_SHARE = 0.001          # share of such steps worth a word
IRREGULAR = 1.0                 # periods between the 10 % and 90 % quantiles of the steps
# motion
STILL_STEPS = 3                 # encoder steps, or standard deviations of noise, of no motion
ONE_WAY = 0.03                  # of the travel is in the other direction
SLOPE, SLOPE_FIT = (0.85, 1.15), 0.9            # velocity over derivative, correlation: right
SLOPE_MILD, SLOPE_MILD_FIT = (0.7, 1.4), 0.8    # likewise: warned about, else refused
FROZEN, FROZEN_WARN, FROZEN_REFUSE = 5, 0.002, 0.3   # samples; shares repeated in motion
BEYOND = 2.0                    # times the limits of a URDF: angles that far out are no radians
# torque
CLIPPED_WARN, CLIPPED_REFUSE = 0.005, 0.5  # shares of the moving samples
FEWEST_ROWS = 40                # of a fit
TRAVEL = 30                     # encoder steps a joint must move for its torque to be judged
CLEAR = 0.5                     # of the variance a fit must explain to be believed
APART = 0.3                     # of the variance by which one sign must explain more
EXACT = 0.95                    # a fit as good as this is no delay between encoders
SCALE_STIFFNESS = 4.0           # refused beyond this factor of what the spring says
SCALE_INERTIA = (3.0, 8.0)      # warned about, refused: inertia of a rigid joint is less known
SCALE_SLIGHT, NEARLY_ALL = 50.0, 0.9  # refused where friction is more of the variance than this
UNEXPLAINED = 0.2               # of the variance: less than this is no fit at all
# exchanged channels
SIDE_FACTOR = 8.0               # torque of the spring over that of the motor that cannot be
SIDE_SLOPE, SIDE_FIT = (0.5, 2.0), 0.9     # motor angle over link angle, correlation
