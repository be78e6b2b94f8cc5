# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""How Sphinx makes the documentation; `make docs` needs no network once it is installed."""

from importlib.util import find_spec
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import gms_flex_control  # noqa: E402  the line above finds it

project = 'gms_flex_control'
author = 'The gms_flex_control authors'
project_copyright = f'2026, {author}'
version = release = gms_flex_control.__version__

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.autosummary',
              'sphinx.ext.napoleon', 'sphinx-mathjax-offline']
source_suffix = {'.md': 'markdown', '.rst': 'restructuredtext'}
exclude_patterns = ['_build']
templates_path = ['_templates']
html_theme = 'sphinx_rtd_theme'
html_theme_options = {'navigation_depth': 2}  # more makes each of the API's pages long
html_copy_source = False
html_title = f'{project} {version}'
html_static_path = ['_static']
html_css_files = ['wide.css']

autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_default_options = {'members': True, 'show-inheritance': True}
autodoc_member_order = 'bysource'
autodoc_mock_imports = [name for name in (
    'rclpy', 'rcl_interfaces', 'builtin_interfaces', 'std_msgs', 'std_srvs', 'sensor_msgs',
    'rosgraph_msgs', 'diagnostic_msgs', 'lifecycle_msgs', 'launch', 'launch_ros',
    'ament_index_python', 'mujoco', 'pysindy')
    if find_spec(name) is None or not find_spec(name).origin]
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True  # an attribute that is also a member is described but once

myst_enable_extensions = ['colon_fence', 'dollarmath']
myst_heading_anchors = 4
suppress_warnings = ['myst.xref_missing', 'misc.highlighting_failure', 'ref.python']
