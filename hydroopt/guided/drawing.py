"""A sketch from the side: as characters for a terminal, and as a page that refreshes itself."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import pairwise
from shutil import get_terminal_size

import plotext

from hydroopt.guided.sketch import Part, Sketch

WIDTH, HEIGHT = 76, 18
"""Characters of a line at most, and lines, of a drawing."""
ASPECT = 2.0
"""Height of a character by its width."""

_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8">{refresh}<title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
:root {{ color-scheme: light dark }} body {{ font: 16px/1.5 system-ui, sans-serif; margin: 1rem auto; max-width: 60rem;
padding: 0 1rem }} svg {{ width: 100%; height: auto; max-height: 90vh }} polyline {{ fill: none; stroke: currentColor }}
.leader {{ stroke: currentColor; opacity: .4 }}
.cylinder {{ stroke: #2a78b8; stroke-linecap: round; opacity: .8 }}
.typical {{ opacity: .6 }} td, th {{ text-align: left; padding: .1rem .8rem .1rem 0 }}
</style></head><body><h1>{title}</h1><svg viewBox="{box}" role="img" aria-label="{title} from the side">{parts}</svg>
<p>{legend}</p><table>{rows}</table></body></html>
"""


def terminal(sketch: Sketch) -> str:
    """The machine from the side in braille characters; parts that are only typical are dotted."""
    parts = list(sketch.parts())
    columns = min(WIDTH, get_terminal_size().columns - 1)
    low, high, unit = _frame(parts, columns)
    plotext.clear_figure()
    plotext.theme("clear")
    plotext.plotsize(columns, HEIGHT)
    plotext.frame(False)
    plotext.xticks([])
    plotext.yticks([])
    middle = (low + high) / 2
    plotext.xlim(middle.real - unit * columns / 2, middle.real + unit * columns / 2)
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
    line, dash = size / 28, f' stroke-dasharray="{size / 80:.4f}"'  # [m], as all of the picture
    drawn = []
    for part in parts:
        path = " ".join(f"{point.real:.4f},{-point.imag:.4f}" for point in part.points)
        looks = " ".join([*["cylinder"] * part.cylinder, *["typical"] * (not part.known)])
        drawn.append(f'<polyline points="{path}" stroke-width="{size / (90 if part.cylinder else 200):.4f}" '
                     f'class="{looks}"{"" if part.known else dash}><title>{escape(part.name)}</title></polyline>')
        drawn += [f'<circle cx="{point.real:.4f}" cy="{-point.imag:.4f}" r="{size / 130:.4f}" fill="currentColor"/>'
                  for point in part.points]
    beside, last = high.real + line, -float("inf")
    for part in sorted(parts, key=lambda each: -_middle(each).imag):  # names in a column of their own never overlap
        at = _middle(part)
        last = max(last + 1.2 * line, -at.imag)
        drawn.append(f'<line class="leader" x1="{at.real:.4f}" y1="{-at.imag:.4f}" x2="{beside:.4f}" y2="{last:.4f}" '
                     f'stroke-width="{size / 800:.4f}"/><text x="{beside + line / 4:.4f}" y="{last + line / 3:.4f}" '
                     f'font-size="{line:.4f}" fill="currentColor">{escape(part.name)}</text>')
    left, top, widest = low.real - line, -high.imag - line, line * (0.65 * max(len(part.name) for part in parts) + 0.5)
    box = (left, top, beside + widest - left, max(-low.imag, last) + line - top)
    answered = [question for question in sketch.questions if question.key in sketch.answers]
    rows = "".join(f"<tr><td>{escape(question.text)}</td><td>{escape(sketch.answers[question.key]) or 'typical'}</td>"
                   "</tr>" for question in answered)
    known = [part.known for part in parts]
    legend = ("All parts were answered." if all(known) else "Dashed parts are typical; solid ones were answered."
              if any(known) else "All parts are typical: none was answered yet.")
    return _PAGE.format(legend=legend, refresh="" if finished else '<meta http-equiv="refresh" content="1">', rows=rows,
                        box=" ".join(f"{number:.4f}" for number in box), title=escape(sketch.word("name")),
                        parts="".join(drawn))


def _middle(part: Part) -> complex:
    """Where its name stands."""
    corners = dict.fromkeys(part.points)
    return sum(corners) / len(corners)


def _frame(parts: Sequence[Part], columns: int = WIDTH) -> tuple[complex, complex, float]:
    """Lower and upper corner of parts, and the metres of a character's width that shows all."""
    points = [point for part in parts for point in part.points]
    low = complex(min(p.real for p in points), min(p.imag for p in points))
    high = complex(max(p.real for p in points), max(p.imag for p in points))
    span = high - low
    return low, high, 1.08 * max(span.real / columns, span.imag / (ASPECT * HEIGHT), 1e-3)
