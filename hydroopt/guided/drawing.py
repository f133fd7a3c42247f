"""A sketch from the side: as characters for a terminal, and as a page that refreshes itself."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import pairwise

import plotext

from hydroopt.guided.sketch import Part, Sketch

WIDTH, HEIGHT = 76, 18
"""Characters of a line and lines of a drawing."""
ASPECT = 2.0
"""Height of a character by its width."""

_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8">{refresh}<title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
:root {{ color-scheme: light dark }} body {{ font: 16px/1.5 system-ui, sans-serif; margin: 1rem auto; max-width: 60rem;
padding: 0 1rem }} svg {{ width: 100%; height: auto }} polyline {{ fill: none; stroke: currentColor }}
.cylinder {{ stroke: #2a78b8; stroke-linecap: round; opacity: .8 }}
.typical {{ stroke-dasharray: 3 3; opacity: .6 }} td, th {{ text-align: left; padding: .1rem .8rem .1rem 0 }}
</style></head><body><h1>{title}</h1><svg viewBox="{box}" role="img" aria-label="{title} from the side">{parts}</svg>
<p>Dashed parts are typical; solid ones were answered. </p><table>{rows}</table></body></html>
"""


def terminal(sketch: Sketch) -> str:
    """The machine from the side in braille characters; parts that are only typical are dotted."""
    parts = list(sketch.parts())
    low, high, unit = _frame(parts)
    plotext.clear_figure()
    plotext.theme("clear")
    plotext.plotsize(WIDTH, HEIGHT)
    plotext.frame(False)
    plotext.xticks([])
    plotext.yticks([])
    middle = (low + high) / 2
    plotext.xlim(middle.real - unit * WIDTH / 2, middle.real + unit * WIDTH / 2)
    plotext.ylim(middle.imag - unit * ASPECT * HEIGHT / 2, middle.imag + unit * ASPECT * HEIGHT / 2)
    for part in parts:
        for a, b in pairwise(part.points):
            plotext.plot([a.real, b.real], [a.imag, b.imag], marker="braille" if part.known else "·")
    for part in parts:
        at = _middle(part)
        plotext.text(part.name, at.real, at.imag)
    drawn = str(plotext.uncolorize(plotext.build()))
    return "\n".join(line.rstrip() for line in drawn.splitlines()).strip("\n")


def page(sketch: Sketch, *, finished: bool = False) -> str:
    """The machine from the side as a page; it refreshes every second until it is `finished`."""
    parts = list(sketch.parts())
    low, high, _ = _frame(parts)
    size = max((high - low).real, (high - low).imag)
    drawn = []
    for part in parts:
        path = " ".join(f"{point.real:.4f},{-point.imag:.4f}" for point in part.points)
        looks = " ".join([*["cylinder"] * part.cylinder, *["typical"] * (not part.known)])
        drawn.append(f'<polyline points="{path}" stroke-width="{size / (90 if part.cylinder else 200):.4f}" '
                     f'class="{looks}"><title>{escape(part.name)}</title></polyline>')
        drawn += [f'<circle cx="{point.real:.4f}" cy="{-point.imag:.4f}" r="{size / 130:.4f}" fill="currentColor"/>'
                  for point in part.points]
    drawn += [f'<text x="{_middle(part).real + size / 60:.4f}" y="{-_middle(part).imag:.4f}" '
              f'font-size="{size / 40:.4f}" fill="currentColor">{escape(part.name)}</text>' for part in parts]
    box = (low.real - 0.05 * size, -high.imag - 0.05 * size, (high - low).real + 0.3 * size,
           (high - low).imag + 0.1 * size)
    answered = [question for question in sketch.questions if question.key in sketch.answers]
    rows = "".join(f"<tr><td>{escape(question.text)}</td><td>{escape(sketch.answers[question.key]) or 'typical'}</td>"
                   "</tr>" for question in answered)
    return _PAGE.format(refresh="" if finished else '<meta http-equiv="refresh" content="1">', rows=rows,
                        box=" ".join(f"{number:.4f}" for number in box), title=escape(sketch.word("name")),
                        parts="".join(drawn))


def _middle(part: Part) -> complex:
    """Where its name stands."""
    corners = dict.fromkeys(part.points)
    return sum(corners) / len(corners)


def _frame(parts: Sequence[Part]) -> tuple[complex, complex, float]:
    """Lower and upper corner of parts, and the metres of a character's width that shows all."""
    points = [point for part in parts for point in part.points]
    low = complex(min(p.real for p in points), min(p.imag for p in points))
    high = complex(max(p.real for p in points), max(p.imag for p in points))
    span = high - low
    return low, high, 1.08 * max(span.real / WIDTH, span.imag / (ASPECT * HEIGHT), 1e-3)
