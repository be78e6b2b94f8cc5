# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The numbers that decide, each with its meaning and where it comes from."""

# Improvement of held-out residual torque that matters in practice, as a share of Coulomb friction:
# effects that improve it less are listed apart and change no verdict. A choice.
PRACTICAL = 0.01

# Share of the torque that the believed model leaves which acceleration must take for free runs to
# say anything: with less, angles follow from errors of the torque alone.
INERTIAL = 0.1

# White noise that is added to null simulations, as a share of Coulomb friction, rms up to
# whitening.HIGHEST, so that filters' own errors never count: half of what matters.
PRACTICAL_FLOOR = 0.5 * PRACTICAL

# 2 log evidence that an effect must add, beyond the prior odds of one effect among all
# hypotheses. Kass and Raftery: "positive"; held-out prediction must agree.
EVIDENCE = 2.0

# Standard deviations that are still chance, one in forty: within which a known parameter may stand
# for an effect, and by which the mean gain of held-out log likelihood over blocks must exceed 0.
PLAUSIBLE = 2.0

# Times as many standard errors where links have no encoder: their angles are computed with the
# model that is in question.
UNSEEN = 3.0

# Held-out log likelihood that must be gained: four hundred to one, some hundred hypotheses are
# tried (Ville's inequality).
HELD_OUT_NATS = 6.0

# Blocks in which an effect must act for a standard error to be known.
FEW_BLOCKS = 6

# Share by which what an effect of one size does would have to be more or less, where data show so:
# then it only resembles what is there. True ones on hidden robots reach 0.002.
OTHER_SIZE = 0.1

# Noise of drives, as a share of Coulomb friction behind the low-pass: data sheets of drives and
# cogging of small motors; more of it is called unexplained.
LARGEST_NOISE = 0.10

# Probability of the set of models that is reported; effects whose loss is no more than the rest of
# the largest one's are ranked last: where noise is large, so may be a torque that is hardly known.
CREDIBLE = 0.95

# Times by which squared held-out torque times squared free-run error must fall for one effect to
# take the place of several; squared torque over that of the noise floor from which any of the
# effects found are tried together: far beyond what chance does at the noise floor.
BETTER = 2.0

# Times by which squared held-out torque times squared free-run error must be less for an effect
# to be removed, or another model to be written than the one with all effects found: 5 % rms of
# either.
CLEARLY = 1.1

# Share by which rms torque or free runs may be worse and not clearly so. With effects that matter:
# on blocks left out, to which the given model may have been fitted, and against re-tuning alone.
NOT_CLEARLY = CLEARLY ** 0.5 - 1.0

# Likewise on other recordings, against the given model: what matters in no effect, matters here
# neither. Without effects that matter nothing may be worse.
WORSE = PRACTICAL

# Squared held-out torque that effects may leave, as a share of that without them, where they may
# only resemble what is missing: they explain more than they leave.
MOST_LEFT = 0.5

# Share of the evidence of a free function of one variable that an effect must have in its place
# to be named: true effects reach 0.9 to 3.7 on hidden robots, resemblances 0.1 to 0.85.
RESEMBLES = 0.9

# Decrease of the cost by another value of an effect that the model has, in the first scan, which
# leaves bounds aside, from which it is worth a remark: four times what chance gives the best of
# some hundred guesses, 2 log of their number.
KNOWN_OFF = 50.0
