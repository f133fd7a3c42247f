"""How Sphinx builds the site: ``make docs``. Nothing is loaded from the network, neither here nor by a reader."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

from extension.generate import generate  # noqa: E402
from pygments.lexers.special import TextLexer  # noqa: E402
from sphinx.application import Sphinx  # noqa: E402
from sphinx.highlighting import lexers  # noqa: E402

from hydroopt import versions  # noqa: E402

project = "hydroopt"
author = "the hydroopt developers"
project_copyright = author
version = release = versions.version()
html_title = f"hydroopt {release}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Indices", "Expression", "Smoothing", "AnyLog")}
autodoc_preserve_defaults = True
napoleon_attr_annotations = False
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
maximum_signature_line_length = 90
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["extension", "generated/machine_file.md", "generated/c_functions.md"]
default_role = "code"
suppress_warnings = ["ref.python"]  # a letter such as q is an attribute of several classes

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#00598c", "color-brand-content": "#00598c"},
    "dark_css_variables": {"color-brand-primary": "#6cb8e6", "color-brand-content": "#6cb8e6"},
}

generate(HERE)


def setup(app: Sphinx) -> None:
    """Show tables as plain text, and let Sphinx read signatures of classes whose defaults are made when called."""
    lexers["csv"] = TextLexer()
    app.connect("autodoc-process-signature", lambda *args: (args[5] and args[5].replace("<factory>", "..."), args[6]))
