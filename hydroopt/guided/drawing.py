"""A sketch from the side: as characters for a terminal, and as a page that refreshes itself."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from shutil import get_terminal_size

import plotext

from hydroopt.errors import HydrooptError
from hydroopt.guided.machine_text import machine_text
from hydroopt.guided.plane import OpenError
from hydroopt.guided.sketch import Sketch
from hydroopt.machine.machine_file import read_machine
from hydroopt.model.model import Model
from hydroopt.model.vertical_plane import limit_postures
from hydroopt.report.drawing import LETTER, Drawing, View, drawn
from hydroopt.report.page import document

WIDTH, HEIGHT = 76, 18
"""Characters of a line at most, and lines, of a drawing."""
ASPECT = 2.0
"""Height of a character by its width."""


def side(sketch: Sketch) -> Drawing | None:
    """The machine from the side, in the middle of its ranges; None as long as no machine can have these numbers."""
    try:
        return _side(machine_text(sketch))
    except (OpenError, HydrooptError):
        return None


@lru_cache(maxsize=1)  # the terminal and the page show the same
def _side(text: str) -> Drawing:
    model = Model(read_machine(text))
    postures, graph = limit_postures(model), model.scene_graph
    return drawn(graph, graph.tree_positions(postures.q[:1]), View.side(postures.plane))


def terminal(sketch: Sketch) -> str:
    """The machine from the side in braille characters; parts of which nothing was answered are dotted."""
    seen = side(sketch)
    if seen is None:
        return "No machine can have these lengths yet."
    known = {key.partition(".")[0] for key, text in sketch.answers.items() if text}
    columns, (low, high) = min(WIDTH, get_terminal_size().columns - 1), seen.corners
    unit = max(*(high - low) / (columns, ASPECT * HEIGHT))
    middle, half = (low + high) / 2, unit / 2 * columns
    plotext.clear_figure()
    plotext.theme("clear")
    plotext.plotsize(columns, HEIGHT)
    plotext.frame(False)
    plotext.xticks([])
    plotext.yticks([])
    plotext.xlim(middle[0] - half, middle[0] + half)
    plotext.ylim(middle[1] - unit * ASPECT * HEIGHT / 2, middle[1] + unit * ASPECT * HEIGHT / 2)
    for part in seen.first.parts:
        outline = part.corners[[*range(len(part.corners)), 0]]
        for a, b in pairwise(outline.tolist()):
            plotext.plot([a[0], b[0]], [a[1], b[1]], marker="braille" if part.name in known else "·")
    for name in seen.lettered(LETTER / unit, line=ASPECT * LETTER):
        plotext.text(name.text, *name.at.tolist())
    shown = str(plotext.uncolorize(plotext.build()))
    return "\n".join(line.rstrip() for line in shown.splitlines()).strip("\n")


def page(sketch: Sketch, *, finished: bool = False) -> str:
    """The machine from the side as a page, with the answers; it refreshes every second until it is `finished`."""
    seen, name = side(sketch), sketch.word("name")
    answered = [(each.text, sketch.answers[each.key]) for each in sketch.questions if each.key in sketch.answers]
    drawing = seen and seen.svg(seen.description(name, "in the middle of its ranges"), axes=True)
    return document("new.html", name=name, drawing=drawing, answered=answered, finished=finished)
