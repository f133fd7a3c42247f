"""How Sphinx builds the site: ``make docs``. Nothing is loaded from the network, neither here nor by a reader."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

from extension.generate import generate  # noqa: E402

from hydroopt import versions  # noqa: E402

project = "hydroopt"
author = "the hydroopt developers"
project_copyright = author
version = release = versions.version()
html_title = f"hydroopt {release}"

extensions = ["myst_parser"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["extension", "build"]
default_role = "code"
suppress_warnings = ["config.cache"]

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#00598c", "color-brand-content": "#00598c"},
    "dark_css_variables": {"color-brand-primary": "#6cb8e6", "color-brand-content": "#6cb8e6"},
}

generate(HERE)
