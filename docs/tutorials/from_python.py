# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
# %% [markdown]
# # From a bag to a named effect, in Python
#
# `examples/arm_with_play` is 12 s of an arm that follows a sinusoid; its robot file does not know
# that the gear of `joint2` has 12 mrad of play at either side.

# %%
import gms_flex_control as gms
from gms_flex_control.file_io import share_path

robot = gms.load_robot(share_path() / 'config' / 'robot.yaml')
bag = share_path() / 'examples' / 'arm_with_play'
recording = gms.read_recording(bag, robot.joints, robot.motors)

# %% [markdown]
# What does the model lack? 7 s (the first time 16), then a paragraph as of `gms_flex discrepancy`.

# %%
missing = gms.find_discrepancy([recording], robot)
print(missing.summary())

# %% [markdown]
# Every result has `to_dict()`, `to_dataframe()` and `plot()`; in a notebook it shows itself.

# %%
print(missing.to_dataframe()[['effect', 'joint', 'parameter', 'value', 'low', 'high']])
missing.plot().savefig('gap.png')

# %% [markdown]
# The model with what was found is a robot file for nodes and tools.

# %%
gms.save_robot(missing.robot, 'with_play.yaml')
