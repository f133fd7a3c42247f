"""The one document of all pages: a template with its style, and the data and scripts of its figures and its machine."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup

from hydroopt.errors import visible
from hydroopt.report import charts as figures
from hydroopt.report.charts import Chart, Curves, Field, HeatMap, TimeChart
from hydroopt.report.numbers import NONE, SPACE, plain
from hydroopt.report.samples import Samples
from hydroopt.report.scene import SceneView
from hydroopt.results.answer import Answer
from hydroopt.results.diagnostic import FIRST, Diagnostic, by_kind

CODE = re.compile(r"(`[^`]+`|'hydroopt [^']*'|(?<![\w-])--[a-z][\w-]*(?: \w+=\w+)?)")
"""What a sentence shows as code: text between backticks, quoted commands, options."""
OPTION = re.compile(r"((?<!\S)--?[a-z]\S*(?: (?:'[^']*'|[^-&\s]\S*))?)")
"""An option of a command, and its value."""
SCRIPTS = ("core", "kinematics", "scene", "charts", "tables", "start")
"""The page's own scripts, in order."""


class Drawn(NamedTuple):
    """A figure as templates show it: its place among the page's charts, and what stands there where no script runs."""

    place: int
    kind: str
    title: str
    alt: str
    tall: int


@cache
def _text(*path: str) -> str:
    return files("hydroopt.report").joinpath(*path).read_text(encoding="utf-8")


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True, finalize=_safe,
        loader=jinja2.FunctionLoader(lambda part: _text("templates", part)))
    environment.filters["prose"] = prose
    environment.filters["words"] = words
    environment.filters["px"] = lambda value: f"{value:.1f}".removesuffix(".0")
    environment.filters["number"] = lambda value: NONE if value is None else plain(value, 3)
    return environment


def fragment(template: str, **content: Any) -> Markup:
    """A part of a page, such as a drawing."""
    return Markup(_environment().get_template(template).render(**content))


def document(template: str, *, answer: Answer | None = None, samples: Samples | None = None,
             charts: Mapping[str, Sequence[Chart]] | None = None, scene: SceneView | None = None,
             diagnostics: Sequence[Diagnostic] = (), **content: Any) -> str:
    """A page that needs nothing else: no file, no network.

    Args:
        template: of the folder ``templates``.
        answer: what the page is about; the template shows its verdict and diagnostics.
        samples: columns that figures and machine share.
        charts: figures by the names under which the template shows them.
        scene: the machine in space.
        diagnostics: of a page without an answer.
        content: whatever else the template shows.
    """
    samples = samples or Samples("", figures.NOTHING, {})
    flat = [chart for some in (charts or {}).values() for chart in some]
    drawn = iter(enumerate(flat))
    shown = {name: [_drawn(next(drawn), samples) for _ in some] for name, some in (charts or {}).items()}
    data = {"samples": samples.payload() if len(samples.at) else None, "charts": [figures.payload(c) for c in flat],
            "scene": None if scene is None else scene.payload()}
    scripts = _scripts(scene, plotted=bool(flat))
    policy = "; ".join(("default-src 'none'", "img-src data: blob:", "style-src 'unsafe-inline'",
                        "script-src " + " ".join(f"'sha256-{_digest(text)}'" for text in scripts)))
    style = _text("templates", "style.css") + (_text("vendor", "uPlot.min.css") if flat else "")
    if answer is not None:
        diagnostics, content["verdict"] = answer.diagnostics, answer.verdict
    found = by_kind(each for each in diagnostics if answer is None or each.text != answer.verdict.cause)
    first = 0 if answer is None else FIRST
    return _environment().get_template(template).render(
        answer=answer, charts=shown, scene=scene, noted=found[:first], further=found[first:],
        replayed=samples if len(samples.at) else None, policy=policy, style=Markup(style),
        data=Markup(json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", r"\u003c")),
        scripts=[Markup(text) for text in scripts], **content)


def prose(text: str) -> Markup:
    """A sentence with its commands and options as code, in which a number and its unit stay on one line."""
    together = re.sub(r"(\d) (?=[^\W\d]|%|\()", "\\1\N{NO-BREAK SPACE}", text)
    return Markup("").join(_code(part.strip("'`")) if k % 2 else part
                           for k, part in enumerate(CODE.split(_safe(together))))


def _code(text: str) -> Markup:
    """A command, which may be broken at its spaces, or an option, which stays on one line."""
    return Markup("<code>{}</code>" if " " in text else '<code class="nowrap">{}</code>').format(
        words(text) if " " in text else text)


def words(command: str) -> Markup:
    """A command that browsers break at its spaces, but neither within an option nor before the option's value."""
    return Markup("").join(Markup('<span class="word">{}</span>').format(part) if k % 2 else part
                           for k, part in enumerate(OPTION.split(command)))


def _drawn(numbered: tuple[int, Chart], samples: Samples) -> Drawn:
    index, chart = numbered
    lines = isinstance(chart, TimeChart | Curves)
    alt = figures.described(chart, samples) if isinstance(chart, TimeChart | Curves) else getattr(chart, "alt", "")
    return Drawn(index, chart.kind, chart.title, alt or chart.title,
                 170 if lines else 300 if isinstance(chart, HeatMap | Field) else 230)


def _scripts(scene: SceneView | None, *, plotted: bool) -> list[str]:
    """Texts of the scripts of a page: only the libraries that it needs."""
    libraries = [_text("vendor", "three.min.js")] if scene else []
    libraries += [_text("vendor", "uPlot.iife.min.js")] if plotted else []
    closing = "" if scene is None else f"const closeLoops = (q, tree) => {{\n{scene.graph.closure_script}\n}};\n"
    own = "\n".join(_text("scripts", f"{name}.js") for name in SCRIPTS)
    return [*libraries, f'"use strict";\n(() => {{\n{closing}{own}\n}})();']


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _safe(value: object) -> Any:
    """Names and other texts from files without characters that a page would not show as they are."""
    return visible(value, keep=f"\n{SPACE}") if type(value) is str else value
