"""How Sphinx builds the site: ``make docs``. Nothing is loaded from the network, neither here nor by a reader."""

import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

from extension.generate import generate  # noqa: E402
from pygments.lexers.special import TextLexer  # noqa: E402
from sphinx.application import Sphinx  # noqa: E402
from sphinx.highlighting import lexers  # noqa: E402

from hydroopt.support import packages  # noqa: E402

project = "hydroopt"
author = "the hydroopt developers"
project_copyright = author
version = release = packages.version()
html_title = f"hydroopt {release}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Indices", "Expression", "Smoothing")}
autodoc_preserve_defaults = True
napoleon_attr_annotations = False
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
maximum_signature_line_length = 90
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist"]
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


def _parameters_as_lines(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: object) -> None:
    """Make lines of the parameters of long signatures, which Sphinx writes as a list of definitions without terms:
    readers of screens stumble over it."""
    if "body" in context:
        context["body"] = re.sub(r"<dl>\s*((?:<dd>(?:(?!<dl|</dl).)*?</dd>\s*)+)</dl>", lambda found: re.sub(
            r"<(/?)dd>", lambda end: "</span>" if end[1] else '<span class="sig-line">', found[1]),
            context["body"], flags=re.DOTALL)


def setup(app: Sphinx) -> None:
    """Show tables as plain text, and let Sphinx read signatures of classes whose defaults are made when called."""
    app.connect("html-page-context", _parameters_as_lines)
    lexers["csv"] = TextLexer()
    app.connect("autodoc-process-signature", lambda *args: (args[5] and args[5].replace("<factory>", "..."), args[6]))
