"""The templates of the pages, which all share one style."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import jinja2

from hydroopt.errors import visible
from hydroopt.report.numbers import NONE, SPACE, plain


@cache
def page(name: str) -> jinja2.Template:
    """A template of the folder ``templates``; all share one style."""
    folder = files("hydroopt.report").joinpath("templates")
    loader = jinja2.FunctionLoader(lambda part: folder.joinpath(part).read_text(encoding="utf-8"))
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
                                     lstrip_blocks=True, loader=loader, finalize=_safe)
    environment.filters["number"] = lambda value: NONE if value is None else plain(value, 3)
    return environment.get_template(name)


def _safe(value: object) -> object:
    """Names and other texts from files without characters that a page would not show as they are."""
    return visible(value, keep=f"\n{SPACE}") if type(value) is str else value
